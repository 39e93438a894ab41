"""A difference of two FMUs, and its level: its effect on a model that uses them."""

from enum import StrEnum
from typing import NamedTuple


class Level(StrEnum):
    """Levels, with the names of semantic versions; the verdict is the highest one.

    major: a model that uses the FMU does not run any more, or lacks a capability
    minor: it runs with other results, or there is more to use
    patch: it runs as before, but for rounding
    """

    MAJOR = "major"
    MINOR = "minor"
    PATCH = "patch"

    def reaches(self, other: "Level") -> bool:
        """Whether it is as high as the other one."""
        order = list(Level)
        return order.index(self) <= order.index(other)


class Change(NamedTuple):
    """A difference; part: "interface", "behaviour" or "files"."""

    level: Level
    part: str
    text: str


def verdict(changes: list[Change]) -> Level | None:
    """Returns the highest level; None of equal FMUs."""
    return min((change.level for change in changes), key=list(Level).index, default=None)
