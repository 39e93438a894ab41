"""Ecos through `ecospy`: Jacobi, initial exchange, times by adding up steps.

It knows no enumerations, and applies a parameter set only when it is named.
"""

from typing import Any

import numpy as np
from ecospy.EcosSimulation import EcosSimulation

from tests.importers.task import Task, Trajectory


def run(task: Task) -> Trajectory:
    watched = task.watched.replace(".", "::", 1)
    with EcosSimulation(ssp_path=str(task.package), step_size=task.step_size) as simulation:
        start: Any = task.start_time  # declared as int, handed on as double
        if not simulation.init(start, task.parameter_set):
            raise RuntimeError("the initialisation failed")
        time, values = [task.start_time], [simulation.get_real(watched)]
        for _ in range(task.steps):
            time.append(simulation.step())
            values.append(simulation.get_real(watched))
    return Trajectory(np.array(time), np.array(values))
