"""FMPy's own SSP master, `fmpy.ssp`.

It reads components and connections, ignores parameter bindings, starts every connector at zero without
initial exchange, and labels a row with the time before the step whose result it holds.
"""

from fmpy.ssp.simulation import simulate_ssp
from fmpy.ssp.ssd import read_ssv

from tests.importers.importer_job import ImporterJob, Trajectory


def run(job: ImporterJob) -> Trajectory:
    parameter_set = read_ssv(str(job.package), f"parameters/{job.parameter_set}.ssv")
    for parameter in parameter_set.parameters:
        if parameter.type == "Boolean":  # FMPy takes every text but a number for true
            parameter.value = parameter.value in ("true", "1")
    result = simulate_ssp(
        str(job.package), job.start_time, job.stop_time, job.step_size, parameter_set=parameter_set
    )
    return Trajectory(result["time"], result[job.output])
