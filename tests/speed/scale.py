"""How the cost of a run grows with FMUs and points, as slopes: `python -m tests.speed.scale`.

A chain of small FMUs of one file, each driven by the one before: as many connections as FMUs. CPU time. Then
FMUs with heavier steps on one thread and on as many as there are processors. What a sample of a sweep costs
is measured by `tests.speed.sweeps`, the memory of a long recording by `tests.speed.memory`.
"""

import os
import tempfile
import time
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np

from fmus import catalogue
from orchestration.master import Simulator
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.speed.pair import LEVEL, SIGNAL, STEP_SIZE, build

NUMBERS = (50, 100, 200, 400)
HEAVY = 8  # components that share threads
INTERNAL_STEPS = (1, 100, 1000, 10_000)  # in a communication step of each, of some 10 ns
_STEPS = 2000
_ROUNDS, _ROUNDS_OF_THREADS = 3, 8


def chain(fmu: Path, count: int) -> tuple[System, dict[str, float]]:
    """So many instances in a row, and the input of the first."""
    names = [f"c{i}" for i in range(count)]
    links = [(f"{a}.{LEVEL}", f"{b}.{SIGNAL}") for a, b in pairwise(names)]
    return System(dict.fromkeys(names, fmu), links), {f"c0.{SIGNAL}": 1.0}


def costs(fmu: Path, count: int) -> tuple[float, float, float]:
    """Seconds to load a chain, to prepare a run of it again, and of a communication step."""
    system, inputs = chain(fmu, count)
    taken = []
    for _ in range(_ROUNDS):
        with Simulator(system) as simulator:

            def seconds(steps: int, simulator: Simulator = simulator) -> float:
                start = time.thread_time()
                simulator.run(Experiment(steps * STEP_SIZE, STEP_SIZE, inputs=inputs))
                return time.thread_time() - start

            first, again = seconds(1), seconds(1)
            taken.append((first - again, again, (seconds(_STEPS) - again) / _STEPS))
    load, prepare, step = (median(column) for column in zip(*taken, strict=True))
    return load, prepare, step


def threads(internal_steps: int) -> tuple[float, float, float]:
    """Wall clock [s] of a step of `HEAVY` FMUs on one thread, on all, and as a simulator decides."""
    fmu, step = catalogue.build_if_stale("ExamplePlant"), 1e-3
    names = [f"c{i}" for i in range(HEAVY)]
    system = System(dict.fromkeys(names, fmu))
    count = max(20, 200_000 // internal_steps // HEAVY)
    experiment = Experiment(
        count * step,
        step,
        parameters={f"{name}.internal_step": step / internal_steps for name in names},
        inputs={f"{name}.{variable}": 0.1 for name in names for variable in ("control", "disturbance")},
    )
    with ExitStack() as stack:
        ways = (1, os.cpu_count() or 1, None)
        simulators = [stack.enter_context(Simulator(system, threads=way)) for way in ways]
        taken = []
        for _ in range(_ROUNDS_OF_THREADS):
            turn = []
            for simulator in simulators:
                start = time.perf_counter()
                simulator.run(experiment)
                turn.append((time.perf_counter() - start) / count)
            taken.append(turn)
    single, together, decided = (median(column) for column in zip(*taken[1:], strict=True))
    return single, together, decided


def main() -> None:
    """Print what each number of FMUs costs, and the slopes."""
    with tempfile.TemporaryDirectory() as folder:
        fmu = build(Path(folder)).fmus["first"]
        measured = [costs(fmu, count) for count in NUMBERS]
    print("FMUs    load   prepare      step")
    for count, (load, prepare, step) in zip(NUMBERS, measured, strict=True):
        print(f"{count:4} {1e3 * load:5.0f} ms {1e3 * prepare:5.0f} ms {1e6 * step:6.2f} us")
    for what, column in zip(("load", "prepare", "step"), zip(*measured, strict=True), strict=True):
        slope, offset = np.polyfit(NUMBERS, column, 1)
        worst = max(abs(slope * n + offset - x) / x for n, x in zip(NUMBERS, column, strict=True))
        print(
            f"{what}: {1e6 * slope:.2f} us an FMU, {1e3 * offset:.2f} ms beside; within {100 * worst:.0f} %"
        )

    for steps in INTERNAL_STEPS:
        single, together, decided = (1e6 * seconds for seconds in threads(steps))
        ratios = f"on {os.cpu_count()} threads {together / single:.2f}, as decided {decided / single:.2f}"
        print(f"{HEAVY} FMUs of {steps} internal steps: {single:.1f} us on one thread; {ratios} of that")


if __name__ == "__main__":
    main()
