"""What a loop of the caller's own costs: the vehicle read, set, stepped, saved and restored from Python."""

import timeit
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np

from orchestration.gym import FmuEnv, FmuVectorEnv
from orchestration.master import Simulator
from orchestration.scenarios.task import Task, task_of

_CALLS, _REPEATS, _ROUNDS = 500, 100, 5  # the best of many short measurements: others use the processor too
_VOLTAGES = ("plant.voltage[1]", "plant.voltage[2]")


def vehicle() -> Task:
    """The vehicle of the nominal scenario, over as many steps as are measured."""
    task = task_of("nominal-extended", {"rmse": -1.0}, bounds=dict.fromkeys(_VOLTAGES, (-6.0, 6.0)))
    return replace(task, experiment=replace(task.experiment, stop_time=1e4, record=("plant.measured_depth",)))


def costs() -> Iterator[tuple[str, float]]:
    """(what, microseconds of one), of the vehicle."""
    task = vehicle()
    with Simulator(task.system) as simulator:
        simulator.start(task.experiment, external=_VOLTAGES)
        read, write = simulator.reader("plant.measured_depth"), simulator.writer(_VOLTAGES[0])
        step, save, restore = simulator.step, simulator.save, simulator.restore

        def controlled() -> None:
            write(-0.1 * read())
            step()

        yield "step", _best(step)
        yield "get, set and step", _best(controlled)
        state = save()
        yield "restore", _best(lambda: restore(state))
        yield "save", _best(save)
        yield "step and save", _best(lambda: (step(), save()))
        yield "get by name", _best(lambda: simulator.get("plant.measured_depth"))
        yield "set by name", _best(lambda: simulator.set(_VOLTAGES[0], 0.0))


def environments(*numbers: int) -> Iterator[tuple[str, float]]:
    """(what, environment steps a second) of one environment, and of vectors of these numbers.

    Vectors by turns with a simulator for each environment and as an ensemble.
    """
    task, action = vehicle(), np.zeros(2)
    with closing(FmuEnv(task)) as env:
        env.reset()
        yield "FmuEnv", 1e6 / _best(lambda: env.step(action))
    for number in numbers:
        vectors = {way: FmuVectorEnv(task, number, way == "ensemble") for way in ("simulators", "ensemble")}
        actions, best = np.zeros((number, 2)), dict.fromkeys(vectors, np.inf)
        for envs in vectors.values():
            envs.reset()
        for _ in range(_ROUNDS):
            for way, envs in vectors.items():
                best[way] = min(best[way], _best(lambda: envs.step(actions), 100, 10))  # noqa: B023
        for way, envs in vectors.items():
            yield f"FmuVectorEnv of {number}, {way}", number * 1e6 / best[way]
            envs.close()


def _best(call: Callable[[], object], calls: int = _CALLS, repeats: int = _REPEATS) -> float:
    """Microseconds of one call."""
    return min(timeit.repeat(call, number=calls, repeat=repeats)) / calls * 1e6


if __name__ == "__main__":
    for what, microseconds in costs():
        print(f"{what:20} {microseconds:8.2f} us")
    for what, rate in environments(16, 64):
        print(f"{what:32} {rate:8.0f} steps a second")
