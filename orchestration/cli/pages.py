"""The command that makes a page of results: report."""

from pathlib import Path
from typing import Annotated

import typer

from fmus.files import write_text_atomically


def report(
    results: Annotated[
        list[Path],
        typer.Argument(
            metavar="RESULT...", help="What run, reproduce or sweep wrote: .json, .csv, .parquet or a folder."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="Page to write.")] = Path("report.html"),
    title: Annotated[str, typer.Option(help="Of the page; by default what the results are called.")] = "",
) -> None:
    """Write results as one interactive HTML page that needs no network."""
    from orchestration import report as page

    write_text_atomically(out, page.render(page.found_results(results), title))
    print(out)
