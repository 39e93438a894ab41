"""Free parameters of a search, and the option --free that names them with their limits."""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from fmus.errors import range_text
from fmus.fmi.model_description import ScalarVariable
from orchestration.errors import OrchestrationError
from orchestration.system.system import Port
from orchestration.system.values import value_range

# Digits of a value. It is rounded before the run, so that the written value is the one that was run.
_DIGITS = 4
# Of the range: a value this near to its end was stopped by it.
_AT_A_LIMIT = 0.01


@dataclass(frozen=True)
class FreeParameter:
    """A free parameter: the limits of its search and the value that it begins at, in its unit.

    variables: of the FMU that have its value
    """

    name: str
    low: float = -math.inf
    high: float = math.inf
    start: float = math.nan
    unit: str = ""
    variables: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise OrchestrationError(
                f"{self.name}={self.low:g}:{self.high:g}: expected finite limits, the lower one first"
            )

    @property
    def is_limited(self) -> bool:
        return math.isfinite(self.low) and math.isfinite(self.high)

    @property
    def is_logarithmic(self) -> bool:
        """Whether a search is over its logarithm: both limits are finite and have one sign."""
        return self.is_limited and self.low * self.high > 0.0

    def share(self, value: float) -> float:
        """Returns where a value stands in the range, 0 at the lower limit and 1 at the upper one."""
        if self.is_logarithmic:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def at(self, share: float) -> float:
        """Returns the value at a share of the range."""
        if self.is_logarithmic:
            return self.low * (self.high / self.low) ** share
        return self.low + (self.high - self.low) * share

    def rounded(self, share: float) -> float:
        """Returns the value at a share of the range with four digits, within the limits."""
        return self.limited(float(f"{self.at(share):.{_DIGITS}g}"))

    def limited(self, value: float) -> float:
        return min(max(value, self.low), self.high)

    def is_at_a_limit(self, value: float) -> bool:
        """Whether the range of the search, and not what is searched, determines this value."""
        return not self.rounded(_AT_A_LIMIT) < value < self.rounded(1.0 - _AT_A_LIMIT)

    def within(self, variable: ScalarVariable, option: str = "--free") -> "FreeParameter":
        """Returns it with the unit of a variable, and its limits where it has none.

        option: that gave it, for the message
        OrchestrationError for limits that the variable cannot have.
        """
        low, high = value_range(Port("", variable))
        if self.is_limited and not low <= self.low < self.high <= high:
            raise OrchestrationError(
                f"{option} {self.name}={self.low:g}:{self.high:g}: "
                f"expected limits within {range_text(low, high)}"
            )
        ends = (self.low, self.high) if self.is_limited else (low, high)
        return replace(self, low=ends[0], high=ends[1], unit=variable.unit or "")


def parse(texts: Sequence[str], option: str = "--free") -> list[FreeParameter]:
    """Returns the parameters of options --free NAME,NAME=LOW:HIGH; one without limits has infinite ones.

    option: that they are given with, for messages
    """
    # a comma within brackets belongs to an index
    parts = [part.strip() for text in texts for part in re.split(r",(?![^\[]*\])", text)]
    return [_parsed(part, option) for part in parts if part]


def _parsed(part: str, option: str) -> FreeParameter:
    # the last "=": the name of a variable may contain one
    name, equals, limits = part.rpartition("=")
    if not equals:
        return FreeParameter(part)
    low, _, high = limits.partition(":")
    try:
        free = FreeParameter(name.strip(), float(low), float(high))
    except ValueError:
        raise OrchestrationError(
            f"{option} {part}: expected NAME or NAME=LOW:HIGH, such as {name.strip()}=1:20"
        ) from None
    if not free.is_limited:
        raise OrchestrationError(f"{option} {part}: expected finite limits, the lower one first")
    return free


def check_once(parameters: Iterable[FreeParameter]) -> None:
    """Refuses a variable that two parameters name."""
    taken = set[str]()
    for free in parameters:
        names = free.variables or (free.name,)
        if taken & {*names}:
            raise OrchestrationError(f"--free {free.name}: given twice: expected it once")
        taken |= {*names}
