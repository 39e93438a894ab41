"""Values that two runs give, compared."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError
from fmus.compliance.script import Reading
from fmus.compliance.values import read_value

_LARGE = 1e-5  # relative: what is more is compared with the variable itself
RESTARTED = 1e-2  # relative: what a solver that begins anew at an event may change
_SMALL = 0.01  # of the largest variable: what is smaller is compared against that
_LONGEST_TEXT = 60  # characters of a value


def texts(*values: Any) -> list[str]:
    """Numbers with as few digits as show that they differ, six at least."""
    if not all(isinstance(value, (int, float)) for value in values):
        return [repr(value) for value in values]
    for digits in (6, 9, 12, 15):
        shown = [f"{value:.{digits}g}" for value in values]
        if len(set(shown)) == len({repr(value) for value in values}):
            return shown
    return [repr(value) for value in values]


def same(a: Any, b: Any, tolerance: float = 0.0, scale: float = 0.0) -> bool:
    """Whether two values are equal; numbers up to a tolerance relative to the larger and the scale."""
    if a == b:
        return True
    if not isinstance(a, float) or not isinstance(b, (int, float)):
        return False
    if math.isnan(a) and math.isnan(b):
        return True
    return abs(a - b) <= tolerance * max(abs(a), abs(b), scale)


@dataclass(frozen=True)
class Given:
    """Values that variables should have, in place of a reading of them."""

    values: dict[str, Any]


def differing(
    expected: Iterable[Reading | Given],
    got: Iterable[Reading],
    when: str,
    tolerance: float = 0.0,
    again: str = "{} again",
    where: Sequence[str] = (),
) -> Iterator[str]:
    """Yields each variable's first value that is not the same; a tolerance is relative to the largest number,
    a large one to the variable's own, or a hundredth of the largest; to the value itself where it is given.

    again: what is expected, in words, of the value; where: words for each reading, if not its number
    """
    pairs = [(row.values, other.values, row) for row, other in zip(expected, got, strict=True)]
    scales: dict[str, float] = {}
    for row, _, source in pairs:
        for name, value in row.items() if isinstance(source, Reading) else ():
            if isinstance(value, float) and math.isfinite(value):
                scales[name] = max(abs(value), scales.get(name, 0.0))
    least = (_SMALL if tolerance >= _LARGE else 1.0) * max(scales.values(), default=0.0)
    named = set()
    for i, (row, other, _) in enumerate(pairs):
        for name, value in other.items():
            value_read, value_expected = read_value(value), read_value(row[name])
            scale = max(scales.get(name, 0.0), least)
            if name not in named and not same(value_expected, value_read, tolerance, scale):
                named.add(name)
                new, old = (text[:_LONGEST_TEXT] for text in texts(value_read, value_expected))
                place = where[i] if where else f", step {i + 1}" if len(pairs) > 1 else ""
                yield f"{name} is {new} {when}{place}: expected {again.format(old)}"


def _steady(probe: Probe) -> set[str]:
    """Returns the names of the variables that are the same in every instance: no clock of the computer."""

    def names() -> set[str]:
        one, other = probe.script().begin(), probe.script().begin()
        first, second = ([s.step().read(s.variables) for _ in range(3)] for s in (one, other))
        probe.play_each([one, other])
        if not one.succeeded or not other.succeeded:
            raise NotJudgedError("a run fails")
        others = {message.split(" is ", 1)[0] for message in differing(first, second, "")}
        return {v.name for v in probe.fmu.variables} - others

    return probe.once("comparison of two runs", names)


def steadily(probe: Probe, messages: Iterable[str]) -> Iterator[str]:
    """Returns the messages about variables that are the same in every instance."""
    steady = _steady(probe)
    return (message for message in messages if message.split(" is ", 1)[0] in steady)
