"""The commands that write a page: report shows results, live runs a scenario in the browser."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.files import write_text_atomically
from orchestration.cli import shared
from orchestration.cli.changes import NO_CHANGES, Changes, takes_changes

if TYPE_CHECKING:
    from rich.progress import Progress

    from orchestration.scenarios.scenario import Scenario

PANEL = "Scenarios"


@takes_changes()
def live(
    name: shared.ScenarioArgument,
    out: Annotated[Path, typer.Option(metavar="FILE", help="Write this page.")] = Path("live.html"),
    sliders: Annotated[
        list[str],
        typer.Option(
            "--slider",
            metavar="NAME=LOW:HIGH",
            help="Give component.variable a slider too, or another range; several are separated by commas.",
        ),
    ] = [],  # noqa: B006  (Typer copies it)
    beside: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=VALUE",
            help="Draw the same scenario with this value beside it; by default without the extension.",
        ),
    ] = [],  # noqa: B006
    changes: Changes = NO_CHANGES,
) -> None:
    """Write a scenario as one HTML page that runs its FMUs in the browser, with sliders for its values.

    For example, l1-depth live nominal-extended --slider controller.adaptation_gain=10:1000 adds a slider.
    """
    from orchestration.cli import chosen_scenario
    from orchestration.report.live_page import live_page

    chosen = chosen_scenario.load(name, changes=changes)
    runs = {chosen.title: chosen}
    if beside := beside or _without_extension(chosen):
        settings = {**changes.settings, **Changes.of_options(settings=beside).settings}
        runs[", ".join(beside)] = chosen_scenario.load(name, changes=replace(changes, settings=settings))
    with _elapsed("compiling for the browser: half a minute of a processor, once"):
        text = live_page(runs, sliders)
    write_text_atomically(out, text)
    print(out)


def _elapsed(description: str) -> "Progress":
    """Returns a context that shows the elapsed time on standard error, if that is a terminal."""
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = TimeElapsedColumn(), SpinnerColumn(), TextColumn("{task.description}")
    progress = Progress(
        *columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()
    )
    progress.add_task(description)
    return progress


def _without_extension(scenario: "Scenario") -> list[str]:
    """Returns the setting that switches the extension of the controller off, if it is on."""
    from orchestration.system.prepared_run import values_of

    extension = values_of(scenario.prepared, "controller").get("augmentation", "none")
    return [] if extension == "none" else ["controller.augmentation=none"]


def report(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT",
            help="A result of run, reproduce, sweep or fit: .json, .csv, .parquet or a folder.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Write this page.")] = Path("report.html"),
    title: Annotated[str, typer.Option(help="Give the page this title, not the names of the results.")] = "",
) -> None:
    """Write results as one interactive HTML page that needs no network.

    For example, l1-depth report results --out paper.html shows every result in a folder.
    """
    from orchestration.report.find import found_results
    from orchestration.report.render import render

    found = found_results(results)
    for result in found:
        for column, reason in result.provenance.get("left_out", {}).items():
            print(f"l1-depth: warning: {column} is left out: {reason}", file=sys.stderr)
    write_text_atomically(out, render(found, title))
    print(out)
