"""Errors that a user can put right, and the words they share."""

import math
import re
from collections.abc import Iterable, Sequence
from difflib import get_close_matches

_LIKE = 0.6  # of letters in common
_LISTED = 5


class ExportError(ValueError):
    """A block that cannot become an FMU; the message says what was wrong and what was expected."""


class MissingExtraError(ImportError):
    """A library that the core does not install, or that does not start.

    The message names the command that installs it, or the cause.
    """


class HostError(Exception):
    """Error of this machine, such as a full disk, and not of an FMU."""


class OrchestrationError(Exception):
    """Base of every error that a user can put right; its message is one line."""


class FmuLoadError(OrchestrationError):
    """A file that is not an FMI 2.0 co-simulation FMU for this platform."""


class FmuError(OrchestrationError):
    """Error of a call that an FMU refused; names the instance, the time and the FMU's own log line."""

    def __init__(self, instance: str, time: float, call: str, status: str, log: list[str]) -> None:
        super().__init__(instance, time, call, status, log)
        self.instance, self.time, self.call, self.status, self.log = instance, time, call, status, log

    def __str__(self) -> str:
        logged = "; ".join(self.log) or "it logged nothing"
        return f"{self.instance} at t = {self.time:.9g} s: {self.call} returned {self.status}: {logged}"


class FmuWarning(UserWarning):
    """Warning of an FMU that returned fmi2Warning: the simulation goes on."""


def nearest(name: str, known: Iterable[str]) -> str:
    """Returns the end of a message about an unknown name: the known name most like it, or the known names."""
    choices = list(known)
    if not choices:
        return "known: none"
    # reversed: of names that differ in upper case alone, the first remains
    by_lower_case = {choice.lower(): choice for choice in reversed(choices)}
    for match in get_close_matches(name.lower(), by_lower_case, n=1, cutoff=_LIKE):
        return f"nearest is {by_lower_case[match]!r}"
    return f"known: {listed([repr(choice) for choice in sorted(choices)], _LISTED)}"


def listed(words: Sequence[str], most: int) -> str:
    """Returns the words with commas. The number of further words takes their place, unless it would be 1."""
    # "and 1 more" takes as much room as the word itself
    hidden = len(words) - most
    return ", ".join(words) if hidden <= 1 else f"{', '.join(words[:most])} and {hidden} more"


def number_text(value: float) -> str:
    """Returns a number as a reader writes it, with at most 12 digits: 0.1, 1e-6, 1e6 or 2147483647."""
    text = f"{value:g}" if float(f"{value:g}") == value else f"{value:.12g}"
    return re.sub(r"e([+-])0*", lambda exponent: "e" + exponent[1].strip("+"), text)


def range_text(low: float, high: float, unit: str | None = None) -> str:
    """Returns the numbers between two limits in words, with their unit; an infinite limit is no limit."""
    in_unit = "" if unit in (None, "", "1") else f" {unit}"
    if math.isinf(low) and math.isinf(high):
        return "a finite number" + (in_unit and f" in{in_unit}")
    if math.isinf(low):
        return f"at most {number_text(high)}{in_unit}"
    limits = (
        f"at least {number_text(low)}" if math.isinf(high) else f"{number_text(low)} to {number_text(high)}"
    )
    return limits + in_unit
