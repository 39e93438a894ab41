"""How the cost of a run grows with FMUs and points, as slopes: `python -m tests.speed.scale`.

A chain of small FMUs of one file, each driven by the one before: as many connections as FMUs. CPU time. What
a sample of a sweep costs is measured by `tests.speed.sweeps`, the memory of a long recording by `.memory`.
"""

import tempfile
import time
from itertools import pairwise
from pathlib import Path
from statistics import median

import numpy as np

from orchestration.master import Simulator
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.speed.pair import LEVEL, SIGNAL, STEP_SIZE, build

NUMBERS = (50, 100, 200, 400)
_STEPS = 2000
_ROUNDS = 3


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


if __name__ == "__main__":
    main()
