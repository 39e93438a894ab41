"""libcosim, all steps asked for at once; an observer sees the last values alone."""

from libcosimpy.CosimExecution import CosimExecution
from libcosimpy.CosimObserver import CosimObserver

from tests.speed.pair import LEVEL, STEP_SIZE, Pair


def run(pair: Pair, steps: int) -> float:
    execution = CosimExecution.from_ssp_file(str(pair.package), round(1e9 * STEP_SIZE))
    observer = CosimObserver.create_last_value()
    execution.add_observer(observer)
    if not execution.step(steps):
        raise RuntimeError("a step failed")
    instance = execution.slave_index_from_instance_name("first")
    if instance is None:
        raise RuntimeError("expected a component called first")
    (reference,) = [v.reference for v in execution.slave_variables(instance) if v.name.decode() == LEVEL]
    return observer.last_real_values(instance, [reference])[0]
