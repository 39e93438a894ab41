"""Text of Markdown pages: their own words, long sentences and long table cells."""

import re
from pathlib import Path

WRITTEN = "<!-- Written by .ci/pages.py"  # begins the pages that follow from the code
_TABLES = re.compile(r"^(<!-- \w+: .* -->\n)\n(?:\|.*\n)+", re.M)  # of results, by the same program


def own_pages(folder: Path) -> list[Path]:
    """Returns the pages below a folder that people write."""
    pages = sorted(folder.rglob("*.md"))
    return [page for page in pages if not page.read_text(encoding="utf-8").startswith(WRITTEN)]


def own_text(page: Path) -> str:
    """Returns the text of a page without the tables of results that are written into it."""
    return _TABLES.sub(r"\1", page.read_text(encoding="utf-8"))


def blocks(text: str) -> list[str]:
    """Returns paragraphs, items, headings and rows of tables, without code blocks and targets of links."""
    text = re.sub(r"^```.*?^```$|<!--.*?-->", "\n", text, flags=re.M | re.DOTALL)
    text = re.sub(r"\n\n(?: {4}.*\n+)+", "\n\n", text)
    text = re.sub(r"\]\([^)]*\)", "]", text)
    text = re.sub(r"^ *(?:[-*]|\d+\.) ", "\n", text, flags=re.M)
    text = re.sub(r"^(?:\||#+ ).*$", r"\n\g<0>\n", text, flags=re.M)
    return [" ".join(block.split()) for block in re.split(r"\n\s*\n", text) if block.strip()]


def long_sentences(text: str) -> list[str]:
    """Returns the sentences of more than 25 words outside code and tables; `code` counts as a word."""
    prose = [re.sub(r"`[^`]*`", "code", block) for block in blocks(text) if not block.startswith("|")]
    sentences = [one for block in prose for one in re.split(r"(?<=[.!?])[)*\"]*\s+", block)]
    return [sentence for sentence in sentences if len(sentence.split()) > 25]


def long_cells(text: str) -> list[str]:
    """Returns the cells of tables of more than 120 characters, without link targets."""
    rows = [block for block in blocks(text) if block.startswith("|")]
    cells = [cell.strip() for row in rows for cell in re.split(r"(?<!\\)\|", row)]
    return [cell for cell in cells if len(cell) > 120]
