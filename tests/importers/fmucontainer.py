"""`fmucontainer` of the FMU manipulation toolbox: all FMUs in one container FMU, which FMPy then runs.

It reads SSP packages itself, but not their parameters; here everything is given in its own format.
"""

import json
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

import fmpy
from fmu_manipulation_toolbox.assembly import Assembly

from orchestration.exchange.ssp_read import opened
from orchestration.system.system import System
from tests.importers.importer_job import ImporterJob, Trajectory

OUTPUT = "output"  # of the container


def run(job: ImporterJob) -> Trajectory:
    with opened(job.package) as loop, tempfile.TemporaryDirectory() as folder:
        values = {**loop.experiment.parameters, **loop.experiment.inputs}
        result = fmpy.simulate_fmu(
            str(build_container(loop.system, values, job.output, job.step_size, Path(folder))),
            start_time=job.start_time,
            stop_time=job.stop_time,
            step_size=job.step_size,
            output_interval=job.step_size,
            output=[OUTPUT],
        )
    return Trajectory(result["time"], result[OUTPUT])


def build_container(
    system: System, values: Mapping[str, object], output: str, step_size: float, folder: Path
) -> Path:
    """A container FMU of the system with one output, called OUTPUT; step_size [s] of the FMUs inside."""

    def split(name: str) -> list[str]:
        component, _, variable = name.partition(".")
        return [system.components[component].name, variable]

    for fmu in system.components.values():
        shutil.copy(fmu, folder)
    description = {
        "name": "loop.fmu",
        "step_size": step_size,
        "auto_link": False,
        "auto_input": False,
        "auto_output": False,
        "fmu": [fmu.name for fmu in system.components.values()],
        "link": [[*split(source), *split(target)] for source, target in system.connections],
        "start": [[*split(name), value] for name, value in values.items()],
        "output": [[*split(output), OUTPUT]],
    }
    (folder / "loop.json").write_text(json.dumps(description))
    Assembly("loop.json", fmu_directory=folder).make_fmu()
    return folder / "loop.fmu"
