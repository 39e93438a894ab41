"""Run packages in other people's importers and compare the depth in each with this master's.

Run `python -m tests.importers` in the project's root, with the extra `test` installed.
"""

import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from fmus.build import builder
from orchestration.run import simulate
from orchestration.scenarios import scenario
from tests.importers.comparison import SCENARIOS, Outcome, outcome, packaged
from tests.importers.importers import IMPORTERS
from tests.printing import print_tables


def main(
    markdown: Annotated[bool, typer.Option(help="Print a table of Markdown.")] = False,
) -> None:
    """Run two packages in every importer of the extra `test` and compare the depth with this master's."""
    count = len(IMPORTERS) * len(SCENARIOS)
    outcomes = list(track(_outcomes(), total=count, console=Console(stderr=True), transient=True))
    table = Table(title="Our master against other importers")
    for heading in ("Importer", "Version", "Scenario", "Largest difference", "Labels early by"):
        table.add_column(heading, overflow="fold")
    for row in outcomes:
        cells = (row.problem, "") if row.problem else (f"{row.difference:.1e} m", f"{row.shift} steps")
        table.add_row(row.importer, version(IMPORTERS[row.importer].distribution), row.scenario, *cells)
    print_tables([table], markdown)
    if failed := sorted({row.importer for row in outcomes if row.problem}):
        raise SystemExit(f"{', '.join(failed)} failed: expected the same values as this master's")


def _outcomes() -> Iterator[Outcome]:
    loaded = [scenario.load(scenario.find(name)) for name in SCENARIOS]
    for chosen in loaded:
        builder.build_missing(chosen.system.components.values())
    ours = [simulate(chosen.system, chosen.experiment) for chosen in loaded]
    with tempfile.TemporaryDirectory() as folder:
        jobs = [packaged(chosen, Path(folder)) for chosen in loaded]
        for importer, (job, recording) in product(IMPORTERS, zip(jobs, ours, strict=True)):
            yield outcome(importer, job, recording)


if __name__ == "__main__":
    typer.run(main)
