"""The gains that a tuning chooses, and one search of their least cost by CMA-ES.

Source: Hansen, "The CMA evolution strategy: a tutorial" (arXiv 1604.00772), as the library `cmaes` has it;
restarts with twice the population after Auger and Hansen (CEC 2005).
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import nearest
from fmus.extras import require
from fmus.fmi.description import of_causality
from fmus.fmi.model_description import ModelDescription
from orchestration.errors import OrchestrationError

_DIGITS = 4  # of a gain: what is written is what was run
_AT_A_LIMIT = 0.01  # of the range of a search: a gain this near to its end was stopped by it


@dataclass(frozen=True)
class FreeGain:
    """A parameter of the controller and the limits of its search, in its unit.

    The search is over its logarithm where both limits have one sign.
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
        """Returns the gain at a position in its range, 0 at the lower limit and 1 at the upper one."""
        if self.low * self.high > 0.0:
            value = self.low * (self.high / self.low) ** position
        else:
            value = self.low + (self.high - self.low) * position
        return min(max(float(f"{value:.{_DIGITS}g}"), self.low), self.high)

    def position(self, value: float) -> float:
        """Returns where a gain stands in its range, 0..1."""
        if self.low * self.high > 0.0:
            return math.log(value / self.low) / math.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)

    def is_at_a_limit(self, value: float) -> bool:
        """Whether the range of the search, and not the cost, determines this value."""
        return not self.value(_AT_A_LIMIT) < value < self.value(1.0 - _AT_A_LIMIT)


def parse(text: str) -> FreeGain:
    """Returns the gain of an option NAME=LOW:HIGH."""
    name, _, limits = text.partition("=")
    low, _, high = limits.partition(":")
    try:
        return FreeGain(name.strip(), float(low), float(high))
    except ValueError:
        raise OrchestrationError(f"--free {text}: expected NAME=LOW:HIGH, such as kp=1:20") from None


def with_units(gains: Iterable[FreeGain], description: ModelDescription) -> tuple[FreeGain, ...]:
    """Returns the gains with the units of an FMU; OrchestrationError for one that it cannot take.

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


_BEGIN = (0.25, 0.75)  # of the unit cube: the first mean of a search is drawn from there
_STEP = 0.25  # first standard deviation: half of the range lies within one of the mean
_FINE_STEP = 0.05  # that of a search which begins at a point that another one has found


class Search:
    """Points of the unit cube, generation by generation, until the evaluations are used up.

    The same seed and the same costs give the same points, so that a search continues from its costs alone.
    start: point that the search begins at, in small steps; by default it begins anywhere
    """

    def __init__(
        self, dimensions: int, seed: int, evaluations: int, start: Sequence[float] | None = None
    ) -> None:
        self._dimensions = dimensions
        self._random = np.random.default_rng(seed)
        self._remaining = evaluations
        self._points: list[np.ndarray] = []
        self._start = start
        self._begin(None)

    def _begin(self, population: int | None) -> None:
        cmaes = require("cmaes", "study", "tuning")
        size = max(self._dimensions, 2)  # CMA-ES adapts a covariance: one gain gets a second coordinate
        anywhere = self._random.uniform(*_BEGIN, size)
        self._strategy = cmaes.CMA(
            mean=anywhere if self._start is None else np.array([*self._start, 0.5])[:size],
            sigma=_STEP if self._start is None else _FINE_STEP,
            bounds=np.tile([0.0, 1.0], (size, 1)),
            seed=int(self._random.integers(2**31)),
            population_size=population,
        )

    def ask(self) -> list[np.ndarray]:
        """Returns the points of the next generation, shape (dimensions,) each; none after the budget."""
        count = min(self._strategy.population_size, self._remaining)
        self._points = [self._strategy.ask() for _ in range(count)]
        return [point[: self._dimensions] for point in self._points]

    def tell(self, costs: Sequence[float]) -> None:
        """Takes the costs of the points that were asked for last, in their order."""
        self._remaining -= len(costs)
        if len(costs) < self._strategy.population_size:  # the budget cuts the last generation short
            return
        self._strategy.tell(list(zip(self._points, costs, strict=True)))
        if self._strategy.should_stop():  # converged: the rest of the budget looks elsewhere
            self._begin(2 * self._strategy.population_size)
