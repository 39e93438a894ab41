"""Integration of differential equations within a step."""

from collections.abc import Callable
from typing import Any


def rk4_step(derivative: Callable[[Any, tuple], tuple], t: float, x: tuple, h: float) -> tuple:
    """One step of the classical fourth-order Runge-Kutta method.

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
