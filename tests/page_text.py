"""Long sentences and long table cells of Markdown pages."""

import re


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
