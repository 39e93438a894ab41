"""Panels of a figure: which signals share one, its vertical axis, and the points of a dense line to draw."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

_MOST_LINES = 4  # of a panel: readers follow no more
_QUANTITIES = {
    "m": "Length",
    "m/s": "Velocity",
    "m/s2": "Acceleration",
    "N": "Force",
    "N.m": "Torque",
    "V": "Voltage",
    "A": "Current",
    "W": "Power",
    "K": "Temperature",
    "degC": "Temperature",
    "Pa": "Pressure",
    "rad": "Angle",
    "deg": "Angle",
    "rad/s": "Angular velocity",
}
_SHORT = 3  # letters of words that name no quantity, such as u of u_a and hat of sigma_hat


def points_down(name: str, unit: str) -> bool:
    """Whether a signal is a depth: a plot of it has its vertical axis pointing down."""
    return unit == "m" and "depth" in name.lower()


@dataclass(frozen=True)
class Panel:
    """Signals of one unit; axis: the label of their axis; down: whether it points down."""

    names: list[str]
    axis: str
    down: bool


def panels_of(units: Mapping[str, str]) -> list[Panel]:
    """Returns the panels of some signals, in the order of their units.

    units: signal -> unit. If too many signals have one unit, signals that share a word share a panel.
    """
    kinds: dict[tuple[str, bool], list[str]] = {}
    for name, unit in units.items():
        kinds.setdefault((unit, points_down(name, unit)), []).append(name)
    return [
        Panel(part, axis_label(part, unit), down)
        for (unit, down), names in kinds.items()
        for part in _split(names)
    ]


def _split(names: list[str]) -> Iterator[list[str]]:
    if len(names) <= _MOST_LINES:
        yield names
        return
    groups: list[tuple[set[str], list[str]]] = []  # words that all members share, members
    for name in names:
        words = set(_words(name))
        for index, (shared, members) in enumerate(groups):
            if shared & words:
                groups[index] = shared & words, [*members, name]
                break
        else:
            groups.append((words, [name]))
    for _, members in groups:
        count = -(-len(members) // _MOST_LINES)
        for part in range(count):
            yield members[part * len(members) // count : (part + 1) * len(members) // count]


def axis_label(names: Sequence[str], unit: str) -> str:
    """Returns the common quantity of signals, by their names or their unit, with the unit: "Depth [m]"."""
    first, *others = map(_words, names)
    common = [word for word in first if all(word in words for words in others)]
    if all(len(word) <= _SHORT for word in common):
        # One signal, or the same variable of several components, keeps its name, such as y or u_a.
        name = "_".join(first) if common == first and first else _QUANTITIES.get(unit, "Value")
    else:
        name = " ".join(common).capitalize()
    return f"{name} [{unit or '1'}]"


def _words(name: str) -> list[str]:
    """Returns the words of a signal's own name, without its component and its indices."""
    own = re.sub(r"\[[^\]]*\]", "", name).rpartition(".")[2]
    return [word for word in own.split("_") if word]


def drawn_points(time: np.ndarray, values: np.ndarray, columns: int) -> np.ndarray:
    """Returns the indices of both ends and, in each column of time, of the extreme values and a gap.

    columns: of pixels; a column shows no more than its extreme values. With at most two points in each the
    indices are all.
    """
    if len(values) <= 2 * columns:
        return np.arange(len(values))
    column = ((time - time[0]) * (columns / (time[-1] - time[0]))).astype(int)
    finite = np.where(np.isfinite(values), values, np.nan)
    # by column, within it by value; NaN, a gap, is last
    order = np.lexsort((finite, column))
    starts = np.flatnonzero(np.diff(column, prepend=-1))
    largest = starts + np.maximum(np.add.reduceat(np.isfinite(finite).astype(int), starts), 1) - 1
    lasts = np.append(starts[1:], len(values)) - 1
    return np.unique(np.concatenate([[0, len(values) - 1], order[starts], order[largest], order[lasts]]))
