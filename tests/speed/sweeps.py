"""What the samples of the Monte Carlo cost beside their runs, by the command line and on a Dask cluster.

A sample is a run and its metrics. Of the command `l1-depth sweep`, CPU time is that of all its processes.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from fmus import catalogue
from fmus.lanes import LANES
from orchestration.master import Simulator
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from tests.speed import cluster
from tests.speed.part import Goal, Options, Part, Table, spread
from tests.speed.states import COMMAND, State

SCENARIO = "monte-carlo"
_SAMPLES = 1000
_WORKERS = os.cpu_count() or 1
BEFORE, DEFAULT = f"before: {_WORKERS} processes", f"ensembles, {_WORKERS} threads"
SINGLE, THREADS = "ensembles, one thread", f"simulators, {_WORKERS} threads"
PROCESSES = f"simulators, {_WORKERS} processes"
_WAYS = {
    SINGLE: ("--workers", "1", "--ensemble"),
    DEFAULT: ("--workers", str(_WORKERS), "--ensemble"),
    "simulators, one thread": ("--workers", "1", "--no-ensemble"),
    THREADS: ("--workers", str(_WORKERS), "--no-ensemble"),
    PROCESSES: ("--workers", str(_WORKERS), "--isolated"),
}


@dataclass(frozen=True)
class Way:
    """Sweeps in one way: times [s] of each round, and of a sweep of few samples on the clock and of CPU."""

    samples: int
    wall: Sequence[float]
    cpu: Sequence[float]
    start: tuple[float, float]

    @property
    def wall_of_one_more(self) -> float:
        return (median(self.wall) - self.start[0]) / (self.samples - LANES)

    @property
    def cpu_of_one_more(self) -> float:
        return (median(self.cpu) - self.start[1]) / (self.samples - LANES)


def run_s(chosen: Scenario, count: int) -> float:
    """CPU seconds of a run with all that it records: median."""
    taken = []
    with Simulator(chosen.system) as simulator:
        simulator.run(chosen.experiment)
        for _ in range(count):
            start = time.thread_time()
            simulator.run(chosen.experiment)
            taken.append(time.thread_time() - start)
    return median(taken)


def command(state: State, samples: int, *options: str) -> tuple[float, float]:
    """(wall clock, CPU) [s] of a sweep by the command line."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mine.toml"
        file.write_text(f'base = "{SCENARIO}"\n[sweep]\nsamples = {samples}\n', encoding="utf-8")
        before, start = children_s(), time.perf_counter()
        subprocess.run(
            [*COMMAND, "sweep", str(file), "--out", folder, *options],
            cwd=folder,
            check=True,
            env=state.environment,
            capture_output=True,
        )
        return time.perf_counter() - start, children_s() - before


def compile_s(state: State) -> float:
    """CPU seconds to compile the libraries of an ensemble, with empty caches."""
    program = "import sys; from pathlib import Path; from orchestration import Ensemble, System\n"
    program += "Ensemble(System({str(i): Path(fmu) for i, fmu in enumerate(sys.argv[1:])}))"
    with tempfile.TemporaryDirectory() as folder:
        environment = {
            **state.environment,
            "XDG_CACHE_HOME": folder,
            "ZIG_GLOBAL_CACHE_DIR": f"{folder}/zig",
        }
        fmus = [str(state.fmus / f"{name}.fmu") for name in ("L1DepthController", "RovDepthPlant")]
        before = children_s()
        subprocess.run([sys.executable, "-P", "-c", program, *fmus], check=True, env=environment)
        return children_s() - before


def children_s() -> float:
    """CPU seconds of all processes that were started and have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def sweeps(options: Options, samples: int) -> dict[str, Way]:
    """Each way, by turns, after a sweep of few samples, which compiles and imports what is needed once."""
    ways: dict[str, tuple[State, Sequence[str]]] = {
        name: (options.now, arguments) for name, arguments in _WAYS.items()
    }
    if options.before:
        ways = {BEFORE: (options.before, ("--workers", str(_WORKERS))), **ways}
    if options.quick:
        ways = {name: way for name, way in ways.items() if name in (BEFORE, SINGLE, DEFAULT)}
    starts = {}
    for _ in range(options.rounds(2)):
        for name, (state, arguments) in ways.items():
            starts[name] = command(state, LANES, *arguments)
    turns = [
        {name: command(state, samples, *arguments) for name, (state, arguments) in ways.items()}
        for _ in range(options.rounds(3))
    ]
    return {
        name: Way(samples, [x[name][0] for x in turns], [x[name][1] for x in turns], starts[name])
        for name in ways
    }


def measure(options: Options) -> Part:
    """A sweep in each way, and a Dask cluster."""
    chosen = scenario.load(scenario.find(SCENARIO))
    catalogue.build_missing([*chosen.system.components.values()])
    samples = 50 if options.quick else _SAMPLES
    run = run_s(chosen, 60)
    measured, compiled = sweeps(options, samples), compile_s(options.now)
    sample, loss = cluster.loss(chosen, samples, _WORKERS)
    rows = [_row(name, way, run) for name, way in measured.items()]
    rows += [
        (f"{samples} runs alone", "", f"{samples * run:.1f} s", f"{1e3 * run:.2f} ms", "1"),
        ("to compile what ensembles need, once for each user", "", f"{compiled:.1f} s", "", ""),
    ]
    headings = (
        f"{samples} samples, recording off",
        "on the clock",
        "CPU of all processes",
        "CPU of a sample more",
        "in runs",
    )
    lost = f"{100 * loss:.1f} % at {1e3 * sample:.0f} ms a sample"
    goals = _goals(measured, samples, run)
    goals.append(Goal(f"lost to scheduling by {_WORKERS} workers of a Dask cluster", "10 %", lost))
    return Part([Table("sweeps", headings, rows), of_million(measured)], goals)


def _row(name: str, way: Way, run: float) -> tuple[str, ...]:
    clock, cpu = (spread(values, 1, "s") for values in (way.wall, way.cpu))
    more = way.cpu_of_one_more
    return name, clock, cpu, f"{1e3 * more:.2f} ms", f"{more / run:.2f}"


def of_million(measured: dict[str, Way]) -> Table:
    """What a million samples would take, from what one more takes."""
    here, there = f"{_WORKERS} cores, from the clock", "from CPU time"
    rows = [
        (here, name, _duration(1e6 * way.wall_of_one_more))
        for name, way in measured.items()
        if name in (DEFAULT, THREADS, PROCESSES)
    ]
    each = 1e6 * measured.get(PROCESSES, measured[DEFAULT]).cpu_of_one_more
    rows.append((f"16 cores, {there}", "simulators, 16 processes (`--isolated`)", _duration(each / 16)))
    rows.append((f"128 cores of several machines, {there}", "simulators on Dask", _duration(each / 128)))
    return Table("million", ("on", "how", "a million samples"), rows)


def _duration(seconds: float) -> str:
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.0f} s"


def _goals(measured: dict[str, Way], samples: int, run: float) -> list[Goal]:
    now, before = measured[DEFAULT], measured.get(BEFORE)
    what = f"{samples} samples of the Monte Carlo"
    return [
        Goal(
            f"{what}: CPU time",
            f"{1.3 * samples * run + 2.0:.1f} s: 1.3 times the runs alone, and 2 s",
            f"{median(now.cpu):.1f} s",
            f"{median(before.cpu):.1f} s" if before else "",
        ),
        Goal(
            f"{what}: on the clock, {_WORKERS} cores",
            "6 s",
            f"{median(now.wall):.1f} s",
            f"{median(before.wall):.1f} s" if before else "",
        ),
    ]
