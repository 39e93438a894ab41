"""Both FMUs in one container FMU, which is asked for one step over all of its own."""

import json
import shutil
from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy
from fmu_manipulation_toolbox.assembly import Assembly

from tests.speed.pair import LEVEL, SIGNAL, STEP_SIZE, Pair

_OUTPUT = "level"


def run(pair: Pair, steps: int) -> float:
    with TemporaryDirectory() as folder:
        place = Path(folder)
        for path in pair.fmus.values():
            shutil.copy(path, place)
        (place / "loop.json").write_text(json.dumps(_described(pair)))
        Assembly("loop.json", fmu_directory=place).make_fmu()
        stop_time = steps * STEP_SIZE
        result = fmpy.simulate_fmu(
            str(place / "loop.fmu"),
            stop_time=stop_time,
            step_size=stop_time,
            output_interval=stop_time,
            output=[_OUTPUT],
        )
    return float(result[_OUTPUT][-1])


def _described(pair: Pair) -> dict:
    first, second = (path.name for path in pair.fmus.values())
    return {
        "name": "loop.fmu",
        "step_size": STEP_SIZE,
        "auto_link": False,
        "auto_input": False,
        "auto_output": False,
        "fmu": [first, second],
        "link": [[first, LEVEL, second, SIGNAL], [second, LEVEL, first, SIGNAL]],
        "output": [[first, LEVEL, _OUTPUT]],
    }
