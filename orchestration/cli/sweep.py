"""Command sweep: a scenario many times, with other values each time."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.operating_system import usable_processors
from fmus.registry import Flavour
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, Changes, takes_changes
from orchestration.cli.interrupts import INTERRUPTED

if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager

    from orchestration.many.job import Place
    from orchestration.sweep.plan import Plan


@takes_changes
def sweep(
    name: shared.ScenarioArgument,
    out: shared.OutFolder = Path("results"),
    workers: Annotated[
        int | None,
        typer.Option(
            help="Run so many samples at once on this machine; by default one for each core.", min=1
        ),
    ] = None,
    isolated: Annotated[
        bool,
        typer.Option(
            "--isolated", help="Run FMUs in processes apart, also those that are known to need none."
        ),
    ] = False,
    ensemble: Annotated[
        bool | None,
        typer.Option(
            "--ensemble/--no-ensemble",
            help="Step samples of native FMUs together, in vectors, with the same rows; "
            "by default where it is faster.",
        ),
    ] = None,
    scheduler: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Run on the Dask cluster at this address instead, tcp://HOST:PORT."
        ),
    ] = "",
    recordings: Annotated[
        str,
        typer.Option(
            metavar="SIGNALS",
            help="Keep these signals of every sample, separated by commas; all keeps all of them.",
        ),
    ] = "",
    sample: Annotated[
        int | None,
        typer.Option(metavar="NUMBER", help="Run this sample alone, and keep its recording.", min=0),
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="Discard the samples of an earlier sweep of that name.")
    ] = False,
    flavour: shared.FlavourOption = Flavour.NATIVE,
    changes: Changes = NO_CHANGES,
) -> None:
    """Run the samples of a scenario that has a table [sweep]; an interrupted sweep continues."""
    from orchestration.cli import chosen_scenario
    from orchestration.sweep.plan import plan
    from orchestration.sweep.run import recorded_signals

    alone = {"--workers": workers, "--isolated": isolated, "--scheduler": scheduler}
    alone |= {"--recordings": recordings, "--restart": restart, "--ensemble": ensemble}
    if sample is not None:
        shared.refuse_without_effect("--sample", alone)
    if scheduler:
        local_options = {"--workers": workers, "--isolated": isolated, "--ensemble": ensemble}
        shared.refuse_without_effect("--scheduler", local_options)
    planned = plan(chosen_scenario.load(name, flavour, changes))
    if sample is not None:
        _run_one(planned, sample, out)
        return
    recorded = recorded_signals(recordings, planned)

    from orchestration.sweep import table  # Arrow is slow to import: after what can be refused
    from orchestration.sweep.run import sweep as run_samples
    from orchestration.sweep.table import summary_table

    notes: list[str] = []
    started = _workers(workers, isolated, ensemble, scheduler, notes.append)
    with shared.progress("sweep", planned.count) as bar:
        try:
            path = run_samples(planned, out, started, recorded, restart, bar.advance)
        except KeyboardInterrupt:
            shared.fail(
                f"interrupted: {bar.done} of {planned.count} samples are done and kept; "
                "the same command continues",
                INTERRUPTED,
            )
    results, provenance = table.read(path)
    shared.print_table(summary_table(results, provenance))
    print(*notes, sep="\n", end="\n" * bool(notes))
    print(path)
    if recordings:
        print(path.with_suffix(".recordings"))
    if not results[table.ERROR].null_count:
        shared.fail(
            f"every sample failed, 0 with: {results[table.ERROR][0]}; --sample 0 runs it, --restart all"
        )


def _workers(
    count: int | None,
    isolated: bool,
    ensemble: bool | None,
    scheduler: str,
    note: "Callable[[str], object]",
) -> "AbstractContextManager[Place]":
    if scheduler:
        from orchestration.many import cluster  # Dask is slow to import

        return cluster.remote(scheduler)
    from orchestration.many.run_many import LocalRuns

    return LocalRuns(count or usable_processors(), isolated, ensemble, note)


def _run_one(planned: "Plan", sample: int, out: Path) -> None:
    from orchestration.results.metric_units import metrics_table, values_table
    from orchestration.scenarios import run_files

    drawn = planned.of_sample(sample)
    result = run_files.run(drawn, out)
    if result.metrics:
        print(metrics_table(drawn.title, result.metrics, result.metric_units, drawn.metrics))
    units = {entry.target.name: entry.target.unit for entry in planned.varied}
    print(values_table(drawn.title, "Varied", planned.values(sample), units))
    print(out / f"{drawn.name}.csv")
    print(out / f"{drawn.name}.json")
