"""Command sweep: a scenario many times, with other values each time."""

import os
from pathlib import Path
from typing import Annotated

import typer

from fmus.registry import Flavour
from orchestration.cli.shared import FlavourOption, OutFolder, bar, console, shipped_or_own
from orchestration.errors import SweepError
from orchestration.results import figures as report
from orchestration.scenarios import reproduce
from orchestration.sweep import table
from orchestration.sweep.job import signals
from orchestration.sweep.plan import Plan, plan
from orchestration.sweep.summary import summary_table


def sweep(
    name: Annotated[
        str, typer.Argument(metavar="SCENARIO", help="A shipped scenario or a .toml file, with [sweep].")
    ],
    out: OutFolder = Path("results"),
    workers: Annotated[int, typer.Option(help="Processes on this machine.", min=1)] = os.cpu_count() or 1,
    scheduler: Annotated[
        str, typer.Option(metavar="ADDRESS", help="Of a Dask cluster to run on instead, tcp://HOST:PORT.")
    ] = "",
    recordings: Annotated[
        str,
        typer.Option(
            metavar="SIGNALS", help="Keep these signals of every sample, separated by commas; all for all."
        ),
    ] = "",
    sample: Annotated[
        int | None,
        typer.Option(metavar="NUMBER", help="Run this sample alone, and keep its recording.", min=0),
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Discard what an earlier sweep of that name has left.")
    ] = False,
    flavour: FlavourOption = Flavour.NATIVE,
) -> None:
    """Run the samples of a scenario's sweep; an interrupted one goes on where it was."""
    wanted = plan(shipped_or_own(name, flavour))
    if sample is not None:
        _one(wanted, sample, out)
        return
    path = _sweep(wanted, out, signals(recordings, wanted), restart, scheduler, workers)
    console.print(summary_table(*table.read(path)))
    print(path)
    if recordings:
        print(path.with_suffix(".recordings"))


def _one(wanted: Plan, sample: int, out: Path) -> None:
    chosen = wanted.of_sample(sample)
    result = reproduce.run(chosen, out)
    if result.metrics:
        console.print(report.metrics_table(chosen.title, result.metrics))
    for name, value in wanted.values(sample).items():
        print(f"{name} = {value}")
    print(out / f"{chosen.name}.csv")
    print(out / f"{chosen.name}.json")


def _sweep(
    wanted: Plan,
    out: Path,
    kept: tuple[str, ...] | None,
    restart: bool,
    scheduler: str,
    workers: int,
) -> Path:
    from orchestration.sweep import cluster  # Dask takes its time to import, and only this needs it
    from orchestration.sweep.run import sweep as sweep_in

    count = 0
    place = cluster.remote(scheduler) if scheduler else cluster.local(workers)
    with bar(wanted.count, "sample", "sweep") as shown:

        def progress(more: int) -> None:
            nonlocal count
            count += more
            shown.update(more)

        try:
            return sweep_in(wanted, out, place, kept, restart, progress)
        except KeyboardInterrupt:
            raise SweepError(
                f"interrupted: {count} of {wanted.count} samples are done and kept; the same command goes on"
            ) from None
