"""Command reproduce."""

import os
from pathlib import Path
from typing import Annotated

import typer

from fmus.registry import Flavour
from orchestration.cli.shared import (
    FigureFormatsOption,
    FlavourOption,
    OutFolder,
    figure_formats,
    print_table,
    progress,
)


def reproduce(
    out: OutFolder = Path("results"),
    workers: Annotated[int, typer.Option(help="Run so many processes.", min=1)] = os.cpu_count() or 1,
    flavour: FlavourOption = Flavour.NATIVE,
    formats: FigureFormatsOption = "png",
) -> None:
    """Run every shipped scenario, and give the tables and figures of the paper."""
    from orchestration.cli.chosen_scenario import build_missing_fmus
    from orchestration.scenarios import reproduce as reproduction
    from orchestration.scenarios import scenario
    from orchestration.scenarios.paper_tables import comparison_table

    written_formats = figure_formats(formats)
    paths = scenario.shipped().values()
    build_missing_fmus(scenario.load(path, flavour=flavour) for path in paths)
    with progress("reproduce", len(paths)) as bar:
        results = reproduction.run_all(out, workers, lambda name: bar.advance(), flavour)
    written = reproduction.write_report(results, out, written_formats)
    print_table(comparison_table({name: result.metrics for name, result in results.items()}))
    for path in written:
        print(path)
