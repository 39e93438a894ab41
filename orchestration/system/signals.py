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
    """A signal: a function of time [s] that gives the value of an input."""

    def __call__(self, t: float, /) -> float: ...


class ArraySignal:
    """A signal that is given for many times at once: `at` maps ascending times, (n,), to values, (n,)."""

    def at(self, times: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def __call__(self, t: float) -> float:
        return float(self.at(np.array([t]))[0])


def values_at(signal: Signal, times: np.ndarray) -> np.ndarray:
    """Returns the signal at each time, shape (n,)."""
    if isinstance(signal, ArraySignal):
        return signal.at(times)
    return np.array([signal(t) for t in times.tolist()], float)


@dataclass(frozen=True)
class Ramps(ArraySignal):
    """Ramps: lines through (time, value), held before the first and after the last point.

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

    def derivative(self, order: int) -> Signal:
        """Returns the derivative of order 1 or 2."""
        if self.smooth:
            return _RampRates(self.points, order)
        times, values = zip(*self.points, strict=True)
        return Table(times, values).derivative(order)


@dataclass(frozen=True)
class _RampRates(ArraySignal):
    """The derivative of quintic ramps through (time, value), 0 before the first and after the last point."""

    points: Sequence[Sequence[float]]
    order: int

    def at(self, times: np.ndarray) -> np.ndarray:
        values = np.zeros(times.shape)
        for (t_0, x_0), (t_1, x_1) in pairwise(self.points):
            inside = slice(*np.searchsorted(times, (t_0, t_1)))
            s = (times[inside] - t_0) / (t_1 - t_0)
            values[inside] = (x_1 - x_0) / (t_1 - t_0) ** self.order * _quintic_rate(s, self.order)
        return values


@dataclass(frozen=True)
class Cosine(ArraySignal):
    """A cosine: offset + amplitude cos(angular_frequency t + phase), rad/s and rad."""

    amplitude: float
    angular_frequency: float
    phase: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        _convert_to_floats(self)

    def at(self, times: np.ndarray) -> np.ndarray:
        return self.offset + self.amplitude * np.cos(self.angular_frequency * times + self.phase)

    def derivative(self, order: int) -> "Cosine":
        """Returns the derivative of an order."""
        omega = self.angular_frequency
        return Cosine(self.amplitude * omega**order, omega, self.phase + 0.5 * np.pi * order)


@dataclass(frozen=True)
class Later(ArraySignal):
    """A signal that comes some seconds later: `signal` at t - delay."""

    signal: Signal
    delay: float

    def at(self, times: np.ndarray) -> np.ndarray:
        return values_at(self.signal, times - self.delay)


@dataclass(frozen=True)
class Constant(ArraySignal):
    """A constant: one value at every time."""

    value: float

    def __post_init__(self) -> None:
        _convert_to_floats(self)

    def at(self, times: np.ndarray) -> np.ndarray:
        return np.full(times.shape, self.value)

    def derivative(self, order: int) -> "Constant":
        """Returns 0."""
        return Constant(0.0)


@dataclass(frozen=True, eq=False)
class Table(ArraySignal):
    """A table: `values` at `times` [s], shapes (n,), held before the first and after the last.

    Between two times a straight line, or with hold = True the earlier value. Two rows of one time are a jump:
    from that time on the last row's value holds.
    """

    times: npt.ArrayLike = ()
    values: npt.ArrayLike = ()
    hold: bool = False

    def __post_init__(self) -> None:
        try:
            times, values = np.array(self.times, float), np.array(self.values, float)
        except (TypeError, ValueError) as error:
            raise ScenarioError(f"table: expected numbers: {error}") from error
        if times.ndim != 1 or times.shape != values.shape or not len(times):
            shapes = f"got shapes {times.shape} and {values.shape}"
            raise ScenarioError(f"table: expected times and as many values, {shapes}")
        if not (np.isfinite(times).all() and np.isfinite(values).all()):
            raise ScenarioError("table: expected finite numbers")
        if (np.diff(times) < 0.0).any():
            raise ScenarioError("table: expected ascending times")
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "values", values)

    @property
    def jumps(self) -> np.ndarray:
        """Times [s] of jumps of the value."""
        known = np.asarray(self.times)
        return known if self.hold else known[1:][np.diff(known) == 0.0]

    def at(self, times: np.ndarray) -> np.ndarray:
        known, values = np.asarray(self.times), np.asarray(self.values)
        gaps = np.diff(known)
        # a communication point is rounded, and must not miss the jump that it is meant to be at
        near = GRID_TOLERANCE * np.min(gaps, where=gaps > 0.0, initial=np.ptp(known))
        near = max(near, 4.0 * np.spacing(np.abs(known).max()))
        count = np.searchsorted(known, times + near, side="right")
        if self.hold:
            return values[np.maximum(count - 1, 0)]
        return np.interp(np.maximum(times, np.append(-np.inf, known)[count]), known, values)

    def derivative(self, order: int) -> Signal:
        """Returns the derivative of order 1 or 2; a jump has none, and 0 stands for it."""
        times, values = np.asarray(self.times), np.asarray(self.values)
        is_line = np.diff(times) > 0.0
        if self.hold or order == 2 or not is_line.any():
            return Constant(0.0)
        slopes = [0.0, *(np.diff(values)[is_line] / np.diff(times)[is_line]), 0.0]
        return Table([times[0] - 1.0, *times[:-1][is_line], times[-1]], slopes, hold=True)


def _convert_to_floats(signal: Constant | Cosine) -> None:
    """Converts all members to floats."""
    # NumPy's numbers in an array can change, and the text of some has 8 digits
    for name, value in vars(signal).items():
        object.__setattr__(signal, name, _number(f"{type(signal).__name__.lower()}: {name}", value))


def _number(name: str, value: Any) -> float:
    """Returns the value; ScenarioError for what is no number."""
    with suppress(TypeError, ValueError, OverflowError):
        if not isinstance(value, str) and np.ndim(value) == 0:
            return float(value)
    raise ScenarioError(f"{name} = {value!r}: expected a number")


def _is_pair(point: Any) -> bool:
    is_pair = isinstance(point, (list, tuple)) and len(point) == 2
    return is_pair and not any(isinstance(x, (bool, list, tuple)) for x in point)


def _quintic(s: np.ndarray) -> np.ndarray:
    """Returns 10 s^3 - 15 s^4 + 6 s^5: 0 to 1 with zero first and second derivatives at both ends."""
    return s * s * s * (10.0 + s * (6.0 * s - 15.0))


def _quintic_rate(s: np.ndarray, order: int) -> np.ndarray:
    """Returns the derivative by s of 10 s^3 - 15 s^4 + 6 s^5."""
    return 30.0 * (s * (1.0 - s)) ** 2 if order == 1 else 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s)


# Of the peak frequency: JONSWAP has 0.4 % of its variance above the highest.
_LOWEST, _HIGHEST = 0.5, 4.0
_MOST_COMPONENTS = 10_000


@dataclass(frozen=True, eq=False)
class Sines(ArraySignal):
    """Sines: offset + sum of amplitudes_i sin(angular_frequencies_i t + phases_i).

    amplitudes, offset: in the unit of the input; angular_frequencies [rad/s]; phases [rad]; shapes (n,)
    """

    amplitudes: npt.ArrayLike
    angular_frequencies: npt.ArrayLike
    phases: npt.ArrayLike
    offset: float = 0.0

    def __post_init__(self) -> None:
        names = ("amplitudes", "angular_frequencies", "phases")
        arrays = [np.array(getattr(self, name), float) for name in names]
        shapes = {array.shape for array in arrays}
        if len(shapes) > 1 or arrays[0].ndim != 1 or not arrays[0].size:
            got = ", ".join(f"{array.size} {name}" for name, array in zip(names, arrays, strict=True))
            raise ScenarioError(f"sines: expected one of each or more, and as many of each, got {got}")
        if not all(np.isfinite(array).all() for array in (*arrays, np.array(self.offset))):
            raise ScenarioError("sines: expected finite numbers")
        for name, array in zip(names, arrays, strict=True):
            object.__setattr__(self, name, array)

    def at(self, times: np.ndarray) -> np.ndarray:
        """Sums in the order of the components: the value at a time does not depend on the other times."""
        values = np.full(times.shape, float(self.offset))
        arrays = (self.amplitudes, self.angular_frequencies, self.phases)
        for amplitude, omega, phase in zip(*map(np.asarray, arrays), strict=True):
            values += amplitude * np.sin(omega * times + phase)
        return values

    def derivative(self, order: int) -> "Sines":
        """Returns the derivative of an order."""
        omega, phases = np.asarray(self.angular_frequencies), np.asarray(self.phases)
        return Sines(np.asarray(self.amplitudes) * omega**order, omega, phases + 0.5 * np.pi * order)


def sine(amplitude: float, frequency: float, phase: float = 0.0, offset: float = 0.0) -> Sines:
    """Returns offset + amplitude sin(2 pi frequency t + phase), Hz and rad."""
    return Sines([amplitude], [2.0 * np.pi * frequency], [phase], offset)


def sum_of_sines(
    amplitudes: npt.ArrayLike, frequencies: npt.ArrayLike, phases: npt.ArrayLike = (), offset: float = 0.0
) -> Sines:
    """Returns offset + sum of amplitudes_i sin(2 pi frequencies_i t + phases_i), Hz and rad; no phases: 0."""
    given = np.array(phases, float)
    chosen = given if given.size else np.zeros(np.shape(amplitudes))
    return Sines(amplitudes, 2.0 * np.pi * np.array(frequencies, float), chosen, offset)


def spectrum(
    standard_deviation: float,
    peak_period: float,
    gamma: float = 3.3,
    components: int = 100,
    seed: int = 1,
    offset: float = 0.0,
) -> Sines:
    """Returns a sum of sines with the JONSWAP spectrum and random phases, about `offset`.

    standard_deviation: of the signal over a long time, in the unit of the input; a quarter of its
        significant height
    peak_period: of the peak of the spectrum [s]
    gamma: factor of the peak over Pierson and Moskowitz's, 1 or more
    components: number of sines, each with a random frequency in one of as many equal bands from half the
        peak frequency to four times the peak frequency, so that the signal has no period
    seed: of the phases and of the frequencies within their bands

    The amplitudes follow from the spectrum at the frequencies: every seed gives the same variance.
    """
    _check_spectrum(standard_deviation, peak_period, gamma, components, seed)
    random = np.random.default_rng(seed).random((2, components))
    band = (_HIGHEST - _LOWEST) / components
    ratio = _LOWEST + band * (np.arange(components) + random[0])
    density = jonswap(ratio, gamma)
    amplitudes = standard_deviation * np.sqrt(2.0 * density / density.sum())
    return Sines(amplitudes, 2.0 * np.pi / peak_period * ratio, 2.0 * np.pi * random[1], offset)


def jonswap(ratio: np.ndarray, gamma: float) -> np.ndarray:
    """Returns the JONSWAP spectrum, without its scale, at frequencies relative to the peak's.

        S ~ x^-5 exp(-5/4 x^-4) gamma^exp(-(x - 1)^2 / (2 s^2)),   s = 0.07 for x <= 1, 0.09 above

    Source: Hasselmann et al., Measurements of wind-wave growth and swell decay during the Joint North Sea
    Wave Project (JONSWAP), 1973.
    """
    width = np.where(ratio <= 1.0, 0.07, 0.09)
    peak = np.exp(-((ratio - 1.0) ** 2) / (2.0 * width**2))
    return ratio**-5.0 * np.exp(-1.25 * ratio**-4.0) * gamma**peak


def _check_spectrum(
    standard_deviation: float, peak_period: float, gamma: float, components: int, seed: int
) -> None:
    checks = {
        f"standard_deviation = {standard_deviation!r}: expected 0 or more": standard_deviation >= 0.0,
        f"peak_period = {peak_period!r} s: expected more than 0": peak_period > 0.0,
        f"gamma = {gamma!r}: expected 1 or more": gamma >= 1.0,
        f"components = {components!r}: expected 1 to {_MOST_COMPONENTS}": 1 <= components <= _MOST_COMPONENTS,
        f"seed = {seed!r}: expected 0 or more": seed >= 0,
    }
    for problem, is_kept in checks.items():
        if not is_kept:
            raise ScenarioError(f"spectrum: {problem}")
