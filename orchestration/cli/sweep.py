"""Command sweep: a scenario run many times, with other values."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.registry import Flavour
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, Changes, takes_changes
from orchestration.many.places import AUTO
from orchestration.results.metric_units import metrics_table, values_table

if TYPE_CHECKING:
    from orchestration.sweep.plan import Plan


@takes_changes()
def sweep(
    name: shared.ScenarioArgument,
    out: shared.OutFolder = Path("results"),
    where: Annotated[
        str,
        typer.Option(
            metavar="PLACE",
            help="Run in this place: processor, one by one in each thread; vectors, samples of native FMUs "
            "together, with the same results; processes, apart from this one; gpu, the NVIDIA GPU of this "
            "machine (extra gpu); tcp://HOST:PORT, a Dask cluster. By default where it is fastest here.",
        ),
    ] = AUTO,
    workers: Annotated[
        int | None,
        typer.Option(help="Samples that run at once on this machine; by default one for each core.", min=1),
    ] = None,
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
    """Run the samples of a scenario that has a table [sweep]; an interrupted sweep continues.

    Writes SCENARIO.sweep.parquet, a row for each sample.
    For example, l1-depth sweep monte-carlo writes results/monte-carlo.sweep.parquet.
    """
    from orchestration.cli import chosen_scenario
    from orchestration.many.places import place_of
    from orchestration.sweep.plan import plan
    from orchestration.sweep.run import recorded_signals

    if sample is not None:
        alone = {"--workers": workers, "--where": where != AUTO, "--recordings": recordings}
        shared.refuse_without_effect("--sample", {**alone, "--restart": restart})
    notes: list[str] = []
    place = place_of(where, workers, notes.append)  # which may refuse, before FMUs are built
    planned = plan(chosen_scenario.load(name, flavour, changes))
    if sample is not None:
        _run_one(planned, sample, out)
        return
    recorded = recorded_signals(recordings, planned)

    from orchestration.sweep import table  # Arrow is slow to import: after what can be refused
    from orchestration.sweep.run import sweep as run_samples

    with shared.progress("sweep", planned.count, kept="samples") as bar:
        path = run_samples(planned, out, place, recorded, restart, bar.advance)
    results, provenance = table.read(path)
    print(f"{provenance['title']}: {len(results)} samples, {table.failed(results)} failed")
    for printed in table.terminal_tables(results, provenance):
        shared.print_table(printed)
    print(path)
    if recordings:
        print(out / f"{planned.scenario.name}.recordings")
    if not results[table.ERROR].null_count:
        shared.fail(
            f"every sample failed, 0 with: {results[table.ERROR][0]}; --sample 0 runs it, --restart all"
        )
    for note in notes:
        print(f"l1-depth: {note}", file=sys.stderr)


def _run_one(planned: "Plan", sample: int, out: Path) -> None:
    from orchestration.scenarios import run_files

    drawn = planned.of_sample(sample)
    result = run_files.run(drawn, out)
    if result.metrics:
        print(metrics_table(drawn.title, result.metrics, result.metric_units, drawn.metrics))
    units = {entry.target.name: entry.target.unit for entry in planned.varied}
    print(values_table(drawn.title, "Varied", planned.values(sample), units))
    print(out / f"{drawn.name}.csv")
    print(out / f"{drawn.name}.json")
