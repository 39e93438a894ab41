"""FMPy's `FMU2Slave` in a Python loop, nothing recorded."""

from tests.speed.loops.instances import loaded
from tests.speed.pair import STEP_SIZE, Pair


def run(pair: Pair, steps: int) -> float:
    with loaded(pair) as (first, second, signal, level):
        (of_first,), (of_second,) = first.getReal([level]), second.getReal([level])
        for i in range(steps):
            first.setReal([signal], [of_second])
            second.setReal([signal], [of_first])
            first.doStep(i * STEP_SIZE, STEP_SIZE)
            second.doStep(i * STEP_SIZE, STEP_SIZE)
            (of_first,), (of_second,) = first.getReal([level]), second.getReal([level])
        return of_first
