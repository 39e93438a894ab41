"""A recording at a glance: the text that a Python prompt shows of it, and the table of a notebook."""

from collections.abc import Sequence
from html import escape

import numpy as np

_MOST = 30  # signals shown
_HEADINGS = ("signal", "unit", "least", "largest", "last")

Row = tuple[str, ...]


def as_text(names: Sequence[str], units: Sequence[str], time: np.ndarray, values: np.ndarray) -> str:
    """The heading, and a line a signal in columns. Arguments: the fields of a `Recording`."""
    rows = [_HEADINGS, *_rows(names, units, values)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADINGS))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join([_heading(names, time), *(f"  {line}" for line in lines), *_rest(names)])


def as_html(names: Sequence[str], units: Sequence[str], time: np.ndarray, values: np.ndarray) -> str:
    """The same as a table."""
    head = "".join(f"<th>{heading}</th>" for heading in _HEADINGS)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row in _rows(names, units, values)
    )
    rest = "".join(f"<p>{line}</p>" for line in _rest(names))
    return f"<p>{_heading(names, time)}</p><table><tr>{head}</tr>{body}</table>{rest}"


def _heading(names: Sequence[str], time: np.ndarray) -> str:
    span = f", {time[0]:g}..{time[-1]:g} s" if len(time) else ""
    return f"Recording of {_count(len(names), 'signal')} at {_count(len(time), 'point')}{span}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _rows(names: Sequence[str], units: Sequence[str], values: np.ndarray) -> list[Row]:
    columns = zip(names[:_MOST], units[:_MOST], values.T[:_MOST], strict=True)
    return [(name, unit, *_numbers(column)) for name, unit, column in columns]


def _numbers(values: np.ndarray) -> Row:
    """Least, largest and last; a value that is not finite shows in them."""
    if not len(values):
        return "", "", ""
    return tuple(f"{value:.6g}" for value in (values.min(), values.max(), values[-1]))


def _rest(names: Sequence[str]) -> list[str]:
    more = len(names) - _MOST
    return [f"and {_count(more, 'more signal')}"] if more > 0 else []
