"""A recording at a glance: what a Python prompt and a notebook show of it."""

from html import escape
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from orchestration.results.recording import Recording

_MOST = 30  # signals shown
_HEADINGS = ("signal", "unit", "least", "largest", "last")

Row = tuple[str, ...]


def as_text(recording: "Recording") -> str:
    """The heading, and a line a signal in columns."""
    rows = [_HEADINGS, *_rows(recording)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADINGS))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
    ]
    return "\n".join([_heading(recording), *(f"  {line}" for line in lines), *_rest(recording)])


def as_html(recording: "Recording") -> str:
    """The same as a table."""
    head = "".join(f"<th>{each}</th>" for each in _HEADINGS)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in _rows(recording)
    )
    rest = "".join(f"<p>{each}</p>" for each in _rest(recording))
    return f"<p>{_heading(recording)}</p><table><tr>{head}</tr>{body}</table>{rest}"


def _heading(recording: "Recording") -> str:
    signals, points = len(recording.names), len(recording.time)
    span = f", {recording.time[0]:g}..{recording.time[-1]:g} s" if points else ""
    return f"Recording of {_count(signals, 'signal')} at {_count(points, 'point')}{span}"


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"


def _rows(recording: "Recording") -> list[Row]:
    columns = zip(recording.names, recording.units, recording.values.T, strict=True)
    return [(name, unit, *_numbers(values)) for name, unit, values in list(columns)[:_MOST]]


def _numbers(values: np.ndarray) -> Row:
    """Least, largest and last; a value that is not finite is seen in them."""
    if not len(values):
        return "", "", ""
    return tuple(f"{each:.6g}" for each in (values.min(), values.max(), values[-1]))


def _rest(recording: "Recording") -> list[str]:
    more = len(recording.names) - _MOST
    return [f"and {_count(more, 'more signal')}"] if more > 0 else []
