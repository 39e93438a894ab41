"""Both FMUs in one container FMU, which is asked for one step over all of its own."""

from pathlib import Path
from tempfile import TemporaryDirectory

import fmpy

from tests.importers.fmucontainer import OUTPUT, build_container
from tests.speed.pair import LEVEL, STEP_SIZE, Pair


def run(pair: Pair, steps: int) -> float:
    with TemporaryDirectory() as folder:
        stop_time = steps * STEP_SIZE
        result = fmpy.simulate_fmu(
            str(build_container(pair.system, {}, f"first.{LEVEL}", STEP_SIZE, Path(folder))),
            stop_time=stop_time,
            step_size=stop_time,
            output_interval=stop_time,
            output=[OUTPUT],
        )
    return float(result[OUTPUT][-1])
