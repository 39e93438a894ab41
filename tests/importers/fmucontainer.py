"""`fmucontainer` of the FMU manipulation toolbox: all FMUs in one container FMU, which FMPy then runs.

It reads SSP packages itself, but not their parameters; here everything is given in its own format.
"""

import json
import tempfile
from pathlib import Path
from typing import Any

import fmpy
from fmu_manipulation_toolbox.assembly import Assembly

from orchestration.exchange.ssp_read import opened
from orchestration.scenarios.scenario import Scenario
from tests.importers.importer_job import ImporterJob, Trajectory

_OUTPUT = "compared"


def run(job: ImporterJob) -> Trajectory:
    with opened(job.package) as loop, tempfile.TemporaryDirectory() as folder:
        working_folder = Path(folder)
        for fmu in loop.system.components.values():
            (working_folder / fmu.name).write_bytes(fmu.read_bytes())
        (working_folder / "loop.json").write_text(json.dumps(_described(loop, job)))
        Assembly("loop.json", fmu_directory=working_folder).make_fmu()
        result = fmpy.simulate_fmu(
            str(working_folder / "loop.fmu"),
            start_time=job.start_time,
            stop_time=job.stop_time,
            step_size=job.step_size,
            output_interval=job.step_size,
            output=[_OUTPUT],
        )
    return Trajectory(result["time"], result[_OUTPUT])


def _described(loop: Scenario, job: ImporterJob) -> dict[str, Any]:
    """The container in the toolbox's own terms, [FMU, variable]."""

    def split(name: str) -> list[str]:
        component, _, variable = name.partition(".")
        return [loop.system.components[component].name, variable]

    values = {**loop.experiment.parameters, **loop.experiment.inputs}
    return {
        "name": "loop.fmu",
        "step_size": job.step_size,
        "auto_link": False,
        "auto_input": False,
        "auto_output": False,
        "fmu": [fmu.name for fmu in loop.system.components.values()],
        "link": [[*split(source), *split(target)] for source, target in loop.system.connections],
        "start": [[*split(name), value] for name, value in values.items()],
        "output": [[*split(job.output), _OUTPUT]],
    }
