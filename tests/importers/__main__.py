"""Run packages in other people's importers and compare one output of each with this master's.

Run `python -m tests.importers` in the project's root, with the extra `test` installed.
"""

import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import track

from fmus import catalogue
from orchestration.scenarios import scenario
from tests.importers import comparison
from tests.printing import print_tables


def main(
    markdown: Annotated[bool, typer.Option(help="Print the table of docs/how-to/ssp.md.")] = False,
) -> None:
    """Run two packages in every importer that is installed and compare an output with this master's."""
    for name in comparison.SCENARIOS:
        catalogue.build_missing(scenario.load(scenario.find(name)).system.components.values())
    with tempfile.TemporaryDirectory() as folder:
        count = len(comparison.DISTRIBUTIONS) * len(comparison.SCENARIOS)
        outcomes = list(
            track(
                comparison.outcomes(Path(folder)), total=count, console=Console(stderr=True), transient=True
            )
        )
    print_tables([comparison.table(outcomes)], markdown)
    failed = sorted({outcome.importer for outcome in outcomes if outcome.problem and outcome.version})
    if failed:
        raise SystemExit(f"{', '.join(failed)} failed: expected the same values as this master's")


if __name__ == "__main__":
    typer.run(main)
