"""What the samples of the Monte Carlo cost beside their runs: `python -m tests.speed.sweeps`.

A sample is a run and its metrics. Of the command `l1-depth sweep`, CPU time is that of all its processes: by
turns with simulators alone (`--no-ensemble`), as before samples stepped together, and with ensembles, as by
default once their FMUs are compiled. On a Dask cluster of this machine, the loss is the part of the workers'
time in which they run no sample.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Annotated

import typer

from fmus import catalogue
from fmus.lanes import LANES
from orchestration.master import Simulator
from orchestration.results import metrics
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.sweep.plan import plan
from orchestration.sweep.samples import Job
from orchestration.sweep.workers import Batches
from tests.local_cluster import local_cluster

_ROOT = Path(__file__).parents[2]
_COMMAND = [sys.executable, "-P", "-c", "from orchestration.cli import main; main()", "sweep"]


def runs(chosen: Scenario, count: int = 60) -> tuple[float, float]:
    """CPU seconds of a run with all that it records, and of its metrics; medians."""
    of_runs, of_metrics = [], []
    with Simulator(chosen.system) as simulator:
        simulator.run(chosen.experiment)
        for _ in range(count):
            start = time.thread_time()
            recording = simulator.run(chosen.experiment)
            middle = time.thread_time()
            metrics.evaluate(recording, chosen.metrics)
            of_runs.append(middle - start)
            of_metrics.append(time.thread_time() - middle)
    return median(of_runs), median(of_metrics)


def command(name: str, samples: int, *options: str) -> tuple[float, float]:
    """(wall clock, CPU) [s] of a sweep by the command line."""
    environment = {**os.environ, "PYTHONPATH": str(_ROOT)}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mine.toml"
        file.write_text(f'base = "{name}"\n[sweep]\nsamples = {samples}\n', encoding="utf-8")
        before, start = _children_s(), time.perf_counter()
        subprocess.run(
            [*_COMMAND, str(file), "--out", folder, *options],
            check=True,
            env=environment,
            capture_output=True,
        )
        return time.perf_counter() - start, _children_s() - before


def compile_s(chosen: Scenario) -> float:
    """CPU seconds to compile the libraries of an ensemble, with empty caches."""
    program = "import sys; from pathlib import Path; from orchestration import Ensemble, System\n"
    program += "Ensemble(System({str(i): Path(fmu) for i, fmu in enumerate(sys.argv[1:])}))"
    with tempfile.TemporaryDirectory() as folder:
        caches = {"XDG_CACHE_HOME": folder, "ZIG_GLOBAL_CACHE_DIR": f"{folder}/zig"}
        environment = {**os.environ, **caches, "PYTHONPATH": str(_ROOT)}
        fmus = map(str, chosen.system.components.values())
        before = _children_s()
        subprocess.run([sys.executable, "-P", "-c", program, *fmus], check=True, env=environment)
        return _children_s() - before


def _children_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


class _Measured(Batches):
    """Batches that sum up how long they were run."""

    seconds = 0.0

    def note(self, count: int, seconds: float, rest: Sequence[int] = ()) -> None:
        self.seconds += seconds
        super().note(count, seconds, rest)


def loss_on_a_cluster(chosen: Scenario, samples: int, workers: int) -> tuple[float, float]:
    """(seconds of a sample, share of the workers' time without one), from the first finished batch on."""
    planned = plan(chosen)
    batches = _Measured(range(samples), samples)
    done, start, before = 0, 0.0, 0.0
    with local_cluster(workers) as started:
        for finished in started.run(planned, Job.of(planned, None), batches):
            if not start and done >= workers:  # each has loaded its FMUs
                start, before, done = time.perf_counter(), batches.seconds, 0
            done += len(finished.numbers)
        wall = time.perf_counter() - start
    busy = batches.seconds - before
    return busy / done, 1.0 - busy / (workers * wall)


def main(
    name: Annotated[str, typer.Argument(help="A scenario with a sweep.")] = "monte-carlo",
    samples: Annotated[int, typer.Option(min=20)] = 1000,
    workers: Annotated[int, typer.Option(min=1)] = os.cpu_count() or 1,
    rounds: Annotated[int, typer.Option(help="Measurements of which the median is taken.", min=1)] = 3,
    dask: Annotated[bool, typer.Option(help="Measure a Dask cluster of this machine too.")] = True,
) -> None:
    """Measure a sweep beside its bare runs."""
    chosen = scenario.load(scenario.find(name))
    catalogue.build_missing([*chosen.system.components.values()])
    run_s, metrics_s = runs(chosen)
    print(f"a run {1e3 * run_s:.2f} ms of CPU, its metrics {1e3 * metrics_s:.2f} ms: {metrics_s / run_s:.3f}")
    bound = 1.3 * samples * run_s + 2.0
    print(f"{samples} bare runs {samples * run_s:.1f} s of CPU; 1.3 times that and 2 s: {bound:.1f} s")
    print(f"to compile for ensembles: {compile_s(chosen):.1f} s of CPU, once")
    ways = {
        "one thread of simulators": ["--workers", "1", "--no-ensemble"],
        f"{workers} threads of simulators": ["--workers", str(workers), "--no-ensemble"],
        f"{workers} processes of simulators": ["--workers", str(workers), "--isolated"],
        "one thread of ensembles": ["--workers", "1", "--ensemble"],
        f"{workers} threads of ensembles": ["--workers", str(workers), "--ensemble"],
    }
    command(name, LANES, "--ensemble")  # which are compiled now
    turns = [[command(name, samples, *options) for options in ways.values()] for _ in range(rounds)]
    for way, measured in zip(ways, zip(*turns, strict=True), strict=True):
        wall, cpu = (median(part) for part in zip(*measured, strict=True))
        least, most = min(part[1] for part in measured), max(part[1] for part in measured)
        ratio = cpu / (samples * run_s)
        spread = f"({least:.1f} to {most:.1f})"
        print(f"{way:27}: {wall:5.1f} s, CPU {cpu:5.1f} s {spread}, {ratio:.2f} of the bare runs")
    if dask:
        sample_s, loss = loss_on_a_cluster(chosen, samples, workers)
        print(f"Dask, {workers} workers: {1e3 * sample_s:.1f} ms a sample, {100 * loss:.1f} % lost")


if __name__ == "__main__":
    typer.run(main)
