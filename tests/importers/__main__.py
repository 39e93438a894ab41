"""Run packages in other people's importers and compare the depth in each with this master's.

Run `python -m tests.importers` in the project's root, with the extra `test` installed: it prints Markdown.
"""

import tempfile
from collections.abc import Iterator
from importlib.metadata import version
from itertools import product
from pathlib import Path

import typer
from rich.console import Console
from rich.progress import track

from fmus.generate import builder
from orchestration.run import simulate
from orchestration.scenarios import scenario
from tests.importers.comparison import SCENARIOS, Outcome, outcome, packaged
from tests.importers.importers import IMPORTERS


def main() -> None:
    """Run two packages in every importer of the extra `test` and compare the depth with this master's."""
    count = len(IMPORTERS) * len(SCENARIOS)
    outcomes = list(track(_outcomes(), total=count, console=Console(stderr=True), transient=True))
    rows = [("Importer", "Version", "Scenario", "Largest difference", "Labels early by"), ("---",) * 5]
    for one in outcomes:
        cells = (one.problem, "") if one.problem else (f"{one.difference:.1e} m", f"{one.shift} steps")
        rows.append((one.importer, version(IMPORTERS[one.importer].distribution), one.scenario, *cells))
    for row in rows:
        print(f"| {' | '.join(row)} |")
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
