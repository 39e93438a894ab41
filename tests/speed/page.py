"""Tables in pages of Markdown, each below a comment `<!-- table: NAME -->`."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from orchestration.errors import OrchestrationError
from tests.speed.part import Table


def replace_tables(pages: Sequence[Path], tables: Iterable[Table]) -> None:
    """Write tables to their places in pages.

    Raises OrchestrationError unless there is one place for each table, and one table for each place.
    """
    given = {table.name: table.markdown for table in tables}
    texts = [page.read_text(encoding="utf-8") for page in pages]
    places = re.findall(r"^<!-- table: (.*) -->$", "\n".join(texts), re.M)
    if sorted(places) != sorted(given):
        names = ", ".join(sorted(set(places) ^ set(given)))
        raise OrchestrationError(f"{names}: expected one place in the pages and one table for each")
    for page, text in zip(pages, texts, strict=True):
        page.write_text(_with_tables(text, given), encoding="utf-8")


def _with_tables(text: str, tables: dict[str, str]) -> str:
    filled = re.sub(
        r"^(<!-- table: (.*) -->\n)\n*(?:\|.*\n)*\n*",
        lambda match: f"{match[1]}\n{tables[match[2]]}\n",
        text,
        flags=re.M,
    )
    return f"{filled.rstrip()}\n"
