"""Distributions by name: a declaration becomes a function from uniform numbers to values.

Inverse transform: value = F^-1(F(low) + u (F(high) - F(low))), u uniform in [0, 1), F the cumulative
distribution, low..high the range that it is truncated to. One number in, one value out: what one
variable is given does not depend on how another is drawn.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

import numpy as np

from fmus.errors import range_text
from fmus.extras import imports_of
from orchestration.errors import ScenarioError
from orchestration.system.quantities import Conversion


@dataclass(frozen=True)
class Distribution:
    """A distribution of values.

    quantile: uniform numbers in [0, 1) -> as many values
    reach: least and largest value that it can give; nan where `probes` stand for all values
    probes: numbers whose values stand for all that it can give, to check before anything is drawn
    """

    quantile: Callable[[Sequence[float]], list[Any]]
    reach: tuple[float, float] = (math.nan, math.nan)
    probes: tuple[float, ...] = (0.5,)

    def converted(self, change: Conversion) -> "Distribution":
        """Returns the distribution of the values in another unit."""
        low, high = map(change, self.reach)
        return Distribution(
            lambda uniforms: [*map(change, self.quantile(uniforms))], (low, high), self.probes
        )


def _truncated(
    cumulative: Callable[[Any], Any],
    quantile: Callable[[np.ndarray], np.ndarray],
    low: float,
    high: float,
    support: tuple[float, float],
) -> Distribution:
    """Returns a continuous distribution, truncated to low..high.

    cumulative: F; quantile: its inverse; support: where F is neither 0 nor 1
    """
    begin, end = float(cumulative(low)), float(cumulative(high))
    if not begin < end:
        raise ScenarioError(f"expected some probability within {low:g}..{high:g}, got none")
    least, largest = max(low, support[0]), min(high, support[1])

    def values(uniforms: Sequence[float]) -> list[float]:
        return np.clip(quantile(begin + np.array(uniforms) * (end - begin)), least, largest).tolist()

    return Distribution(values, (least, largest))


def _within(quantile: Callable[[np.ndarray], np.ndarray], low: float, high: float) -> Distribution:
    """Returns a continuous distribution whose support is low..high, but for rounding."""
    size = high - low
    return _truncated(lambda x: (x - low) / size, quantile, low, high, (low, low + size))


def normal(mean: float, std: float, low: float = -math.inf, high: float = math.inf) -> Distribution:
    """Returns the normal distribution.

    Parameters
    ----------
    mean : float
        Mean before it is truncated.
    std : float
        Standard deviation before it is truncated, more than 0.
    low, high : float
        Range to which it is truncated.

    Returns
    -------
    Distribution

    Raises
    ------
    ScenarioError
        For a standard deviation that is not above 0, or a range without probability.
    """
    # SciPy takes longer to import than to draw
    with imports_of("sweep", "a sweep"):
        from scipy.special import ndtr, ndtri

    _positive("std", std)
    support = -math.inf, math.inf
    return _truncated(lambda x: ndtr((x - mean) / std), lambda q: ndtri(q) * std + mean, low, high, support)


def lognormal(median: float, sigma: float, low: float = 0.0, high: float = math.inf) -> Distribution:
    """Returns the lognormal distribution.

    Parameters
    ----------
    median : float
        Median before it is truncated, more than 0.
    sigma : float
        Standard deviation of the natural logarithm, more than 0.
    low, high : float
        Range to which it is truncated.

    Returns
    -------
    Distribution

    Raises
    ------
    ScenarioError
        For a median or sigma that is not above 0, or a range without probability.
    """
    with imports_of("sweep", "a sweep"):
        from scipy.special import ndtr, ndtri

    _positive("median", median)
    _positive("sigma", sigma)

    def cumulative(x: float) -> float:
        return ndtr(np.log(x / median) / sigma) if x > 0.0 else 0.0

    return _truncated(cumulative, lambda q: np.exp(sigma * ndtri(q)) * median, low, high, (0.0, math.inf))


def uniform(low: float, high: float) -> Distribution:
    """Returns the uniform distribution from low to high.

    Parameters
    ----------
    low, high : float
        Ends of the range.

    Returns
    -------
    Distribution

    Raises
    ------
    ScenarioError
        For ends that do not ascend.
    """
    _ascending(low, high)
    return _within(lambda q: q * (high - low) + low, low, high)


def loguniform(low: float, high: float) -> Distribution:
    """Returns a distribution that is uniform in the logarithm.

    Parameters
    ----------
    low, high : float
        Ends of the range, more than 0.

    Returns
    -------
    Distribution

    Raises
    ------
    ScenarioError
        For ends that do not ascend, or are not above 0.
    """
    _positive("low", low)
    _ascending(low, high)
    first, size = np.log(low), np.log(high) - np.log(low)
    # at 0 the logarithm and its inverse would round
    return _within(lambda q: np.where(q > 0.0, np.exp(first + q * size), low), low, high)


def triangular(low: float, mode: float, high: float) -> Distribution:
    """Returns the triangular distribution from low to high, with the most probable value mode.

    Parameters
    ----------
    low, high : float
        Ends of the range.
    mode : float
        Most probable value.

    Returns
    -------
    Distribution

    Raises
    ------
    ScenarioError
        For numbers that do not ascend.
    """
    _ascending(low, high)
    if not low <= mode <= high:
        raise ScenarioError(f"mode = {mode!r}: expected {range_text(low, high)}")
    share = (mode - low) / (high - low)

    def quantile(q: np.ndarray) -> np.ndarray:
        rising, falling = np.sqrt(share * q), 1.0 - np.sqrt((1.0 - share) * (1.0 - q))
        return np.where(q < share, rising, falling) * (high - low) + low

    return _within(quantile, low, high)


def integers(low: int, high: int) -> Distribution:
    """Returns each integer from low to high with equal probability, both included.

    Parameters
    ----------
    low, high : int
        Least and largest value.

    Returns
    -------
    Distribution

    Raises
    ------
    ScenarioError
        For a least value above the largest.
    """
    _ascending(low, high + 1)
    count = high - low + 1
    return Distribution(lambda uniforms: [low + math.floor(u * count) for u in uniforms], (low, high))


def seed(low: int, high: int) -> Distribution:
    """Returns each integer of the variable's range with equal probability.

    Parameters
    ----------
    low, high : int
        Range of the variable.

    Returns
    -------
    Distribution
    """
    return integers(low, high)


def choice(values: list[Any], weights: list[float] | None = None) -> Distribution:
    """Returns one of the values, with probabilities in proportion to the weights; equal ones by default.

    Parameters
    ----------
    values : list
        Numbers, texts or Booleans.
    weights : list of float, optional
        Weight of each value, 0 or more.

    Returns
    -------
    Distribution

    Raises
    ------
    ScenarioError
        For no values, or other weights.
    """
    shares = [1.0] * len(values) if weights is None else weights
    if not values:
        raise ScenarioError("values = []: expected a list of values")
    if len(shares) != len(values) or min(shares) < 0.0 or not sum(shares) > 0.0:
        raise ScenarioError(f"weights = {weights!r}: expected {len(values)} numbers that are not all 0")
    ends = list(accumulate(shares))
    middles = tuple((end - 0.5 * share) / ends[-1] for end, share in zip(ends, shares, strict=True) if share)
    inner, last = ends[:-1], ends[-1]
    return Distribution(
        lambda uniforms: [values[bisect_right(inner, u * last)] for u in uniforms], probes=middles
    )


UNBOUNDED = ("normal", "lognormal")
FROM_THE_FMU = "seed"  # the range of the variable is its range
FUNCTIONS: dict[str, Callable[..., Distribution]] = {
    function.__name__: function
    for function in (normal, lognormal, uniform, loguniform, triangular, integers, seed, choice)
}


def distribution(
    name: str, arguments: Mapping[str, Any], permitted: tuple[float, float], truncate: bool
) -> Distribution:
    """Returns the distribution of that name with the arguments that a file gives.

    permitted: the range of the variable; truncate: whether to draw within it
    Raises ScenarioError without the place in the file, which the caller adds.
    """
    given = dict(arguments)
    if name == FROM_THE_FMU:
        given |= _integer_range(permitted)
    if truncate:
        given["low"] = max(given.get("low", -math.inf), permitted[0])
        given["high"] = min(given.get("high", math.inf), permitted[1])
    return FUNCTIONS[name](**given)


def _integer_range(permitted: tuple[float, float]) -> dict[str, int]:
    if not all(math.isfinite(limit) for limit in permitted):
        raise ScenarioError(
            "a seed is drawn from the variable's range: expected an FMU that gives min and max"
        )
    return {"low": math.ceil(permitted[0]), "high": math.floor(permitted[1])}


def _positive(name: str, value: float) -> None:
    if not value > 0.0:
        raise ScenarioError(f"{name} = {value!r}: expected more than 0")


def _ascending(low: float, high: float) -> None:
    if not low < high:
        raise ScenarioError(f"low = {low!r}, high = {high!r}: expected low below high")
