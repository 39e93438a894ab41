"""A recording at a glance: the text that a Python prompt and a notebook show of it."""

from collections.abc import Sequence

import numpy as np

_MOST = 30  # signals shown
_HEADINGS = ("signal", "unit", "least", "largest", "last")


def as_text(names: Sequence[str], units: Sequence[str], time: np.ndarray, values: np.ndarray) -> str:
    """A heading, and a line a signal in columns. Arguments: the fields of a `Recording`."""
    columns = zip(names[:_MOST], units[:_MOST], values.T[:_MOST], strict=True)
    rows = [_HEADINGS, *((name, unit, *_numbers(column)) for name, unit, column in columns)]
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    span = f", {time[0]:g}..{time[-1]:g} s" if len(time) else ""
    heading = f"Recording of {_count(len(names), 'signal')} at {_count(len(time), 'point')}{span}"
    more = len(names) - _MOST
    rest = [f"and {_count(more, 'more signal')}"] if more > 0 else []
    return "\n".join([heading, *(f"  {line}" for line in lines), *rest])


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _numbers(values: np.ndarray) -> tuple[str, ...]:
    """Least, largest and last; a value that is not finite shows in them."""
    if not len(values):
        return "", "", ""
    return tuple(f"{value:.6g}" for value in (values.min(), values.max(), values[-1]))
