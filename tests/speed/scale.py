"""How the cost of a run grows with FMUs, as slopes; and steps of heavy FMUs on several threads.

A chain of small FMUs of one file, each driven by the one before: as many connections as FMUs. CPU time, but
of threads.
"""

import os
import shutil
import time
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import median

import numpy as np

from fmus.build import builder
from orchestration.run import Simulator
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.speed import pair
from tests.speed.pair import LEVEL, SIGNAL, STEP_SIZE
from tests.speed.part import Goal, Options, Part, Table
from tests.speed.states import State

NUMBERS = (50, 100, 200, 400)
FEWER = (25, 50, 100)  # of one file each, and before: each takes far longer to load
HEAVY = 8  # components that share threads
INTERNAL_STEPS = (1, 100, 1000, 10_000)  # in a communication step of each, of some 10 ns
_QUANTITIES = ("load", "prepare a run again", "a communication step")
_OF_OWN_FILES = "load, each from a file of its own"
_STEPS = 15_500  # of the nominal scenario
_Costs = tuple[float, float, float]
Slope = tuple[float, float, float]


def costs(state: State, fmus: Path, count: int, rounds: int) -> _Costs:
    """CPU seconds to load a chain, to prepare a run of it again, and of a communication step: medians."""
    arguments = fmus, SIGNAL, LEVEL, STEP_SIZE, count
    turns = [[*map(float, state.output_of("chain.py", *arguments))] for _ in range(rounds)]
    load, prepare, step = (median(column) for column in zip(*turns, strict=True))
    return load, prepare, step


def slope(numbers: Sequence[int], values: Sequence[float]) -> Slope:
    """(slope, offset, largest relative distance of a value) of the line nearest to the values."""
    rise, offset = np.polyfit(numbers, values, 1)
    worst = max(abs(rise * n + offset - x) / x for n, x in zip(numbers, values, strict=True))
    return float(rise), float(offset), float(worst)


def threads(internal_steps: int, rounds: int) -> _Costs:
    """Wall clock [s] of a step of `HEAVY` FMUs on one thread, on all, and as a simulator decides."""
    fmu, step = builder.build_if_stale("ExamplePlant"), 1e-3
    names = [f"c{i}" for i in range(HEAVY)]
    system = System(dict.fromkeys(names, fmu))
    count = max(100, 1_000_000 // internal_steps)  # some 0.3 s, of which the decision takes a part
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
        for _ in range(1 + rounds):
            turn = []
            for simulator in simulators:
                start = time.perf_counter()
                simulator.run(experiment)
                turn.append((time.perf_counter() - start) / count)
            taken.append(turn)
    single, together, decided = (median(column) for column in zip(*taken[1:], strict=True))
    return single, together, decided


def measure(options: Options) -> Part:
    """Chains in each state, and threads."""
    folder = options.folder / "chain"
    folder.mkdir()
    numbers, fewer = ((2, 4), (2, 4)) if options.quick else (NUMBERS, FEWER)
    one, many = _folders(options.folder / "chain", fewer[-1])
    for state in options.states:
        costs(state, one, 2, 1)  # which compiles what every chain needs
    rounds = options.rounds(3)
    measured = [costs(options.now, one, count, rounds) for count in numbers]
    slopes = [slope(numbers, column) for column in zip(*measured, strict=True)]
    own_load, *_ = _slopes(options.now, many, fewer, rounds)
    before = ""
    if options.before:
        load, *_ = _slopes(options.before, one, fewer, options.rounds(2))
        before = f"{1e3 * load[0]:.1f} ms"
    goal = Goal("load one more FMU of a file", "2 ms", f"{1e3 * slopes[0][0]:.2f} ms", before)
    tables = [of_chains(numbers, measured), of_slopes([*slopes, own_load]), of_thousand([*slopes, own_load])]
    return Part([*tables, _of_threads(options)], [goal])


def _slopes(state: State, folder: Path, numbers: Sequence[int], rounds: int) -> list[Slope]:
    measured = [costs(state, folder, count, rounds) for count in numbers]
    return [slope(numbers, column) for column in zip(*measured, strict=True)]


def _folders(folder: Path, count: int) -> tuple[Path, Path]:
    """A folder with one small FMU, and one with so many files of it."""
    built, one, many = (folder / name for name in ("built", "one", "many"))
    for path in (built, one, many):
        path.mkdir(parents=True)
    fmu = pair.build(built).fmus["first"]
    shutil.copy(fmu, one)
    for i in range(count):
        shutil.copy(fmu, many / f"{i}.fmu")
    return one, many


def of_chains(numbers: Sequence[int], measured: Sequence[_Costs]) -> Table:
    rows = [
        (f"{count}", f"{1e3 * load:.1f} ms", f"{1e3 * prepare:.1f} ms", f"{1e6 * step:.2f} us")
        for count, (load, prepare, step) in zip(numbers, measured, strict=True)
    ]
    return Table("chains", ("FMUs", *_QUANTITIES), rows)


def of_slopes(slopes: Sequence[Slope]) -> Table:
    rows = [
        (what, f"{1e6 * rise:.3f} us", f"{1e3 * offset:.2f} ms", f"{100 * worst:.0f} %")
        for what, (rise, offset, worst) in zip((*_QUANTITIES, _OF_OWN_FILES), slopes, strict=True)
    ]
    return Table("slopes", ("", "each FMU more", "beside", "the line holds within"), rows)


def of_thousand(slopes: Sequence[Slope]) -> Table:
    """What a thousand small FMUs would take."""
    load, prepare, step, own_load = (1000 * rise + offset for rise, offset, _ in slopes)
    rows = [
        ("load, of one file", f"{load:.2f} s"),
        ("load, each from a file of its own", f"{own_load:.2f} s"),
        ("prepare each run", f"{prepare:.2f} s"),
        ("a communication step", f"{1e6 * step:.0f} us"),
        (f"{_STEPS} steps", f"{_STEPS * step:.2f} s"),
    ]
    return Table("thousand", ("a thousand small FMUs", "extrapolated"), rows)


def _of_threads(options: Options) -> Table:
    rows = []
    for steps in INTERNAL_STEPS[: options.rounds(len(INTERNAL_STEPS))]:
        single, together, decided = threads(steps, options.rounds(5))
        times = f"{1e6 * single:.1f} us", f"{together / single:.2f}", f"{decided / single:.2f}"
        rows.append((f"{steps}", *times))
    count = os.cpu_count()
    headings = (
        f"internal steps of each of {HEAVY} FMUs",
        "a step on one thread",
        f"on {count} threads",
        "as a simulator decides",
    )
    return Table("threads", headings, rows)
