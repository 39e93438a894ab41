"""Reference trajectories and other signals: functions of time that drive an input."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from orchestration.errors import ScenarioError
from orchestration.system.time_grid import GRID_TOLERANCE


class Signal(Protocol):
    """A function of time [s]: the value of an input."""

    def __call__(self, t: float, /) -> float: ...


class Curve:
    """A signal that is given for many times at once: `at` maps ascending times, (n,), to values, (n,)."""

    def at(self, times: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def __call__(self, t: float) -> float:
        return float(self.at(np.array([t]))[0])


def values_at(signal: Signal, times: np.ndarray) -> np.ndarray:
    """The signal at each time, shape (n,)."""
    if isinstance(signal, Curve):
        return signal.at(times)
    return np.array([signal(t) for t in times.tolist()], float)


@dataclass(frozen=True)
class Ramps(Curve):
    """Lines through (time, value), held before the first and after the last point.

    smooth: quintic ramps instead, with zero speed and acceleration at both ends of each.
    """

    points: Sequence[Sequence[float]]
    smooth: bool = False

    def __post_init__(self) -> None:
        points: Any = self.points
        if not isinstance(points, (list, tuple)) or not points or not all(map(_is_pair, points)):
            raise ScenarioError(f"ramps: expected points as [time, value], got {points!r}")
        points = tuple((_number("ramps: time", t), _number("ramps: value", value)) for t, value in points)
        if any(later[0] <= earlier[0] for earlier, later in pairwise(points)):
            raise ScenarioError(f"ramps: expected points in ascending time, got {points!r}")
        object.__setattr__(self, "points", points)

    def at(self, times: np.ndarray) -> np.ndarray:
        values = np.full(times.shape, self.points[0][1])
        for (t_0, x_0), (t_1, x_1) in pairwise(self.points):
            inside = slice(*np.searchsorted(times, (t_0, t_1), side="right"))
            s = (times[inside] - t_0) / (t_1 - t_0)
            values[inside] = x_0 + (x_1 - x_0) * (_quintic(s) if self.smooth else s)
        end, last = self.points[-1]
        values[np.searchsorted(times, end, side="right") :] = last
        return values


@dataclass(frozen=True)
class Cosine(Curve):
    """offset + amplitude cos(angular_frequency t + phase), rad/s and rad."""

    amplitude: float
    angular_frequency: float
    phase: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        _convert_to_floats(self)

    def at(self, times: np.ndarray) -> np.ndarray:
        return self.offset + self.amplitude * np.cos(self.angular_frequency * times + self.phase)


@dataclass(frozen=True)
class Constant(Curve):
    """The same value at every time."""

    value: float

    def __post_init__(self) -> None:
        _convert_to_floats(self)

    def at(self, times: np.ndarray) -> np.ndarray:
        return np.full(times.shape, self.value)


@dataclass(frozen=True, eq=False)
class Table(Curve):
    """`values` at `times` [s], shapes (n,), held before the first and after the last.

    Between two times a straight line, or with hold = True the earlier value.
    """

    times: npt.ArrayLike = ()
    values: npt.ArrayLike = ()
    hold: bool = False

    def __post_init__(self) -> None:
        times, values = np.array(self.times, float), np.array(self.values, float)
        if times.ndim != 1 or times.shape != values.shape or not len(times):
            shapes = f"got shapes {times.shape} and {values.shape}"
            raise ScenarioError(f"table: expected times and as many values, {shapes}")
        if not (np.isfinite(times).all() and np.isfinite(values).all()):
            raise ScenarioError("table: expected finite numbers")
        if (np.diff(times) <= 0.0).any():
            raise ScenarioError("table: expected ascending times")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)

    def at(self, times: np.ndarray) -> np.ndarray:
        known, values = np.asarray(self.times), np.asarray(self.values)
        if not self.hold:
            return np.interp(times, known, values)
        near = GRID_TOLERANCE * np.diff(known).min(initial=np.inf) if len(known) > 1 else 0.0
        return values[np.maximum(np.searchsorted(known, times + near, side="right") - 1, 0)]


def _convert_to_floats(signal: Constant | Cosine) -> None:
    """Of all members: NumPy's numbers in an array can change, and their text has 8 digits."""
    for name, value in vars(signal).items():
        object.__setattr__(signal, name, _number(f"{type(signal).__name__.lower()}: {name}", value))


def _number(name: str, value: Any) -> float:
    """The value; ScenarioError for what is no number."""
    with suppress(TypeError, ValueError, OverflowError):
        if not isinstance(value, str) and np.ndim(value) == 0:
            return float(value)
    raise ScenarioError(f"{name} = {value!r}: expected a number")


def _is_pair(point: Any) -> bool:
    is_pair = isinstance(point, (list, tuple)) and len(point) == 2
    return is_pair and not any(isinstance(x, (bool, list, tuple)) for x in point)


def _quintic(s: np.ndarray) -> np.ndarray:
    """10 s^3 - 15 s^4 + 6 s^5: 0 to 1 with zero first and second derivatives at both ends."""
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))
