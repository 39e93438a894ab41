"""Reference trajectories and other signals: functions of time that drive an input."""

import math
import sys
from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import Any

from fmus.errors import nearest
from orchestration.errors import ScenarioError

Signal = Callable[[float], float]


def ramps(points: list[list[float]], smooth: bool = False) -> Signal:
    """Straight lines through (time, value), held before the first and after the last point.

    smooth: quintic ramps instead, with zero speed and acceleration at both ends of each.
    """
    if not isinstance(points, list) or not points or any(not _is_pair(point) for point in points):
        raise ScenarioError(f"ramps: expected points as [time, value], got {points!r}")
    if any(later[0] <= earlier[0] for earlier, later in pairwise(points)):
        raise ScenarioError(f"ramps: expected points in ascending time, got {points!r}")

    def value(t: float) -> float:
        if t <= points[0][0]:
            return float(points[0][1])
        for (t_0, x_0), (t_1, x_1) in pairwise(points):
            if t <= t_1:
                s = (t - t_0) / (t_1 - t_0)
                return x_0 + (x_1 - x_0) * (_quintic(s) if smooth else s)
        return float(points[-1][1])

    return value


def _is_pair(point: Any) -> bool:
    return isinstance(point, list) and len(point) == 2 and not any(isinstance(x, (bool, list)) for x in point)


def _quintic(s: float) -> float:
    """10 s^3 - 15 s^4 + 6 s^5: 0 to 1 with zero first and second derivatives at both ends."""
    return s**3 * (10.0 + s * (6.0 * s - 15.0))


def cosine(amplitude: float, angular_frequency: float, phase: float = 0.0, offset: float = 0.0) -> Signal:
    """offset + amplitude cos(angular_frequency t + phase), rad/s and rad."""
    return lambda t: offset + amplitude * math.cos(angular_frequency * t + phase)


def constant(value: float) -> Signal:
    return lambda t: value


_KINDS: dict[str, Callable[..., Signal]] = {"ramps": ramps, "cosine": cosine, "constant": constant}


def signal(declaration: Mapping[str, Any], purpose: str) -> Signal:
    """The signal that a scenario declares: its `kind`, and the arguments of that kind."""
    arguments = dict(declaration)
    kind = arguments.pop("kind", None)
    if not isinstance(kind, str) or kind not in _KINDS:
        raise ScenarioError(f"{purpose}: unknown kind {kind!r}; {nearest(str(kind), _KINDS)}")
    for name, value in arguments.items():
        _check_numbers(value, f"{purpose}: {name}")
    try:
        return _KINDS[kind](**arguments)
    except TypeError as error:
        raise ScenarioError(f"{purpose}: {kind}: {error}") from error


def _check_numbers(value: Any, what: str) -> None:
    """Only finite numbers, switches and lists of numbers make up a signal."""
    if isinstance(value, list):
        for element in value:
            _check_numbers(element, what)
    elif not isinstance(value, (int, float)) or not abs(value) <= sys.float_info.max:
        raise ScenarioError(f"{what}: expected finite numbers, got {value!r}")
