"""The gains that a tuning chooses, and where they stand in the unit cube that an optimiser searches."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from fmus.errors import nearest
from fmus.fmi.description import of_causality
from fmus.fmi.model_description import ModelDescription
from orchestration.errors import OrchestrationError

_DIGITS = 4  # of a gain: what is written is what was run
_AT_A_LIMIT = 0.01  # of the range of a search: a gain this near to its end was stopped by it


@dataclass(frozen=True)
class FreeGain:
    """A parameter of the controller and the limits of its search, in its unit.

    The search is over its logarithm where both limits are positive.
    """

    name: str
    low: float
    high: float
    unit: str = ""

    def __post_init__(self) -> None:
        if not -math.inf < self.low < self.high < math.inf:
            raise OrchestrationError(
                f"{self.name} = {self.low:g}:{self.high:g}: expected finite limits, the lower one first"
            )

    def value(self, position: float) -> float:
        """The gain at a position in its range, 0 at the lower limit and 1 at the upper one."""
        if self.low > 0.0:
            value = self.low * (self.high / self.low) ** position
        else:
            value = self.low + (self.high - self.low) * position
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high)

    def position(self, value: float) -> float:
        """Where a gain stands in its range, 0..1."""
        if self.low > 0.0:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def is_at_a_limit(self, value: float) -> bool:
        """Whether the range of the search, and not the cost, determines this value."""
        return not self.value(_AT_A_LIMIT) < value < self.value(1.0 - _AT_A_LIMIT)


def parse(text: str) -> FreeGain:
    """The gain of an option NAME=LOW:HIGH."""
    name, _, limits = text.partition("=")
    low, _, high = limits.partition(":")
    try:
        return FreeGain(name.strip(), float(low), float(high))
    except ValueError:
        raise OrchestrationError(f"--free {text}: expected NAME=LOW:HIGH, such as kp=1:20") from None


def with_units(gains: Iterable[FreeGain], description: ModelDescription) -> tuple[FreeGain, ...]:
    """The gains with the units of an FMU; OrchestrationError for one that it cannot take.

    A gain is a parameter of type Real, tunable or fixed, whose declared range holds the limits.
    """
    parameters = {v.name: v for v in of_causality(description, "parameter") if v.type == "Real"}
    tunable = [name for name, v in parameters.items() if v.variability == "tunable"]
    chosen: dict[str, FreeGain] = {}
    for gain in gains:
        if gain.name not in parameters:
            raise OrchestrationError(
                f"--free {gain.name}: expected a parameter of type Real; {nearest(gain.name, parameters)}"
            )
        if gain.name in chosen:
            raise OrchestrationError(f"--free {gain.name}: given twice: expected one range")
        variable = parameters[gain.name]
        low = -math.inf if variable.min is None else float(variable.min)
        high = math.inf if variable.max is None else float(variable.max)
        if not low <= gain.low < gain.high <= high:
            raise OrchestrationError(
                f"--free {gain.name}={gain.low:g}:{gain.high:g}: expected limits within {low:g}..{high:g}"
            )
        chosen[gain.name] = replace(gain, unit=variable.unit or "")
    if not chosen:
        raise OrchestrationError(
            f"nothing to tune: expected --free NAME=LOW:HIGH; tunable are {', '.join(tunable) or 'none'}"
        )
    return tuple(chosen.values())
