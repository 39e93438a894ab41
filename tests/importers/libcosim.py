"""OSP's libcosim through `libcosimpy`: Jacobi, initial exchange, times in whole nanoseconds.

It knows neither enumerations nor parameter bindings of the system, only those of components.
"""

import numpy as np
from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver

from tests.importers.importer_job import ImporterJob, Trajectory

_NANOSECOND = 1e-9


def run(job: ImporterJob) -> Trajectory:
    component, _, variable = job.output.partition(".")
    execution = CosimExecution.from_ssp_file(str(job.package), round(job.step_size / _NANOSECOND))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    slave = execution.slave_index_from_instance_name(component)
    if slave is None:
        raise RuntimeError(f"no component {component!r} in the package")
    (reference,) = [v.reference for v in execution.slave_variables(slave) if v.name.decode() == variable]
    time, values = [], []
    for _ in range(job.steps):
        if not execution.step():
            raise RuntimeError(f"a step failed at {execution.status().current_time} ns")
        time.append(job.start_time + execution.status().current_time * _NANOSECOND)
        values.append(observer.last_real_values(slave, [reference])[0])
    return Trajectory(np.array(time), np.array(values))
