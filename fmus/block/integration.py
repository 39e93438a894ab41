"""Integration over a step, during which samples and events are held."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

# times of samples while functions of a block are evaluated between events, else None
DUE: ContextVar[list[float] | None] = ContextVar("DUE", default=None)


@contextmanager
def between_events() -> Iterator[list[float]]:
    """Makes `at_events` and `sampled` hold their state; yields a list that fills with times of samples."""
    due: list[float] = []
    token = DUE.set(due)
    try:
        yield due
    finally:
        DUE.reset(token)


def rk4_step(derivative: Callable[[Any, tuple], tuple], t: float, x: tuple, h: float) -> tuple:
    """Returns x after one step of the classical fourth-order Runge-Kutta method.

    The global error is O(h^4).

    Parameters
    ----------
    derivative : function
        `derivative(t, x)` returns dx/dt, a tuple in the order of `x`.
    t : float
        Time at the beginning of the step [s].
    x : tuple of float
        Continuous states at t.
    h : float
        Step [s].

    Returns
    -------
    tuple of float
        Continuous states at t + h.

    Examples
    --------
    >>> rk4_step(lambda t, x: (2.0 * t,), 0.0, (0.0,), 1.0)
    (1.0,)
    """
    half = 0.5 * h
    k1 = derivative(t, x)
    k2 = derivative(t + half, tuple(xi + half * ki for xi, ki in zip(x, k1, strict=True)))
    k3 = derivative(t + half, tuple(xi + half * ki for xi, ki in zip(x, k2, strict=True)))
    k4 = derivative(t + h, tuple(xi + h * ki for xi, ki in zip(x, k3, strict=True)))
    return tuple(
        xi + h / 6.0 * (a + 2.0 * b + 2.0 * c + d) for xi, a, b, c, d in zip(x, k1, k2, k3, k4, strict=True)
    )
