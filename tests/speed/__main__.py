"""Measure FMI against bare C, this master against other importers, and scenarios against one C program.

Run `python -m tests.speed` in the project's root, with the extra `test` installed.
"""

import os
import platform
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from fmus.registry import block_names
from orchestration.scenarios import scenario
from tests.printing import print_tables
from tests.speed.importers import compare
from tests.speed.layers import layer
from tests.speed.loops import LOOPS
from tests.speed.scenarios import loop
from tests.speed.tables import tables

_MOST_ROUNDS_OF_IMPORTERS = 3


def main(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENARIO]...", help="Shipped scenarios (Jacobi, no events)."),
    ] = None,
    rounds: Annotated[int, typer.Option(help="Measurements of which the median is taken.", min=1)] = 7,
    markdown: Annotated[bool, typer.Option(help="Print the tables of docs/performance.md.")] = False,
) -> None:
    """Measure how fast the FMUs and the master are, as ratios on this machine."""
    chosen = names or ["nominal-extended"]
    for name in chosen:
        scenario.find(name)
    of_importers = min(rounds, _MOST_ROUNDS_OF_IMPORTERS)
    with Progress(console=Console(stderr=True), transient=True) as progress:
        layers = [layer(name, rounds=rounds) for name in progress.track(block_names(), description="blocks")]
        loops = [loop(name, rounds=rounds) for name in progress.track(chosen, description="scenarios")]
        others = progress.add_task("importers", total=of_importers * len(LOOPS))
        entries = compare(of_importers, progress=lambda: progress.advance(others))
    print_tables(tables(layers, loops, entries), markdown)
    machine = f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores"
    python = f"Python {platform.python_version()}"
    print(f"Medians of {rounds} rounds, of importers {of_importers}, on {machine}, {python}.")


if __name__ == "__main__":
    typer.run(main)
