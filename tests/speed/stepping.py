"""What a loop of the caller's own costs: the vehicle read, set, stepped, saved and restored from Python."""

import timeit
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace

import numpy as np

from orchestration.gym import FmuEnv, FmuVectorEnv
from orchestration.run import Simulator
from orchestration.scenarios.task import Task, task_of
from tests.speed.part import Options, Part, Table

_CALLS, _REPEATS, _ROUNDS = 500, 100, 5  # the best of many short measurements: others use the processor too
_VOLTAGES = ("plant.voltage[1]", "plant.voltage[2]")


def vehicle() -> Task:
    """The vehicle of the nominal scenario, over as many steps as are measured."""
    task = task_of("nominal-extended", {"rmse": -1.0}, bounds=dict.fromkeys(_VOLTAGES, (-6.0, 6.0)))
    return replace(task, experiment=replace(task.experiment, stop_time=1e4, record=("plant.measured_depth",)))


def costs(repeats: int) -> Iterator[tuple[str, float]]:
    """(what, microseconds of one), of the vehicle."""

    def best(call: Callable[[], object]) -> float:
        return _best(call, _CALLS, repeats)

    task = vehicle()
    with Simulator(task.system) as simulator:
        simulator.start(task.experiment, external=_VOLTAGES)
        read, write = simulator.reader("plant.measured_depth"), simulator.writer(_VOLTAGES[0])
        step, save, restore = simulator.step, simulator.save, simulator.restore

        def controlled() -> None:
            write(-0.1 * read())
            step()

        yield "step", best(step)
        yield "get one value, set one and step, by a reader and a writer", best(controlled)
        state = save()
        yield "restore", best(lambda: restore(state))
        yield "save the whole system, without a step between", best(save)
        yield "step, and save", best(lambda: (step(), save()))
        yield "get by name, without a step", best(lambda: simulator.get("plant.measured_depth"))
        yield "set by name, without a step", best(lambda: simulator.set(_VOLTAGES[0], 0.0))


def environments(*numbers: int, repeats: int) -> Iterator[tuple[str, float]]:
    """(what, environment steps a second) of one environment, and of vectors of these numbers.

    Vectors by turns with a simulator for each environment and as an ensemble.
    """
    task, action = vehicle(), np.zeros(2)
    with closing(FmuEnv(task)) as env:
        env.reset()
        yield "FmuEnv", 1e6 / _best(lambda: env.step(action), _CALLS, repeats)
    for number in numbers:
        vectors = {way: FmuVectorEnv(task, number, way == "ensemble") for way in ("simulators", "ensemble")}
        actions, best = np.zeros((number, 2)), dict.fromkeys(vectors, np.inf)
        for envs in vectors.values():
            envs.reset()
        for _ in range(min(_ROUNDS, repeats)):
            for way, envs in vectors.items():
                best[way] = min(best[way], _best(lambda: envs.step(actions), 100, 10))  # noqa: B023
        for way, envs in vectors.items():
            yield f"FmuVectorEnv of {number}, {way}", number * 1e6 / best[way]
            envs.close()


def _best(call: Callable[[], object], calls: int, repeats: int) -> float:
    """Microseconds of one call."""
    return min(timeit.repeat(call, number=calls, repeat=repeats)) / calls * 1e6


def measure(options: Options) -> Part:
    """Both."""
    repeats = options.rounds(_REPEATS)
    calls = [(what, f"{microseconds:.1f}") for what, microseconds in costs(repeats)]
    numbers = (16,) if options.quick else (16, 64)
    rates = [(what, f"{rate:.0f}") for what, rate in environments(*numbers, repeats=repeats)]
    return Part([Table("calls", ("", "us"), calls), Table("environments", ("", "steps a second"), rates)])
