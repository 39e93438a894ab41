"""Linear loops of named signals: frequency response, poles, delay and gain margins (Nyquist).

With L(s) from the cut to the cut, so that the loop is closed where L = 1, a delay d gives 1 = L e^(-s d), a
factor g gives 1 = g L. A loop that is stable as it is loses its stability at the smallest d, and at the g
nearest to 1, for which the equation has a solution s = j w. Source: Astrom and Murray (2008), section 9.3.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from fmus.extras import imports_of

with imports_of("study", "a margin"):
    from scipy.optimize import brentq

# 1/s; a pole beyond it belongs to an algebraic equation
_INFINITE = 1e6
# 1/s; any number works that is not a pole
_SHIFT = 0.7320508


@dataclass(frozen=True)
class Equation:
    """An equation: coefficients of the derivatives on the left and of the values on the right, by signal.

        sum of derivatives[name] name' = sum of values[name] name,   algebraic without derivatives

    Written so, a loop reads like the laws it is made of, and a limit, such as a time constant of 0 or an
    adaptation gain without bound, is a coefficient of 0 and no other model.
    """

    derivatives: Mapping[str, float]
    values: Mapping[str, float]


@dataclass(frozen=True)
class LinearLoop:
    """A linear loop: as many equations as signals, without `source`, which drives them.

    The loop is closed where source = target.
    """

    equations: tuple[Equation, ...]
    source: str
    target: str

    @cached_property
    def signals(self) -> list[str]:
        """The signals that the equations determine; ValueError for more, or fewer, than equations."""
        named = dict.fromkeys(name for row in self.equations for name in (*row.derivatives, *row.values))
        signals = [name for name in named if name != self.source]
        if len(signals) != len(self.equations):
            raise ValueError(f"{len(self.equations)} equations: expected one for each of {signals}")
        return signals

    @cached_property
    def matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """E, A and b of E x' = A x + b source, where x are the signals."""
        index = {name: i for i, name in enumerate([*self.signals, self.source])}
        e, a = np.zeros((2, len(self.signals), len(index)))
        for row, equation in enumerate(self.equations):
            for matrix, terms in ((e, equation.derivatives), (a, equation.values)):
                for name, coefficient in terms.items():
                    matrix[row, index[name]] = coefficient
        return e[:, :-1], a[:, :-1], a[:, -1]

    def response(self, frequencies: npt.ArrayLike) -> Any:
        """Returns target / source at these frequencies [rad/s], a complex array of the same shape."""
        e, a, b = self.matrices
        s = 1j * np.asarray(frequencies, float)[..., np.newaxis, np.newaxis]
        states = np.linalg.solve(s * e - a, b[:, np.newaxis])
        return states[..., self.signals.index(self.target), 0]

    def poles(self, closed: bool = True) -> Any:
        """Returns the poles of the closed loop, or of the loop that is cut [1/s], a complex array."""
        e, a, b = self.matrices
        a = a.copy()
        a[:, self.signals.index(self.target)] += b if closed else 0.0
        # 1 / (pole - shift); of an algebraic equation 0, but for rounding
        inverses = np.linalg.eigvals(np.linalg.solve(a - _SHIFT * e, e))
        return _SHIFT + 1.0 / inverses[np.abs(inverses) > 1.0 / _INFINITE]


_LOWEST, _HIGHEST, _PER_DECADE = 1e-5, 1e5, 400  # rad/s
_NEAR = {0.0: (1e-7, 1e-9), math.inf: (1e6, 1e8)}  # rad/s; a response with a limit has it at both


@dataclass(frozen=True)
class LinearMargins:
    """Margins of a loop; not a number if the loop is not stable as it is, infinite if nothing is lost.

    delay [s] and the frequency [rad/s] of its loss; the factors, below and above 1, with which a gain
    that is too low or too high loses the stability (0 and infinity if none does)
    """

    delay: float
    frequency: float
    low_gain: float
    high_gain: float
    low_frequency: float = math.nan
    high_frequency: float = math.nan

    @property
    def phase(self) -> float:
        """The phase margin [rad] at the frequency where the smallest delay loses the stability."""
        return self.delay * self.frequency


_UNSTABLE = LinearMargins(math.nan, math.nan, math.nan, math.nan)


def margins(loop: LinearLoop) -> LinearMargins:
    """Returns the margins of a loop."""
    if loop.poles().real.max() >= 0.0:
        return _UNSTABLE
    grid = _frequencies(loop)
    response = loop.response(grid)
    unit = _roots(loop, grid, np.log(np.abs(response)), lambda values: np.log(np.abs(values)))
    # the smallest delay with L(j w) e^(-j w delay) = 1, where |L| = 1
    delays = [(float(np.angle(loop.response(w)) % (2.0 * math.pi) / w), w) for w in unit]
    real = [0.0, *_roots(loop, grid, response.imag, np.imag), math.inf]
    gains = [(1.0 / value, w) for w in real if (value := _real_response(loop, w))]
    if abs(_real_response(loop, math.inf)) >= 1.0:
        # each echo of the delayed value is at least as large as the one before
        delays.append((0.0, math.inf))
    delay, frequency = min(delays, default=(math.inf, math.nan))
    low_gain, low_frequency = max((g for g in gains if 0.0 < g[0] < 1.0), default=(0.0, math.nan))
    high_gain, high_frequency = min((g for g in gains if g[0] > 1.0), default=(math.inf, math.nan))
    return LinearMargins(delay, frequency, low_gain, high_gain, low_frequency, high_frequency)


def _real_response(loop: LinearLoop, frequency: float) -> float:
    """Returns the response at a frequency where it is real; at 0 and infinity its limit, 0 without one."""
    if frequency not in _NEAR:
        return float(loop.response(frequency).real)
    before, value = loop.response(_NEAR[frequency])
    return float(value.real) if abs(value - before) < 1e-3 * abs(value) else 0.0


def _frequencies(loop: LinearLoop) -> np.ndarray:
    """Returns a grid [rad/s] that is fine where poles of the open or the closed loop change the response."""
    count = round(math.log10(_HIGHEST / _LOWEST) * _PER_DECADE) + 1
    grid = [np.geomspace(_LOWEST, _HIGHEST, count)]
    for pole in (*loop.poles(), *loop.poles(closed=False)):
        # of a pole on the axis only the neighbourhood has a response
        near = max(abs(pole.real), 1e-6 * abs(pole)) * np.geomspace(1e-2, 1e2, _PER_DECADE)
        grid += [abs(pole.imag) - near, abs(pole.imag) + near]
    frequencies = np.unique(np.concatenate(grid))
    return frequencies[frequencies >= _LOWEST]


def _roots(loop: LinearLoop, grid: np.ndarray, values: np.ndarray, function: Any) -> list[float]:
    """Returns the frequencies where a function of the response is 0: between values of unlike signs."""
    changes = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
    roots: list[Any] = [brentq(lambda w: function(loop.response(w)), grid[i], grid[i + 1]) for i in changes]
    return [float(root) for root in roots]
