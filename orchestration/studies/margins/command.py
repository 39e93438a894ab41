"""Command margins: the delay and gain margins of a scenario."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.files import write_json_atomically
from fmus.registry import Flavour
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, Changes, takes_changes
from orchestration.errors import OrchestrationError

if TYPE_CHECKING:
    from rich.table import Table

    from orchestration.studies.margins.margins import Margins

PANEL = "Controllers compared"


@takes_changes()
def margins(
    name: shared.ScenarioArgument,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Write margins.json and margins.png (Bode, Nyquist) to this folder."
        ),
    ] = None,
    flavour: shared.FlavourOption = Flavour.NATIVE,
    changes: Changes = NO_CHANGES,
    signal: Annotated[
        str, typer.Option(metavar="NAME", help="Judge this signal; by default the signal of a metric.")
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
    certificate: Annotated[
        bool,
        typer.Option(
            "--certificate", help="Prove up to which gain the extension of an L1 controller keeps the hold."
        ),
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
    from orchestration.studies.margins.fmu_margins import runs_needed
    from orchestration.studies.margins.hold import Hold
    from orchestration.studies.margins.margins import judge

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
        judged = judge(
            chosen,
            hold,
            quiet=quiet,
            over=repeated,
            measured=not theory,
            certificate=certificate,
            progress=bar.advance,
        )
    _print(chosen.title, judged)
    if out:
        if judged.linear:
            from orchestration.studies.margins.margins_figure import write_margins_figure

            print(write_margins_figure(chosen.title, *judged.linear, out / "margins"))
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
    """Prints the metrics, and below them the assumptions of each whole group and of single metrics."""
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
