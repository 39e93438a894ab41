"""Tables of measurements, for a terminal or for a Markdown page."""

import sys
from collections.abc import Sequence

from rich import box
from rich.console import Console
from rich.table import Table

_MARKDOWN_WIDTH = 1000  # no cell is wrapped


def print_tables(tables: Sequence[Table], markdown: bool) -> None:
    """Print tables to standard output, as Markdown if asked for."""
    console = Console(file=sys.stdout, width=_MARKDOWN_WIDTH if markdown else None)
    for table in tables:
        if markdown:
            console.print(f"{table.title}:\n", markup=False)
            table.title, table.box = None, box.MARKDOWN
            for column in table.columns:
                column.overflow = "ignore"
        console.print(table)
        console.print()
