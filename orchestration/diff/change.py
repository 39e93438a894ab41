"""A difference of two FMUs, and its level: its effect on a model that uses them."""

from enum import StrEnum
from typing import NamedTuple


class Level(StrEnum):
    """Levels, with the names of semantic versions, which sort; the verdict is the highest, the least name.

    major: a model that uses the FMU does not run any more, or lacks a capability
    minor: it runs with other results, or there is more to use
    patch: it runs as before, but for rounding
    """

    MAJOR = "major"
    MINOR = "minor"
    PATCH = "patch"


class Change(NamedTuple):
    """A difference; part: "interface", "behaviour" or "files"."""

    level: Level
    part: str
    text: str


def verdict(changes: list[Change]) -> Level | None:
    """Returns the highest level; None of equal FMUs."""
    return min((change.level for change in changes), default=None)
