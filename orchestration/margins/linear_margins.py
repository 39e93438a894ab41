"""Delay and gain margins of a linear loop, from its frequency response (Nyquist).

With L(s) from the cut to the cut, so that the loop is closed where L = 1, a delay d gives 1 = L e^(-s d), a
factor g gives 1 = g L. A loop that is stable as it is loses its stability at the smallest d, and at the g
nearest to 1, for which the equation has a solution s = j w. Source: Astrom and Murray (2008), section 9.3.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import brentq

from orchestration.margins.equations import LinearLoop

_LOWEST, _HIGHEST, _PER_DECADE = 1e-5, 1e5, 400  # rad/s


@dataclass(frozen=True)
class LinearMargins:
    """Margins of a loop; not a number if the loop is not stable as it is, infinite if nothing is lost.

    delay [s] and the frequency [rad/s] at which it is lost; the factors, below and above 1, at which a gain
    that is too low or too high loses the stability (0 and infinity if none does)
    """

    delay: float
    frequency: float
    low_gain: float
    high_gain: float


_UNSTABLE = LinearMargins(math.nan, math.nan, math.nan, math.nan)


def margins(loop: LinearLoop) -> LinearMargins:
    """The margins of a loop."""
    if loop.poles().real.max() >= 0.0:
        return _UNSTABLE
    grid = _frequencies(loop)
    response = loop.response(grid)
    delays = [(_delay_at(loop, w), w) for w in _roots(loop, grid, np.log(np.abs(response)), _log_modulus)]
    gains = [1.0 / loop.response(np.array(w)).real for w in _roots(loop, grid, response.imag, _imaginary)]
    delay, frequency = min(delays, default=(math.inf, math.nan))
    return LinearMargins(
        delay=delay,
        frequency=frequency,
        low_gain=float(max((g for g in gains if 0.0 < g < 1.0), default=0.0)),
        high_gain=float(min((g for g in gains if g > 1.0), default=math.inf)),
    )


def _frequencies(loop: LinearLoop) -> np.ndarray:
    """A grid [rad/s] that is fine where poles, of the open or the closed loop, make the response change."""
    count = round(math.log10(_HIGHEST / _LOWEST) * _PER_DECADE) + 1
    grid = [np.geomspace(_LOWEST, _HIGHEST, count)]
    for pole in (*loop.poles(), *loop.poles(closed=False)):
        near = abs(pole.real) * np.geomspace(1e-2, 1e2, _PER_DECADE)
        grid += [abs(pole.imag) - near, abs(pole.imag) + near]
    frequencies = np.unique(np.concatenate(grid))
    return frequencies[frequencies >= _LOWEST]


def _log_modulus(loop: LinearLoop, w: float) -> float:
    return float(np.log(np.abs(loop.response(np.array(w)))))


def _imaginary(loop: LinearLoop, w: float) -> float:
    return float(loop.response(np.array(w)).imag)


def _roots(loop: LinearLoop, grid: np.ndarray, values: np.ndarray, function: Any) -> list[float]:
    """Frequencies at which the function of the loop is 0, between neighbours on the grid of unlike signs."""
    changes = np.flatnonzero(np.sign(values[1:]) != np.sign(values[:-1]))
    return [float(brentq(lambda w: function(loop, w), grid[i], grid[i + 1])) for i in changes]  # type: ignore[arg-type]


def _delay_at(loop: LinearLoop, w: float) -> float:
    """The smallest delay [s] with L(j w) e^(-j w delay) = 1, where |L| = 1."""
    return float(np.angle(loop.response(np.array(w))) % (2.0 * math.pi) / w)
