"""Measure FMI against bare C, this master against other importers, and scenarios against one C program.

Run `python -m tests.speed` in the project's root, with the extra `test` installed.
"""

from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from fmus.registry import block_names
from orchestration.scenarios import scenario
from tests.printing import print_tables
from tests.speed import LOOPS, compare, layer, loop, machine, tables

_MOST_ROUNDS_OF_IMPORTERS = 3


def main(
    names: Annotated[
        list[str] | None,
        typer.Argument(metavar="[SCENARIO]...", help="Shipped scenarios (Jacobi, no events)."),
    ] = None,
    rounds: Annotated[int, typer.Option(help="Measurements of which the median is taken.", min=1)] = 7,
    importers: Annotated[bool, typer.Option(help="Measure other people's importers as well.")] = True,
    markdown: Annotated[bool, typer.Option(help="Print the tables of docs/performance.md.")] = False,
) -> None:
    """Measure how fast the FMUs and the master are, as ratios on this machine."""
    chosen = names or ["nominal-extended"]
    for name in chosen:
        scenario.find(name)
    of_importers = min(rounds, _MOST_ROUNDS_OF_IMPORTERS)
    ours = [name for name, runner in LOOPS.items() if runner.distribution == "l1-depth"]
    with Progress(console=Console(stderr=True), transient=True) as progress:
        steps = progress.add_task("blocks", total=len(block_names()))
        layers = [layer(name, rounds=rounds) for name in progress.track(block_names(), task_id=steps)]
        scenarios = progress.add_task("scenarios", total=len(chosen))
        loops = [loop(name, rounds=rounds) for name in progress.track(chosen, task_id=scenarios)]
        compared = LOOPS if importers else ours
        others = progress.add_task("importers", total=of_importers * len(compared))
        entries = compare(of_importers, compared, lambda: progress.advance(others))
    print_tables(tables(layers, loops, entries), markdown)
    print(f"Medians of {rounds} rounds, of importers {of_importers}, on {machine()}.")


if __name__ == "__main__":
    typer.run(main)
