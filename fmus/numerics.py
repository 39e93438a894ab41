"""Arithmetic that means the same on a float and on a CasADi symbol.

Blocks call these functions instead of `math` and `if`, so that one source runs as Python and is
traced to C. On floats nothing but the standard library is imported; CasADi is loaded when the
first symbol arrives.

Both alternatives of `where` are evaluated: a denominator, root or logarithm in the one not taken
must still be legal.
"""

import math
from collections.abc import Callable, Sequence
from functools import cache
from itertools import pairwise
from typing import Any

_NUMBERS = (float, int)


@cache
def _casadi() -> Any:
    import casadi

    return casadi


def where(condition: Any, if_true: Any, if_false: Any) -> Any:
    """`if_true` where the condition holds, else `if_false`; a condition may be bool or symbol."""
    if condition.__class__ is bool:
        return if_true if condition else if_false
    return _casadi().if_else(condition, if_true, if_false)


def both(first: Any, second: Any) -> Any:
    """Logical and."""
    if first.__class__ is bool and second.__class__ is bool:
        return first and second
    return _casadi().logic_and(first, second)


def negate(condition: Any) -> Any:
    """Logical not."""
    if condition.__class__ is bool:
        return not condition
    return _casadi().logic_not(condition)


def minimum(first: Any, second: Any) -> Any:
    """The smaller of two numbers."""
    if isinstance(first, _NUMBERS) and isinstance(second, _NUMBERS):
        return first if first < second else second
    return _casadi().fmin(first, second)


def maximum(first: Any, second: Any) -> Any:
    """The larger of two numbers."""
    if isinstance(first, _NUMBERS) and isinstance(second, _NUMBERS):
        return first if first > second else second
    return _casadi().fmax(first, second)


def clip(value: Any, low: Any, high: Any) -> Any:
    """`value` limited to low..high."""
    return minimum(maximum(value, low), high)


def sign(value: Any) -> Any:
    """-1.0, 0.0 or 1.0."""
    if isinstance(value, _NUMBERS):
        return math.copysign(1.0, value) if value != 0.0 else 0.0
    return _casadi().sign(value)


def absolute(value: Any) -> Any:
    """|value|."""
    return abs(value)


def power(base: Any, exponent: Any) -> Any:
    """`base ** exponent` for a base of zero or more."""
    if isinstance(base, _NUMBERS) and isinstance(exponent, _NUMBERS):
        return math.pow(base, exponent)
    return _casadi().constpow(base, exponent)


def modulo(value: Any, divisor: Any) -> Any:
    """Remainder of value / divisor with the sign of `value` (C's fmod): exact on doubles."""
    if isinstance(value, _NUMBERS) and isinstance(divisor, _NUMBERS):
        return math.fmod(value, divisor)
    return _casadi().fmod(value, divisor)


def atan2(y: Any, x: Any) -> Any:
    """The angle of the point (x, y) in rad, -pi..pi."""
    if isinstance(y, _NUMBERS) and isinstance(x, _NUMBERS):
        return math.atan2(y, x)
    return _casadi().atan2(y, x)


def _elementary(name: str) -> Callable[[Any], Any]:
    on_float = getattr(math, name)

    def function(value: Any) -> Any:
        if isinstance(value, _NUMBERS):
            return float(on_float(value))
        return getattr(_casadi(), name)(value)

    function.__name__ = name
    function.__doc__ = f"{name}(value), as a float."
    return function


sqrt = _elementary("sqrt")
exp = _elementary("exp")
log = _elementary("log")
sin = _elementary("sin")
cos = _elementary("cos")
tan = _elementary("tan")
asin = _elementary("asin")
acos = _elementary("acos")
atan = _elementary("atan")
sinh = _elementary("sinh")
cosh = _elementary("cosh")
tanh = _elementary("tanh")
floor = _elementary("floor")
ceil = _elementary("ceil")


def ramps(t: Any, times: Sequence[Any], values: Sequence[Any], smooth: Any) -> Any:
    """Lines through (time, value) at time t, held before the first and after the last point.

    times: ascending, each later than the one before
    smooth: quintic ramps instead, 10 s^3 - 15 s^4 + 6 s^5: no first or second derivative at the points
    """
    points = list(zip(times, values, strict=True))
    value = points[-1][1]
    for (t_0, y_0), (t_1, y_1) in reversed(list(pairwise(points))):
        s = (t - t_0) / (t_1 - t_0)
        quintic = s**3 * (10.0 + s * (6.0 * s - 15.0))
        value = where(t <= t_1, y_0 + (y_1 - y_0) * where(smooth, quintic, s), value)
    return where(t <= points[0][0], points[0][1], value)


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
