"""Nonlinear least squares over runs: values of free parameters at which residuals are least.

Residuals are asked for at many points at once, so that the columns of a Jacobian step together in vectors.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orchestration.errors import OrchestrationError

Values = Mapping[str, float]
Evaluate = Callable[[Sequence[Values]], Iterable[np.ndarray]]
"""Returns the residuals at some points, shape (m,) each; a point is name -> value of each parameter."""

_SCALED_LOW, _SCALED_HIGH = 1.0, 2.0  # coordinates of the limits of a logarithmic search


@dataclass(frozen=True)
class Free:
    """A free parameter: the limits of its search and the value that it begins at, in its unit.

    Where both limits are positive and finite, the coordinate of the search is the position of the logarithm
    between them, 1 to 2; otherwise it is the value over `scale`, its size at the start. So coordinates stay
    away from 0, and finite differences can be relative to them.
    variables: those of the FMU that have its value
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
                f"{self.name}={self.low:g}:{self.high:g}: expected the lower limit first"
            )

    @property
    def is_logarithmic(self) -> bool:
        return self.low > 0.0 and self.high < math.inf

    @property
    def scale(self) -> float:
        return abs(self.start) or 1.0

    def coordinate(self, value: float) -> float:
        """Returns the coordinate of a value."""
        if not self.is_logarithmic:
            return value / self.scale
        return _SCALED_LOW + math.log(value / self.low) / math.log(self.high / self.low)

    def value(self, coordinate: float) -> float:
        """Returns the value of a coordinate, within the limits."""
        if self.is_logarithmic:
            value = self.low * (self.high / self.low) ** (coordinate - _SCALED_LOW)
        else:
            value = coordinate * self.scale
        return min(max(value, self.low), self.high)

    @property
    def relative(self) -> float:
        """Relative change of the value for a change of the coordinate by 1; relative to `scale` if linear."""
        return math.log(self.high / self.low) if self.is_logarithmic else 1.0


def values_at(free: Sequence[Free], coordinates: np.ndarray) -> dict[str, float]:
    """Returns the value of each parameter at a point, shape (n,)."""
    return {one.name: one.value(float(x)) for one, x in zip(free, coordinates, strict=True)}


@dataclass
class Search:
    """A search of least squares, with the best point that it asked for.

    difference: step of the finite differences, relative to the coordinate
    evaluations: how many points may be evaluated in all; progress: called with the lowest cost after each
    best: coordinates, shape (n,); cost: half the sum of squares there; count: of the points evaluated
    """

    free: Sequence[Free]
    evaluate: Evaluate
    difference: float
    evaluations: int
    progress: Callable[[float], None] = lambda cost: None
    best: np.ndarray = field(default_factory=lambda: np.empty(0))
    residuals: np.ndarray = field(default_factory=lambda: np.empty(0))
    cost: float = math.inf
    count: int = 0
    ended: str = ""
    _last: np.ndarray = field(default_factory=lambda: np.empty(0))

    def run(self, start: np.ndarray, **options: Any) -> "Search":
        """Searches from a point, shape (n,), and returns itself; `ended` says why it ended.

        options: of `scipy.optimize.least_squares`
        """
        from scipy.optimize import least_squares  # slow to import

        limits = (
            [one.coordinate(x) for one, x in zip(self.free, ends, strict=True)] for ends in self._limits
        )
        self.ended = f"the {self.evaluations} evaluations are used up"
        with suppress(_OutOfEvaluations):
            jacobian: Any = self.jacobian  # a function, which SciPy does not declare
            result = least_squares(lambda x: self.at([x])[0], start, jacobian, bounds=(*limits,), **options)
            self.ended = "" if result.success else str(result.message)
        return self

    @property
    def _limits(self) -> tuple[list[float], list[float]]:
        return [one.low for one in self.free], [one.high for one in self.free]

    def at(self, points: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Returns the residuals at points, shape (m,) each."""
        points = points[: self.evaluations - self.count]
        result = []
        for point, residuals in zip(points, self._evaluated(points), strict=True):
            result.append(residuals)
            self.count, self._last = self.count + 1, residuals
            cost = 0.5 * float(residuals @ residuals)
            if cost < self.cost:
                self.best, self.residuals, self.cost = np.array(point), residuals, cost
            self.progress(self.cost)
        return result

    def _evaluated(self, points: Sequence[np.ndarray]) -> Iterable[np.ndarray]:
        if not points:
            raise _OutOfEvaluations
        return self.evaluate([values_at(self.free, point) for point in points])

    def jacobian(self, x: np.ndarray, central: bool = False) -> np.ndarray:
        """Returns the derivatives of the residuals by the coordinates, shape (m, n).

        central: of second order, beyond limits too; else from the point that was evaluated last, which is `x`
        """
        steps = self.difference * np.where(x < 0.0, -1.0, 1.0) * np.maximum(np.abs(x), 1.0)
        if not central:
            steps = np.where([self._is_beyond(i, x[i] + h) for i, h in enumerate(steps)], -steps, steps)
        ahead, behind = x + np.diag(steps), x - np.diag(steps) if central else np.tile(x, (len(x), 1))
        at_x = [self._last] * len(x)
        residuals = self.at([*ahead, *behind] if central else [*ahead])
        if len(residuals) < (2 if central else 1) * len(x):
            raise _OutOfEvaluations
        after, before = residuals[: len(x)], residuals[len(x) :] if central else at_x
        return (np.array(after) - before).T / np.diag(ahead - behind)

    def _is_beyond(self, i: int, x: float) -> bool:
        one = self.free[i]
        return not one.coordinate(one.low) <= x <= one.coordinate(one.high)


class _OutOfEvaluations(Exception):  # noqa: N818  (a signal to stop, not an error)
    pass
