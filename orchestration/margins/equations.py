"""Linear equations between named signals, their frequency response and their poles.

An equation is `sum of derivatives[name] name' = sum of values[name] name`, algebraic without derivatives.
Written so, a loop reads like the laws it is made of, and a limit, such as a time constant of 0 or an
adaptation gain without bound, is a coefficient of 0 and no other model.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

_INFINITE = 1e6  # 1/s; a pole beyond it belongs to an algebraic equation
_SHIFT = 0.7320508  # 1/s; any number that is no pole


@dataclass(frozen=True)
class Equation:
    """Coefficients of the derivatives on the left and of the values on the right, by signal."""

    derivatives: Mapping[str, float]
    values: Mapping[str, float]


@dataclass(frozen=True)
class LinearLoop:
    """As many equations as signals, without `source`, which drives them; `target` closes the loop.

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

    def response(self, frequencies: np.ndarray) -> Any:
        """target / source at these frequencies [rad/s], a complex array of the same shape."""
        e, a, b = self.matrices
        s = 1j * np.asarray(frequencies, float)[..., np.newaxis, np.newaxis]
        states = np.linalg.solve(s * e - a, b[:, np.newaxis])
        return states[..., self.signals.index(self.target), 0]

    def poles(self, closed: bool = True) -> Any:
        """Of the closed loop, or of the loop that is cut [1/s], a complex array."""
        e, a, b = self.matrices
        a = a.copy()
        a[:, self.signals.index(self.target)] += b if closed else 0.0
        # 1 / (pole - shift); of an algebraic equation 0, but for rounding
        inverses = np.linalg.eigvals(np.linalg.solve(a - _SHIFT * e, e))
        return _SHIFT + 1.0 / inverses[np.abs(inverses) > 1.0 / _INFINITE]
