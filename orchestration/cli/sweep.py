"""Commands that run a scenario many times: sweep, with other values, and margins, with delays and gains."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.files import write_json_atomically
from fmus.operating_system import usable_processors
from fmus.registry import Flavour
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, Changes, takes_changes
from orchestration.errors import OrchestrationError
from orchestration.results.metric_units import metrics_table, values_table

if TYPE_CHECKING:
    from rich.table import Table

    from orchestration.margins.margins import Margins
    from orchestration.sweep.plan import Plan


@takes_changes()
def sweep(
    name: shared.ScenarioArgument,
    out: shared.OutFolder = Path("results"),
    workers: Annotated[
        int | None,
        typer.Option(help="Samples that run at once on this machine; by default one for each core.", min=1),
    ] = None,
    isolated: Annotated[
        bool,
        typer.Option(
            "--isolated", help="Run FMUs in worker processes, also those known to be safe in this one."
        ),
    ] = False,
    ensemble: Annotated[
        bool | None,
        typer.Option(
            "--ensemble/--no-ensemble",
            help="Step many samples of native FMUs together, in vectors, with the same results; "
            "by default where it is faster.",
        ),
    ] = None,
    scheduler: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Run on the Dask cluster at this address instead, tcp://HOST:PORT."
        ),
    ] = "",
    gpu: Annotated[
        bool,
        typer.Option("--gpu", help="Run all samples on this machine's NVIDIA GPU (extra gpu)."),
    ] = False,
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
    from orchestration.sweep.plan import plan
    from orchestration.sweep.run import recorded_signals

    alone = {"--workers": workers, "--isolated": isolated, "--scheduler": scheduler}
    alone |= {"--recordings": recordings, "--restart": restart, "--ensemble": ensemble}
    if sample is not None:
        shared.refuse_without_effect("--sample", alone)
    local_options = {"--workers": workers, "--isolated": isolated, "--ensemble": ensemble is not None}
    for option, is_given in {"--gpu": gpu, "--scheduler": bool(scheduler)}.items():
        if is_given:
            shared.refuse_without_effect(option, local_options)
            local_options |= {option: True}
    from orchestration.many.device import GPU, PROCESSOR, device_of

    where = GPU if gpu else PROCESSOR
    device_of(where)  # refuses a machine without a GPU before FMUs are built
    planned = plan(chosen_scenario.load(name, flavour, changes))
    if sample is not None:
        _run_one(planned, sample, out)
        return
    recorded = recorded_signals(recordings, planned)

    from orchestration.many.run_many import LocalRuns
    from orchestration.sweep import table  # Arrow is slow to import: after what can be refused
    from orchestration.sweep.run import sweep as run_samples
    from orchestration.sweep.table import summary_table

    notes: list[str] = []
    if scheduler:
        from orchestration.many import cluster  # Dask is slow to import

        place = cluster.remote(scheduler)
    else:
        place = LocalRuns(workers or usable_processors(), isolated, ensemble, notes.append, where=where)
    with shared.progress("sweep", planned.count, kept="samples") as bar:
        path = run_samples(planned, out, place, recorded, restart, bar.advance)
    results, provenance = table.read(path)
    shared.print_table(summary_table(results, provenance))
    print(path)
    if recordings:
        print(path.with_suffix(".recordings"))
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


@takes_changes()
def margins(
    name: shared.ScenarioArgument,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Write margins.json to this folder.")
    ] = None,
    flavour: shared.FlavourOption = Flavour.NATIVE,
    changes: Changes = NO_CHANGES,
    signal: Annotated[
        str, typer.Option(metavar="NAME", help="Judge this signal; by default that of a metric.")
    ] = "",
    window: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="S S", help="Judge it between these two times [s]; by default in a hold."),
    ] = None,
    quiet: Annotated[
        float, typer.Option(help="Largest standard deviation of a settled signal, in the signal's unit.")
    ] = 3e-3,
    theory: Annotated[
        bool, typer.Option("--theory", help="Give what follows from the design alone, without many runs.")
    ] = False,
    over: Annotated[
        str,
        typer.Option(
            metavar="NAME=V,V", help="Measure the delay margins at each of these values of a parameter, too."
        ),
    ] = "",
) -> None:
    """Give the delay and gain margins of a scenario, by runs and, for L1 controllers, in theory.

    Delays are in seconds, gains are factors.
    For example, l1-depth margins nominal-extended --theory makes only a few runs.
    """
    from orchestration.cli import chosen_scenario
    from orchestration.margins.fmu_margins import runs_needed
    from orchestration.margins.hold import Hold
    from orchestration.margins.margins import judge

    if bool(signal) != bool(window):
        raise OrchestrationError("--signal and --window: expected both, or none of them")
    repeated = _values(over)
    if theory:
        shared.refuse_without_effect("--theory", {"--over": over})
    if out:
        shared.check_writable(out)
    chosen = chosen_scenario.load(name, flavour, changes)
    hold = Hold(signal, *window, quiet) if window else None
    with shared.progress("margins", runs_needed(repeated)) as bar:
        judged = judge(chosen, hold, quiet=quiet, over=repeated, measured=not theory, progress=bar.advance)
    _print(chosen.title, judged)
    if out:
        path = out / "margins.json"
        write_json_atomically(path, judged.document())
        print(path)


def _values(over: str) -> dict[str, list[float]]:
    """Returns parameter -> values."""
    if not over:
        return {}
    name, _, texts = over.rpartition("=")
    try:
        return {name.strip(): [float(text) for text in texts.split(",")]}
    except ValueError:
        raise OrchestrationError(f"--over {over}: expected component.parameter=number,number") from None


def _print(title: str, judged: "Margins") -> None:
    """Prints the metrics, and below them what all of a group assume and what some of them assume besides."""
    parts: dict[str, list[list[str]]] = {}
    for metric in judged.metrics:
        parts.setdefault(metric.group, []).append(f"{metric.assumption}; {metric.source}".split("; "))
    common = {
        group: [part for part in own[0] if all(part in each for each in own)] for group, own in parts.items()
    }
    own_notes = [
        "; ".join(part for part in each if part not in common[group])
        for group, own in parts.items()
        for each in own
    ]
    notes = list(dict.fromkeys(filter(None, own_notes)))
    if judged.metrics:
        shared.print_table(
            _table(title, judged, [str(notes.index(note) + 1) if note else "" for note in own_notes])
        )
    for group, shared_parts in common.items():
        if shared_parts:
            print(f"{group}: {'; '.join(shared_parts)}")
    for number, note in enumerate(notes, 1):
        print(f"[{number}] {note}")
    for sentence in judged.not_judged:
        print(sentence)


def _table(title: str, judged: "Margins", notes: list[str]) -> "Table":
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left")
    for heading in ("", "Margin", "Value", "Unit", "Remark", "Note"):
        table.add_column(heading, justify="right" if heading in ("Value", "Note") else "left")
    group = ""
    for metric, note in zip(judged.metrics, notes, strict=True):
        if metric.group != group:
            table.add_section()
        shown_group, group = "" if metric.group == group else metric.group, metric.group
        cells = shown_group, metric.name, metric.shown, metric.unit, metric.remark, note
        table.add_row(*map(escape, cells))
    return table
