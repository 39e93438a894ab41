"""Tables in pages of Markdown, each below a comment `<!-- table: NAME -->`."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from orchestration.errors import OrchestrationError
from tests.speed.part import Table


def check_places(pages: Sequence[Path], names: Iterable[str]) -> None:
    """Raises OrchestrationError unless the pages have one place for each name of a table, and no other."""
    texts = [page.read_text(encoding="utf-8") for page in pages]
    places = Counter(re.findall(r"^<!-- table: (.*) -->$", "\n".join(texts), re.M))
    if wrong := (places - Counter(names)) + (Counter(names) - places):
        raise OrchestrationError(
            f"{', '.join(sorted(wrong))}: expected one place in the pages for each table"
        )


def replace_tables(pages: Sequence[Path], tables: Iterable[Table]) -> None:
    """Write tables to their places in pages; places of other tables stay as they are."""
    given = {table.name: table.markdown for table in tables}
    for page in pages:
        page.write_text(_with_tables(page.read_text(encoding="utf-8"), given), encoding="utf-8")


def _with_tables(text: str, tables: dict[str, str]) -> str:
    filled = re.sub(
        r"^(<!-- table: (.*) -->\n)\n*(?:\|.*\n)*\n*",
        lambda match: f"{match[1]}\n{tables[match[2]]}\n" if match[2] in tables else match[0],
        text,
        flags=re.M,
    )
    return f"{filled.rstrip()}\n"
