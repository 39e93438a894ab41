"""Command report."""

from pathlib import Path
from typing import Annotated

import typer


def report(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT...",
            help="What run, reproduce or sweep has written: .json, .csv, .parquet or a folder.",
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Write this page.")] = Path("report.html"),
    title: Annotated[str, typer.Option(help="Give the page this title, not the names of the results.")] = "",
) -> None:
    """Write results as one interactive HTML page that needs no network."""
    from fmus.files import write_text_atomically
    from orchestration import report as page

    write_text_atomically(out, page.render(page.found_results(results), title))
    print(out)
