"""A difference of two FMUs, and its level: its effect on a model that uses them."""

from enum import StrEnum
from typing import NamedTuple


class Level(StrEnum):
    """Levels with the names of semantic versions, which sort the highest first: that one is the verdict.

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
