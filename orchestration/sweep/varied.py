"""One entry of `[sweep.vary]`: a distribution to draw from, or a grid of values."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.sweep.distributions import distribution
from orchestration.sweep.target import Target

_KINDS = ("distribution", "values", "linspace")
_SCALE, _TRUNCATE = "relative", "truncate"


@dataclass(frozen=True)
class Varied:
    """What differs from sample to sample: `draw` makes it of a number in [0, 1), or `grid` lists it."""

    target: Target
    grid: tuple[Any, ...] = ()
    draw: Callable[[float], Any] | None = None


def varied(target: Target, declared: Any, what: str) -> Varied:
    """What an entry declares, checked against the range and type of its target."""
    if not isinstance(declared, dict):
        raise ScenarioError(f"{what}: expected a table, got {declared!r}")
    kind = next((kind for kind in _KINDS if kind in declared), "")  # a choice has values too: it comes first
    if not kind:
        near = nearest(next(iter(declared), ""), _KINDS)
        raise ScenarioError(f"{what}: expected one of {', '.join(_KINDS)}, got {sorted(declared)}; {near}")
    try:
        scale = _scale(target, declared)
        if kind == "distribution":
            return _drawn(target, declared, scale)
        return Varied(target, grid=tuple(target.checked(v) for v in _grid(declared, kind, scale)))
    except OrchestrationError as error:
        raise ScenarioError(f"{what}: {error}") from error


def _scale(target: Target, declared: Mapping[str, Any]) -> float | None:
    """What values are multiplied with: the target's own value if they are relative to it."""
    if not _switch(declared, _SCALE):
        return None
    if target.type != "Real" or target.own == 0.0:
        raise ScenarioError(f"relative: expected a Real that is not 0, got {target.type} {target.own!r}")
    return float(target.own)


def _grid(declared: Mapping[str, Any], kind: str, scale: float | None) -> list[Any]:
    unknown = set(declared) - {kind, _SCALE}
    if unknown:
        raise ScenarioError(f"unknown key {sorted(unknown)[0]!r} beside {kind}; expected {_SCALE} or nothing")
    values = declared[kind]
    if kind == "linspace":
        values = _linspace(values)
    if not isinstance(values, list) or not values:
        raise ScenarioError(f"values = {values!r}: expected a list of values")
    if scale is None:
        return values
    if not all(isinstance(value, (int, float)) for value in values):
        raise ScenarioError(f"values = {values!r}: expected numbers, factors of the variable's own value")
    return [scale * value for value in values]


def _linspace(declared: Any) -> list[float]:
    fits = (
        isinstance(declared, list) and len(declared) == 3 and isinstance(declared[2], int) and declared[2] > 1
    )
    if not fits or not all(isinstance(each, (int, float)) and math.isfinite(each) for each in declared):
        raise ScenarioError(f"linspace = {declared!r}: expected [first, last, how many], 2 or more")
    return np.linspace(*declared).tolist()


def _drawn(target: Target, declared: Mapping[str, Any], scale: float | None) -> Varied:
    factor = 1.0 if scale is None else scale
    low, high = sorted(limit / factor for limit in target.permitted)
    arguments = {key: value for key, value in declared.items() if key not in (_SCALE, _TRUNCATE)}
    found = distribution(arguments, (low, high), _switch(declared, _TRUNCATE))
    if found.reach[0] < low or found.reach[1] > high:
        raise ScenarioError(
            f"it reaches {found.reach[0]:g}..{found.reach[1]:g}, permitted is {low:g}..{high:g}: "
            "expected low and high within that, or truncate = true"
        )

    def draw(u: float) -> Any:
        value = found.quantile(u)
        return target.checked(value if scale is None else target.within(scale * value))

    for u in found.probes:
        draw(u)
    return Varied(target, draw=draw)


def _switch(declared: Mapping[str, Any], key: str) -> bool:
    value = declared.get(key, False)
    if not isinstance(value, bool):
        raise ScenarioError(f"{key} = {value!r}: expected true or false")
    return value
