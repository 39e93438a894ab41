"""The tables of the pages performance and scale: a file that the measurements write and the site reads."""

import json
from collections.abc import Sequence
from itertools import compress
from pathlib import Path

MACHINE = "machine"
Tables = dict[str, list[Sequence[str]]]  # name -> rows


def read(path: Path) -> Tables:
    """Returns the tables of a file, and none if there is no file."""
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}


def write(path: Path, tables: Tables) -> None:
    """Writes tables to a file, a row in each line; other tables in it stay as they are."""
    texts = {
        name: ",\n".join(f"  {json.dumps(row, ensure_ascii=False)}" for row in rows)
        for name, rows in (read(path) | tables).items()
    }
    entries = ",\n".join(f" {json.dumps(name)}: [\n{text}\n ]" for name, text in texts.items())
    path.write_text(f"{{\n{entries}\n}}\n", encoding="utf-8")


def markdown(rows: Sequence[Sequence[str]]) -> str:
    """Returns a table of Markdown, without the columns that no row fills."""
    headings = ("", "goal", "before", "now", "now / before") if len(rows[0]) > 2 else ("", "")
    rule = ["---", *["---:"] * (len(headings) - 1)]
    filled = [any(column) for column in zip(*rows, strict=True)]
    lines = [compress(row, filled) for row in (headings, rule, *rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)
