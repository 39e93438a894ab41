"""Distributions by name: a declaration becomes a function from a uniform number to a value.

Inverse transform: value = F^-1(F(low) + u (F(high) - F(low))), u uniform in [0, 1), F the cumulative
distribution, low..high the range that it is truncated to. One number in, one value out: what one
variable is given does not depend on how another is drawn.
"""

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import accumulate
from typing import Any

from scipy import stats

from fmus.errors import nearest
from orchestration.errors import ScenarioError


@dataclass(frozen=True)
class Distribution:
    """quantile: a uniform number in [0, 1) -> a value

    reach: least and largest value that it can give; nan where that says nothing
    probes: numbers whose values stand for all that it can give, to be checked before anything is drawn
    """

    quantile: Callable[[float], Any]
    reach: tuple[float, float] = (math.nan, math.nan)
    probes: tuple[float, ...] = (0.5,)


def _frozen(law: Any, low: float, high: float) -> Distribution:
    """One of SciPy's continuous distributions, truncated to low..high."""
    begin, end = float(law.cdf(low)), float(law.cdf(high))
    if not begin < end:
        raise ScenarioError(f"expected some probability within {low:g}..{high:g}, got none")
    reach = max(low, float(law.support()[0])), min(high, float(law.support()[1]))
    return Distribution(
        lambda u: min(max(float(law.ppf(begin + u * (end - begin))), reach[0]), reach[1]), reach
    )


def normal(mean: float, std: float, low: float = -math.inf, high: float = math.inf) -> Distribution:
    _positive("std", std)
    return _frozen(stats.norm(mean, std), low, high)


def lognormal(median: float, sigma: float, low: float = 0.0, high: float = math.inf) -> Distribution:
    """sigma: standard deviation of the natural logarithm."""
    _positive("median", median)
    _positive("sigma", sigma)
    return _frozen(stats.lognorm(sigma, scale=median), low, high)


def uniform(low: float, high: float) -> Distribution:
    _ascending(low, high)
    return _frozen(stats.uniform(low, high - low), low, high)


def loguniform(low: float, high: float) -> Distribution:
    """Uniform in the logarithm."""
    _positive("low", low)
    _ascending(low, high)
    return _frozen(stats.loguniform(low, high), low, high)


def triangular(low: float, mode: float, high: float) -> Distribution:
    _ascending(low, high)
    if not low <= mode <= high:
        raise ScenarioError(f"mode = {mode!r}: expected {low:g}..{high:g}")
    return _frozen(stats.triang((mode - low) / (high - low), low, high - low), low, high)


def integers(low: int, high: int) -> Distribution:
    """Each from low to high with equal probability, both included."""
    for name, value in (("low", low), ("high", high)):
        if not isinstance(value, int):
            raise ScenarioError(f"{name} = {value!r}: expected a whole number")
    _ascending(low, high + 1)
    return Distribution(lambda u: low + math.floor(u * (high - low + 1)), (low, high))


def choice(values: list[Any], weights: list[float] | None = None) -> Distribution:
    """One of the values, with probabilities in proportion to the weights; equal ones by default."""
    if not isinstance(values, list) or not values:
        raise ScenarioError(f"values = {values!r}: expected a list of values")
    shares = [1.0] * len(values) if weights is None else weights
    numbers = isinstance(shares, list) and all(_is_number(share) and share >= 0.0 for share in shares)
    if not numbers or len(shares) != len(values) or not sum(shares) > 0.0:
        raise ScenarioError(f"weights = {weights!r}: expected {len(values)} numbers that are not all 0")
    ends = list(accumulate(shares))
    middles = tuple((end - 0.5 * share) / ends[-1] for end, share in zip(ends, shares, strict=True) if share)
    return Distribution(lambda u: values[bisect_right(ends[:-1], u * ends[-1])], probes=middles)


_FROM_THE_FMU = "seed"  # its range is that of the variable
_UNBOUNDED = ("normal", "lognormal")
FUNCTIONS: dict[str, Callable[..., Distribution]] = {
    each.__name__: each for each in (normal, lognormal, uniform, loguniform, triangular, integers, choice)
}


def distribution(declared: Mapping[str, Any], permitted: tuple[float, float], truncate: bool) -> Distribution:
    """What a table with the key `distribution` declares.

    permitted: the range of the variable; truncate: whether to draw within it
    Raises ScenarioError without saying where: who calls knows.
    """
    arguments = dict(declared)
    name = arguments.pop("distribution")
    if name == _FROM_THE_FMU:
        name, arguments = "integers", arguments | _whole(permitted)
    if not isinstance(name, str) or name not in FUNCTIONS:
        raise ScenarioError(
            f"unknown distribution {name!r}; {nearest(str(name), [*FUNCTIONS, _FROM_THE_FMU])}"
        )
    for key, value in arguments.items():
        if name != "choice" and not _is_number(value):
            raise ScenarioError(f"{key} = {value!r}: expected a finite number")
    if truncate:
        arguments |= _narrowed(name, arguments, permitted)
    try:
        return FUNCTIONS[name](**arguments)
    except TypeError as error:
        raise ScenarioError(str(error)) from error


def _whole(permitted: tuple[float, float]) -> dict[str, int]:
    if not all(math.isfinite(limit) for limit in permitted):
        raise ScenarioError(
            "a seed is drawn from the variable's range: expected an FMU that gives min and max"
        )
    return {"low": math.ceil(permitted[0]), "high": math.floor(permitted[1])}


def _narrowed(name: str, arguments: Mapping[str, float], permitted: tuple[float, float]) -> dict[str, float]:
    if name not in _UNBOUNDED:
        raise ScenarioError(f"truncate: expected {' or '.join(_UNBOUNDED)}; {name} has its own limits")
    low, high = arguments.get("low", -math.inf), arguments.get("high", math.inf)
    return {"low": max(low, permitted[0]), "high": min(high, permitted[1])}


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)


def _positive(name: str, value: float) -> None:
    if not value > 0.0:
        raise ScenarioError(f"{name} = {value!r}: expected more than 0")


def _ascending(low: float, high: float) -> None:
    if not low < high:
        raise ScenarioError(f"low = {low!r}, high = {high!r}: expected low below high")
