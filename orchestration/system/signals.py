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
        """Returns the signal at many times.

        Parameters
        ----------
        times : array, shape (n,)
            Ascending times [s].

        Returns
        -------
        array, shape (n,)
            Values in the unit of the input.
        """
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

    Parameters
    ----------
    points : sequence of pairs
        (time [s], value in the unit of the input), in ascending time.
    smooth : bool
        Whether ramps are quintic, with zero speed and acceleration at both ends of each, and not straight.

    Raises
    ------
    ScenarioError
        For points that are no pairs of numbers, or whose times do not ascend.

    Examples
    --------
    >>> Ramps([(0.0, 0.0), (10.0, 2.0)])(5.0)
    1.0
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
        """Returns the derivative by time.

        Parameters
        ----------
        order : {1, 2}
            Order of the derivative.

        Returns
        -------
        Signal
            Values in the unit of the input per s or per s2.
        """
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
    """A cosine: offset + amplitude cos(angular_frequency t + phase).

    Parameters
    ----------
    amplitude : float
        In the unit of the input.
    angular_frequency : float
        In rad/s.
    phase : float
        Angle at t = 0 s [rad].
    offset : float
        Mean, in the unit of the input.

    Raises
    ------
    ScenarioError
        For a value that is no number.

    Examples
    --------
    >>> Cosine(2.0, 0.5, offset=1.0)(0.0)
    3.0
    """

    amplitude: float
    angular_frequency: float
    phase: float = 0.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        _convert_to_floats(self)

    def at(self, times: np.ndarray) -> np.ndarray:
        return self.offset + self.amplitude * np.cos(self.angular_frequency * times + self.phase)

    def derivative(self, order: int) -> "Cosine":
        """Returns the derivative by time.

        Parameters
        ----------
        order : int
            Order of the derivative, from 1 on.

        Returns
        -------
        Cosine
            Values in the unit of the input per s^order.
        """
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
    """A constant: one value at every time.

    Parameters
    ----------
    value : float
        In the unit of the input.

    Raises
    ------
    ScenarioError
        For a value that is no number.

    Examples
    --------
    >>> Constant(3.0)(10.0)
    3.0
    """

    value: float

    def __post_init__(self) -> None:
        _convert_to_floats(self)

    def at(self, times: np.ndarray) -> np.ndarray:
        return np.full(times.shape, self.value)

    def derivative(self, order: int) -> "Constant":
        """Returns the derivative by time, 0.

        Parameters
        ----------
        order : int
            Order of the derivative, from 1 on.

        Returns
        -------
        Constant
        """
        return Constant(0.0)


@dataclass(frozen=True, eq=False)
class Table(ArraySignal):
    """A table: values at times, held before the first and after the last.

    Between two times a straight line, or with hold = True the earlier value. Two rows of one time are a jump:
    from that time on the last row's value holds.

    Parameters
    ----------
    times : array_like, shape (n,)
        Times [s], ascending.
    values : array_like, shape (n,)
        Values in the unit of the input.
    hold : bool
        Whether a value holds until the next time, in place of a straight line.

    Raises
    ------
    ScenarioError
        For times or values that are not finite numbers, are not as many, or do not ascend.

    Examples
    --------
    >>> Table([0.0, 10.0], [0.0, 2.0])(5.0), Table([0.0, 10.0], [0.0, 2.0], hold=True)(5.0)
    (1.0, 0.0)
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
        """Returns the derivative by time; a jump has none, and 0 stands for it.

        Parameters
        ----------
        order : {1, 2}
            Order of the derivative.

        Returns
        -------
        Signal
            Values in the unit of the input per s or per s2.
        """
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

    Parameters
    ----------
    amplitudes : array_like, shape (n,)
        In the unit of the input.
    angular_frequencies : array_like, shape (n,)
        In rad/s.
    phases : array_like, shape (n,)
        Angles at t = 0 s [rad].
    offset : float
        Mean, in the unit of the input.

    Raises
    ------
    ScenarioError
        For numbers that are not finite, and for other shapes.
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
        """Returns the derivative by time.

        Parameters
        ----------
        order : int
            Order of the derivative, from 1 on.

        Returns
        -------
        Sines
            Values in the unit of the input per s^order.
        """
        omega, phases = np.asarray(self.angular_frequencies), np.asarray(self.phases)
        return Sines(np.asarray(self.amplitudes) * omega**order, omega, phases + 0.5 * np.pi * order)


def sine(amplitude: float, frequency: float, phase: float = 0.0, offset: float = 0.0) -> Sines:
    """Returns offset + amplitude sin(2 pi frequency t + phase).

    Parameters
    ----------
    amplitude : float
        In the unit of the input.
    frequency : float
        In Hz.
    phase : float
        Angle at t = 0 s [rad].
    offset : float
        Mean, in the unit of the input.

    Returns
    -------
    Sines

    Raises
    ------
    ScenarioError
        For a number that is not finite.

    Examples
    --------
    >>> sine(2.0, 0.25)(1.0)
    2.0
    """
    return Sines([amplitude], [2.0 * np.pi * frequency], [phase], offset)


def sum_of_sines(
    amplitudes: npt.ArrayLike, frequencies: npt.ArrayLike, phases: npt.ArrayLike = (), offset: float = 0.0
) -> Sines:
    """Returns offset + sum of amplitudes_i sin(2 pi frequencies_i t + phases_i).

    Parameters
    ----------
    amplitudes : array_like, shape (n,)
        In the unit of the input.
    frequencies : array_like, shape (n,)
        In Hz.
    phases : array_like, shape (n,)
        Angles at t = 0 s [rad]; by default 0.
    offset : float
        Mean, in the unit of the input.

    Returns
    -------
    Sines

    Raises
    ------
    ScenarioError
        For numbers that are not finite, and for other shapes.

    Examples
    --------
    >>> sum_of_sines([2.0, 1.0], [0.25, 0.5], phases=[0.0, 0.0], offset=1.0)(0.0)
    1.0
    """
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
    rayleigh_amplitudes: bool = False,
) -> Sines:
    """Returns a sum of sines with the JONSWAP spectrum and random phases, about `offset`.

    The amplitudes follow from the spectrum at the frequencies: every seed gives the same variance.

    Parameters
    ----------
    standard_deviation : float
        Standard deviation of the signal over a long time, in the unit of the input; a quarter of its
        significant height.
    peak_period : float
        Period of the peak of the spectrum [s].
    gamma : float
        Factor of the peak over Pierson and Moskowitz's, 1 or more.
    components : int
        Number of sines, each with a random frequency in one of as many equal bands from half the peak
        frequency to four times the peak frequency, so that the signal has no period.
    seed : int
        Seed of the phases and of the frequencies within their bands, 0 or more.
    offset : float
        Mean, in the unit of the input.
    rayleigh_amplitudes : bool
        Whether the amplitudes are drawn, with a Rayleigh distribution of the same mean square: the variance
        then scatters from seed to seed (Tucker, Challenor and Carter, Applied Ocean Research 6(2), 1984).

    Returns
    -------
    Sines

    Raises
    ------
    ScenarioError
        For a value out of its range.

    Examples
    --------
    >>> sea = spectrum(standard_deviation=0.25, peak_period=8.0)
    >>> round(float((np.asarray(sea.amplitudes) ** 2).sum() / 2.0), 6)  # the variance
    0.0625
    """
    _check_spectrum(standard_deviation, peak_period, gamma, components, seed)
    random = np.random.default_rng(seed).random((3, components))
    band = (_HIGHEST - _LOWEST) / components
    ratio = _LOWEST + band * (np.arange(components) + random[0])
    density = jonswap(ratio, gamma)
    amplitudes = standard_deviation * np.sqrt(2.0 * density / density.sum())
    if rayleigh_amplitudes:
        # the square of an amplitude with a Rayleigh distribution is exponential
        amplitudes *= np.sqrt(-np.log1p(-random[2]))
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
