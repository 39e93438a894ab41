"""Ecos through `ecospy`: Jacobi, initial exchange, times by adding up steps.

It knows no enumerations, and applies a parameter set only when it is named.
"""

from typing import Any

import numpy as np
from ecospy.EcosSimulation import EcosSimulation

from tests.importers.importer_job import ImporterJob, Trajectory


def run(job: ImporterJob) -> Trajectory:
    output = job.output.replace(".", "::", 1)
    with EcosSimulation(ssp_path=str(job.package), step_size=job.step_size) as simulation:
        start: Any = job.start_time  # declared as int, handed on as double
        if not simulation.init(start, job.parameter_set):
            raise RuntimeError("the initialisation failed")
        time, values = [job.start_time], [simulation.get_real(output)]
        for _ in range(job.steps):
            time.append(simulation.step())
            values.append(simulation.get_real(output))
    return Trajectory(np.array(time), np.array(values))
