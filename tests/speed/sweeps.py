"""What the samples of the Monte Carlo cost beside their runs, by the command line and on a Dask cluster.

A sample is a run and its metrics. Of the command `l1-depth sweep`, CPU time is that of all its processes.
"""

import os
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from statistics import median

from fmus.build import builder
from orchestration.many.lane_library import LANES
from orchestration.run import Simulator
from orchestration.scenarios import scenario
from orchestration.sweep.plan import Plan, plan
from orchestration.sweep.run import job_of, samples_of
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
    """Sweeps in one way: (wall clock, CPU) [s] of rounds, and of those of few samples."""

    samples: int
    taken: Sequence[tuple[float, float]]
    starts: Sequence[tuple[float, float]]

    @property
    def wall(self) -> list[float]:
        return [wall_s for wall_s, _ in self.taken]

    @property
    def cpu(self) -> list[float]:
        return [cpu_s for _, cpu_s in self.taken]

    @property
    def wall_of_one_more(self) -> float:
        return (median(self.wall) - median(wall_s for wall_s, _ in self.starts)) / (self.samples - LANES)

    @property
    def cpu_of_one_more(self) -> float:
        return (median(self.cpu) - median(cpu_s for _, cpu_s in self.starts)) / (self.samples - LANES)


class Runs(AbstractContextManager["Runs"]):
    """The runs of the first samples of a plan, which record what their metrics need."""

    def __init__(self, planned: Plan, count: int) -> None:
        job = job_of(planned, None)
        self._experiments = [run.experiment for run in samples_of(planned, job.base, range(count))]
        self._simulator = Simulator(job.system, threads=1)
        self._simulator.run(job.base)

    def mean_s(self) -> float:
        """CPU seconds of a run."""
        start = time.thread_time()
        for experiment in self._experiments:
            self._simulator.run(experiment)
        return (time.thread_time() - start) / len(self._experiments)

    def __exit__(self, *_: object) -> None:
        self._simulator.close()


def command(state: State, samples: int, *options: str) -> tuple[float, float]:
    """(wall clock, CPU) [s] of a sweep by the command line."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        file = folder / "mine.toml"
        file.write_text(f'base = "{SCENARIO}"\n[sweep]\nsamples = {samples}\n', encoding="utf-8")
        return state.timed([*COMMAND, "sweep", str(file), "--out", name, *options], cwd=folder)


def compile_s(state: State) -> float:
    """CPU seconds to compile the libraries of an ensemble, with empty caches."""
    program = "import sys; from pathlib import Path; from orchestration import Ensemble, System\n"
    # the record that these FMUs were built here is in the cache that is not used
    program += "from fmus.store import record_build; fmus = [*map(Path, sys.argv[1:])]\n"
    program += "for fmu in fmus: record_build(fmu.read_bytes())\n"
    program += "Ensemble(System({str(i): fmu for i, fmu in enumerate(fmus)}))"
    fmus = [str(state.fmus / f"{name}.fmu") for name in ("L1DepthController", "RovDepthPlant")]
    with tempfile.TemporaryDirectory() as folder:
        caches = {"XDG_CACHE_HOME": folder, "ZIG_GLOBAL_CACHE_DIR": f"{folder}/zig"}
        arguments = [sys.executable, "-P", "-c", program, *fmus]
        return state.timed(arguments, environment={**state.environment, **caches})[1]


def sweeps(options: Options, samples: int, runs: Runs) -> tuple[dict[str, Way], list[float]]:
    """Each way and the runs alone [s of one], by turns; before, sweeps of few samples, which also compile."""
    ways: dict[str, tuple[State, Sequence[str]]] = {
        name: (options.now, arguments) for name, arguments in _WAYS.items()
    }
    if options.before:
        ways = {BEFORE: (options.before, ("--workers", str(_WORKERS))), **ways}
    if options.quick:
        ways = {name: way for name, way in ways.items() if name in (BEFORE, SINGLE, DEFAULT)}

    def turn(count: int) -> dict[str, tuple[float, float]]:
        return {name: command(state, count, *arguments) for name, (state, arguments) in ways.items()}

    starts = [turn(LANES) for _ in range(options.rounds(3))]
    turns = [(turn(samples), runs.mean_s()) for _ in range(options.rounds(3))]
    measured = {
        name: Way(samples, [own[name] for own, _ in turns], [own[name] for own in starts[1:] or starts])
        for name in ways
    }
    return measured, [run for _, run in turns]


def measure(options: Options) -> Part:
    """A sweep in each way, and a Dask cluster."""
    chosen = scenario.load(scenario.find(SCENARIO))
    builder.build_missing([*chosen.system.components.values()])
    samples = 50 if options.quick else _SAMPLES
    with Runs(plan(chosen), samples // 5) as runs:
        measured, alone = sweeps(options, samples, runs)
    compiled, run = compile_s(options.now), median(alone)
    sample, loss = cluster.loss(chosen, samples, _WORKERS)
    rows = [_row(name, way, run) for name, way in measured.items()]
    rows += [
        (
            f"the runs of these samples alone, from {samples // 5} of them",
            "",
            spread([samples * x for x in alone], 1, "s"),
            f"{1e3 * run:.2f} ms",
            "1",
        ),
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
    return Part([Table("sweeps", headings, rows), of_million(measured, sample / (1.0 - loss))], goals)


def _row(name: str, way: Way, run: float) -> tuple[str, ...]:
    clock, cpu = (spread(values, 1, "s") for values in (way.wall, way.cpu))
    more = way.cpu_of_one_more
    return name, clock, cpu, f"{1e3 * more:.2f} ms", f"{more / run:.2f}"


def of_million(measured: dict[str, Way], dask: float) -> Table:
    """What a million samples would take, from what one more takes; dask: s of a worker for a sample."""
    here, there = f"{_WORKERS} cores, from the clock", "from CPU time"
    rows = [
        (here, name, _duration(1e6 * way.wall_of_one_more))
        for name, way in measured.items()
        if name in (DEFAULT, THREADS, PROCESSES)
    ]
    each = 1e6 * measured.get(PROCESSES, measured[DEFAULT]).cpu_of_one_more
    rows.append((f"16 cores, {there}", "simulators, 16 processes (`--isolated`)", _duration(each / 16)))
    on_dask = "simulators on Dask, its loss to scheduling included, without the network"
    rows.append(("128 cores of several machines, from time of workers", on_dask, _duration(1e6 * dask / 128)))
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
