"""Nonlinear least squares over runs: values of free parameters at which residuals are least.

Residuals are asked for at many points at once, so that the columns of a Jacobian step together in vectors.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orchestration.scenarios.free_parameter import FreeParameter

Values = Mapping[str, float]
Evaluate = Callable[[Sequence[Values]], Iterable[np.ndarray]]
"""Returns the residuals at some points, shape (m,) each; a point is name -> value of each parameter."""

_FIRST = 1.0  # coordinate of the lower limit of a logarithmic search; that of the upper one is 2


def coordinate(free: FreeParameter, value: float) -> float:
    """Returns the coordinate of a value in the search.

    It is the position of the logarithm between the limits, 1 to 2, or the value over `scale`: away from 0, so
    that finite differences can be relative to it.
    """
    return _FIRST + free.share(value) if free.is_logarithmic else value / scale(free)


def value_at(free: FreeParameter, coordinate: float) -> float:
    """Returns the value of a coordinate, within the limits."""
    value = free.at(coordinate - _FIRST) if free.is_logarithmic else coordinate * scale(free)
    return free.limited(value)


def scale(free: FreeParameter) -> float:
    """Returns the size of the value at the start."""
    return abs(free.start) or 1.0


def relative_change(free: FreeParameter) -> float:
    """Returns the relative change of the value, to `scale` if linear, for a change of the coordinate by 1."""
    return math.log(free.high / free.low) if free.is_logarithmic else 1.0


def values_at(free: Sequence[FreeParameter], coordinates: np.ndarray) -> dict[str, float]:
    """Returns the value of each parameter at a point, shape (n,)."""
    return {one.name: value_at(one, float(x)) for one, x in zip(free, coordinates, strict=True)}


@dataclass
class LeastSquares:
    """A search of least squares, with the best point that it asked for.

    difference: step of the finite differences, relative to the coordinate
    evaluations: how many points may be evaluated in all; progress: called with the lowest cost after each
    best: coordinates, shape (n,); cost: half the sum of squares there; count: of the points evaluated
    """

    free: Sequence[FreeParameter]
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

    def run(self, start: np.ndarray, **options: Any) -> "LeastSquares":
        """Searches from a point, shape (n,), and returns itself; `ended` says why it ended.

        options: of `scipy.optimize.least_squares`
        """
        from scipy.optimize import least_squares  # slow to import

        limits = (
            [coordinate(one, x) for one, x in zip(self.free, ends, strict=True)] for ends in self._limits
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
        return not coordinate(one, one.low) <= x <= coordinate(one, one.high)


class _OutOfEvaluations(Exception):  # noqa: N818  (a signal to stop, not an error)
    pass
