"""Parts of a step: integration, and states that change only at sampling instants."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from fmus.numerics.choice import where

__all__ = ["Clock", "rk4_step", "sampled"]

_EARLY = 1e-6  # of a period: t and the clock round differently
_LATE = 0.5  # of a period


@dataclass(frozen=True)
class Clock:
    """Clock of samples, due at start + count * period, without accumulated rounding.

    start: time of the first sample [s]; `Clock(t)` in `initial_state` for one in the first step
    count: samples taken since
    """

    start: float = 0.0
    count: int = 0

    def next_sample(self, period: float) -> float:
        """Returns the time at which the next sample is due [s]."""
        return self.start + self.count * period

    def last_sample(self, period: float) -> float:
        """Returns the time at which the last sample was due [s]."""
        return self.start + (self.count - 1) * period


Part = TypeVar("Part")


def sampled(t: float, period: float, state: Part, new: Part) -> Part:
    """Returns `new` if a sample is due at time t, else `state` as it was.

    t: of the sample [s]: where `step` begins, or `t + h` where it ends
    period: sampling period [s]; it must not change during a run
    state, new: dataclasses of one class with a field `clock: Clock`, which this function sets; it is the
        only one to read that of `state`, and that of `new` does not matter

    A step takes one sample at most, so require `internal_step <= period`. Samples that were missed are not
    made up for: one that is late by more than half a period, in steps longer than that, starts the clock
    again, with the next sample half a period later.
    """
    clock: Clock = state.clock  # type: ignore[attr-defined]
    due = clock.next_sample(period)
    is_late = t > due + _LATE * period
    ticked = where(is_late, Clock(t + _LATE * period, 0), Clock(clock.start, clock.count + 1))
    return where(t >= due - _EARLY * period, replace(new, clock=ticked), state)  # type: ignore[type-var]


def rk4_step(derivative: Callable[[Any, tuple], tuple], t: float, x: tuple, h: float) -> tuple:
    """Returns x after one step of the classical fourth-order Runge-Kutta method.

    `derivative(t, x)` returns dx/dt in the order of `x`; global error O(h^4).
    """
    half = 0.5 * h
    k1 = derivative(t, x)
    k2 = derivative(t + half, tuple(xi + half * ki for xi, ki in zip(x, k1, strict=True)))
    k3 = derivative(t + half, tuple(xi + half * ki for xi, ki in zip(x, k2, strict=True)))
    k4 = derivative(t + h, tuple(xi + h * ki for xi, ki in zip(x, k3, strict=True)))
    return tuple(
        xi + h / 6.0 * (a + 2.0 * b + 2.0 * c + d) for xi, a, b, c, d in zip(x, k1, k2, k3, k4, strict=True)
    )
