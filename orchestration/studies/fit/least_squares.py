"""Nonlinear least squares over runs: the values of free parameters with the least residuals.

Residuals are asked for at many points at once, so that the columns of a Jacobian step together in vectors.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fmus.extras import require
from orchestration.errors import OrchestrationError
from orchestration.scenarios.free_parameter import FreeParameter

Values = Mapping[str, float]
Evaluate = Callable[[Sequence[Values]], Iterable[np.ndarray]]
"""Returns the residuals at some points, shape (m,) each; a point is name -> value of each parameter."""

_FIRST = 1.0  # coordinate of the lower limit of a logarithmic search; the upper one has 2


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
        # slow to import
        least_squares = require("scipy.optimize", "study", "a fit").least_squares

        self.ended = f"the {self.evaluations} evaluations are used up"
        with suppress(_OutOfEvaluations):
            jacobian: Any = self.jacobian  # a function, which SciPy does not declare
            result = least_squares(lambda x: self.at([x])[0], start, jacobian, bounds=self._limits, **options)
            self.ended = "" if result.success else str(result.message)
        return self

    @property
    def _limits(self) -> tuple[list[float], list[float]]:
        """Coordinates of the lower limits, and of the upper ones."""
        lower = [coordinate(one, one.low) for one in self.free]
        return lower, [coordinate(one, one.high) for one in self.free]

    def at(self, points: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Returns the residuals at points, shape (m,) each."""
        points = points[: self.evaluations - self.count]
        if not points:
            raise _OutOfEvaluations
        result, evaluated = [], self.evaluate([values_at(self.free, point) for point in points])
        for point, residuals in zip(points, evaluated, strict=True):
            result.append(residuals)
            self.count, self._last = self.count + 1, residuals
            cost = 0.5 * float(residuals @ residuals)
            if cost < self.cost:
                self.best, self.residuals, self.cost = np.array(point), residuals, cost
            self.progress(self.cost)
        return result

    def jacobian(self, x: np.ndarray, central: bool = False) -> np.ndarray:
        """Returns the derivatives of the residuals by the coordinates, shape (m, n).

        central: of second order, beyond limits too; else from the point that was evaluated last, which is `x`
        """
        steps = self.difference * np.where(x < 0.0, -1.0, 1.0) * np.maximum(np.abs(x), 1.0)
        # a search stays within its limits: at a limit the difference is taken to the other side
        if not central:
            low, high = self._limits
            steps = np.where((x + steps < low) | (x + steps > high), -steps, steps)
        ahead, behind = x + np.diag(steps), x - np.diag(steps) if central else np.tile(x, (len(x), 1))
        at_x = [self._last] * len(x)
        residuals = self.at([*ahead, *behind] if central else [*ahead])
        if len(residuals) < (2 if central else 1) * len(x):
            raise _OutOfEvaluations
        after, before = residuals[: len(x)], residuals[len(x) :] if central else at_x
        return (np.array(after) - before).T / np.diag(ahead - behind)


class _OutOfEvaluations(Exception):  # noqa: N818  (a signal to stop, not an error)
    pass


LEVEL = 0.95
# standard deviation over the value, of a combination that the data do not determine
_NOT_DETERMINED = 1.0
# of the largest singular value: below it a derivative is only the rounding of its differences
_ROUNDING = 1e-6
# of the square of a direction: a parameter with less is no part of it
_SHARE = 0.01
# of the sum of autocovariances: beyond it the correction is no longer of first order
_MOST_LOST = 0.8
_FEWEST_INDEPENDENT, _SIGNIFICANT = 30, 4.0  # readings; standard deviations
_AT_A_LIMIT = 1e-6  # of the coordinate
# of the rise of the sum of squares that the linear model predicts at the ends of an interval
_ROUGH = 0.25


@dataclass(frozen=True)
class ParameterEstimate:
    """An estimate of a parameter: value and interval of `LEVEL` in the unit of the parameter.

    note: empty, or why the interval is as it is
    """

    free: FreeParameter
    value: float
    low: float
    high: float
    note: str = ""


@dataclass(frozen=True)
class Analysis:
    """Estimates, the standard deviation and correlation time [readings] of the residuals, and messages.

    rough: names of the parameters whose intervals are wrong by more than a few per cent of their length
    doubts: why neither values nor intervals are to be trusted
    """

    estimates: tuple[ParameterEstimate, ...]
    noise: float
    correlation_time: float
    undetermined: tuple[str, ...]
    rough: tuple[str, ...]
    doubts: tuple[str, ...] = ()


def correlation_time(series: Sequence[np.ndarray], fitted: int = 0) -> float:
    """Returns 1 + 2 sum of the autocorrelations of residuals, at least 1, in readings.

    series: of each dive; fitted: number of parameters, which take a part of the slow noise with them
    The sum ends where two neighbours are negative in sum: Geyer, Practical Markov chain Monte Carlo,
    Statist. Sci. 7(4), 1992.
    """
    longest, count = max(map(len, series)), sum(map(len, series))
    covariance = np.zeros(longest + 1)
    for residuals in series:
        spectrum = np.abs(np.fft.rfft(residuals, 2 * longest)) ** 2
        covariance[:longest] += np.fft.irfft(spectrum, 2 * longest)[:longest]
    if covariance[0] == 0.0:
        return 1.0
    pairs = (covariance[: 2 * (len(covariance) // 2)] / covariance[0]).reshape(-1, 2).sum(axis=1)
    positive = int(np.argmax(pairs <= 0.0)) if (pairs <= 0.0).any() else len(pairs)
    # each parameter lowers each autocovariance by about 1 / count of the sum that is sought
    lost = min(_MOST_LOST, (4 * positive - 1) * fitted / count)
    return max(1.0, (2.0 * float(pairs[:positive].sum()) - 1.0) / (1.0 - lost))


def analysed(
    search: LeastSquares,
    series: Callable[[np.ndarray], Sequence[np.ndarray]],
    rates: np.ndarray | None = None,
) -> Analysis:
    """Returns the estimates at the best point of a search, with intervals.

    series: splits the residuals by dives; rates: of the simulated depth [m/s], shape (m,), to find a lag
    """
    # slow to import
    student = require("scipy.stats", "study", "a fit").t

    free, best, residuals, cost = search.free, search.best, search.residuals, search.cost
    # one more than the free parameters: the sum ends early where its noise crosses zero
    tau = correlation_time(series(residuals), len(free) + 1)
    noise = math.sqrt(float(residuals @ residuals) / (len(residuals) - len(free)))
    deviation = max(noise, np.finfo(float).eps) * math.sqrt(tau)
    limits = [_limit(one, x) for one, x in zip(free, best, strict=True)]
    inside = [i for i, limit in enumerate(limits) if not limit]
    relative = np.array([relative_change(one) for one in free])
    jacobian = search.jacobian(best, central=True)
    # a step of the differences may have come lower: estimates, ends and recordings are of one point
    search.best, search.residuals, search.cost = best, residuals, cost
    _, singular, directions = np.linalg.svd((jacobian / relative)[:, inside] / deviation, full_matrices=False)
    is_known = singular > max(1.0 / _NOT_DETERMINED, _ROUNDING * singular.max(initial=0.0))
    unknown = (directions[~is_known] ** 2).sum(axis=0) > _SHARE
    scaled = directions[is_known] / singular[is_known, None]
    covariance = (scaled.T @ scaled) / np.outer(relative[inside], relative[inside])
    factor = float(student.ppf(0.5 + 0.5 * LEVEL, max(1.0, len(residuals) / tau - len(free))))
    estimates = []
    for i, (one, x) in enumerate(zip(free, best, strict=True)):
        estimate = ParameterEstimate(one, value_at(one, float(x)), one.low, one.high, limits[i])
        if i in inside:
            row = inside.index(i)
            if unknown[row]:
                estimate = replace(estimate, note="not determined")
            else:
                half = factor * math.sqrt(covariance[row, row])
                estimate = replace(
                    estimate, low=value_at(one, float(x) - half), high=value_at(one, float(x) + half)
                )
        estimates.append(estimate)
    shares = np.array([_share(free[i], float(best[i])) for i in inside])
    messages = [_undetermined([free[i] for i in inside], row * shares) for row in directions[~is_known]]
    determined = [row for row in range(len(inside)) if not unknown[row] and covariance[row, row] > 0.0]
    rough = []
    for row in determined:
        step = np.zeros(len(best))
        step[inside] = factor * covariance[:, row] / math.sqrt(covariance[row, row])
        if _is_rough(search, best, step, factor * deviation):
            rough.append(free[inside[row]].name)
    doubts = [] if rates is None else [*_lags(jacobian, residuals, rates, series)]
    if (independent := len(residuals) / tau) < _FEWEST_INDEPENDENT:
        doubts.append(
            f"readings are worth {independent:.3g} independent ones: expected {_FEWEST_INDEPENDENT} or more"
        )
    return Analysis(tuple(estimates), noise, tau, tuple(messages), tuple(rough), tuple(doubts))


def _lags(
    jacobian: np.ndarray,
    residuals: np.ndarray,
    rates: np.ndarray,
    series: Callable[[np.ndarray], Sequence[np.ndarray]],
) -> Iterator[str]:
    """Yields a message about a lag of the readings that no fitted parameter explains (a score test)."""
    left = rates - jacobian @ np.linalg.lstsq(jacobian, rates)[0]
    lag = float(left @ residuals / max(left @ left, np.finfo(float).tiny))
    noise = residuals - lag * left
    tau = correlation_time(series(noise), jacobian.shape[1] + 2)
    error = math.sqrt(float(noise @ noise) / len(noise) * tau / max(left @ left, np.finfo(float).tiny))
    if abs(lag) > _SIGNIFICANT * error:
        later = "later" if lag > 0.0 else "earlier"
        yield f"readings come {abs(lag):.2g} s {later} than the model: it lacks a lag, or clocks differ"


def _is_rough(search: LeastSquares, best: np.ndarray, step: np.ndarray, rise: float) -> bool:
    """Whether the sum of squares at the ends of an interval differs from the linear model.

    step: from the best point to an end, the other parameters with it; rise: square root of that predicted
    """
    points = [values_at(search.free, best + sign * step) for sign in (1.0, -1.0)]
    least = float(search.residuals @ search.residuals)
    try:
        rises = [float(r @ r) - least for r in search.evaluate(points)]
    except OrchestrationError:  # of values with which nothing can run
        return True
    return any(abs(one / rise**2 - 1.0) > _ROUGH for one in rises)


def _limit(one: FreeParameter, x: float) -> str:
    for limit in (one.low, one.high):
        if math.isfinite(limit) and abs(x - coordinate(one, limit)) < _AT_A_LIMIT * max(1.0, abs(x)):
            return f"at the limit {limit:g}"
    return ""


def _share(one: FreeParameter, x: float) -> float:
    """Returns the change of the value, relative to it, for one relative to its size at the start."""
    return 1.0 if one.is_logarithmic or x == 0.0 else 1.0 / x


def _undetermined(free: Sequence[FreeParameter], direction: np.ndarray) -> str:
    """Returns a message about a direction in which the data do not determine the parameters."""
    largest = direction[np.argmax(np.abs(direction))]
    members = [i for i, x in enumerate(direction) if x * x > _SHARE * largest * largest]
    names = [free[i].name for i in members]
    if len(members) == 1:
        return f"{names[0]}: the depth does not depend on it beyond the noise"
    listed = f"{', '.join(names[:-1])} and {names[-1]}"
    if np.allclose(direction[members], largest, rtol=0.05):
        return f"{listed}: only their ratios are determined; give one of them a value by --set"
    changes = ", ".join(f"{free[i].name} {10.0 * direction[i] / largest:+.2g} %" for i in members)
    return f"{listed}: {changes} together leave the depth as it is; give one of them a value by --set"
