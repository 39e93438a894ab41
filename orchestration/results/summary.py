"""A recording at a glance: the text that a Python prompt and a notebook show of it."""

from collections.abc import Mapping, Sequence

import numpy as np

_MOST = 30  # signals shown
_HEADINGS = ("signal", "unit", "least", "largest", "last")


def as_text(units: Sequence[str], time: np.ndarray, signals: Mapping[str, np.ndarray]) -> str:
    """A heading, and a line a signal in columns. signals: by their names; units: in the same order."""
    names = list(signals)
    columns = zip(names[:_MOST], units[:_MOST], strict=True)
    rows = [_HEADINGS, *((name, unit, *_numbers(signals[name])) for name, unit in columns)]
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
    if values.dtype == object:  # a String
        return "", "", str(values[-1])
    return tuple(f"{value:.6g}" for value in (values.min(), values.max(), values[-1]))
