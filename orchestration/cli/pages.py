"""The command that makes a page of results: report."""

from pathlib import Path
from typing import Annotated

import typer

from orchestration.results.recording import write_whole


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

    text = page.render(page.found_results(results), title)
    write_whole(out, lambda stream: stream.write(text))
    print(out)
