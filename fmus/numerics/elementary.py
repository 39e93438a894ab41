"""The functions of Python's `math` that have a meaning on a symbol, under their names there."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from fmus.numerics.symbols import are_numbers, casadi

__all__ = ["absolute", "cbrt", "copysign", "dist", "erf", "hypot", "power", "sign", "sqrt"]
__all__ += ["acos", "asin", "atan", "atan2", "cos", "degrees", "radians", "sin", "tan"]
__all__ += ["acosh", "asinh", "atanh", "cosh", "sinh", "tanh"]
__all__ += ["exp", "exp2", "expm1", "log", "log1p", "log2", "log10"]
__all__ += ["ceil", "floor", "fmod", "remainder", "round", "trunc"]


def _of_one(name: str, meaning: str, value: str = "Any number.") -> Callable[[float], float]:
    on_float = getattr(math, name)

    def function(value: float) -> float:
        """Returns {}

        Parameters
        ----------
        value : float
            {}

        Returns
        -------
        float
        """
        if isinstance(value, (float, int)):
            result = on_float(value)
            return math.copysign(result, value) if isinstance(result, int) else result
        return getattr(casadi(), name)(value)

    function.__name__ = function.__qualname__ = name
    function.__doc__ = (function.__doc__ or "").format(meaning, value)
    return function


def _of_two(name: str, meaning: str, values: str = "Two numbers.") -> Callable[[float, float], float]:
    on_float = getattr(math, name)

    def function(first: float, second: float) -> float:
        """Returns {}

        Parameters
        ----------
        first, second : float
            {}

        Returns
        -------
        float
        """
        if are_numbers(first, second):
            return on_float(first, second)
        return getattr(casadi(), name)(first, second)

    function.__name__ = function.__qualname__ = name
    function.__doc__ = (function.__doc__ or "").format(meaning, values)
    return function


sqrt = _of_one("sqrt", "the square root of a value of at least 0.", "0 or more.")
exp = _of_one("exp", "e to the power of the value.")
expm1 = _of_one("expm1", "exp(value) - 1, accurate near 0.")
log = _of_one("log", "the natural logarithm of a value above 0.", "More than 0.")
log1p = _of_one("log1p", "log(1 + value), accurate near 0, of a value above -1.", "More than -1.")
sin = _of_one("sin", "the sine of an angle in rad.", "Angle [rad].")
cos = _of_one("cos", "the cosine of an angle in rad.", "Angle [rad].")
tan = _of_one("tan", "the tangent of an angle in rad.", "Angle [rad].")
asin = _of_one("asin", "the angle in rad, -pi/2..pi/2, whose sine is the value, -1..1.", "-1 to 1.")
acos = _of_one("acos", "the angle in rad, 0..pi, whose cosine is the value, -1..1.", "-1 to 1.")
atan = _of_one("atan", "the angle in rad, -pi/2..pi/2, whose tangent is the value.")
atan2 = _of_two("atan2", "the angle in rad, -pi..pi, of the point (second, first): atan2(y, x).", "y and x.")
sinh = _of_one("sinh", "the hyperbolic sine.")
cosh = _of_one("cosh", "the hyperbolic cosine.")
tanh = _of_one("tanh", "the hyperbolic tangent.")
asinh = _of_one("asinh", "the inverse hyperbolic sine.")
acosh = _of_one("acosh", "the inverse hyperbolic cosine of a value of at least 1.", "1 or more.")
atanh = _of_one("atanh", "the inverse hyperbolic tangent of a value between -1 and 1.", "Between -1 and 1.")
erf = _of_one("erf", "the error function.")
# Python's int has no -0: a whole number stays a float with the sign of the value, as in C
floor: Callable[[float], Any] = _of_one(
    "floor", "the largest whole number that is not above the value, as a float."
)
ceil: Callable[[float], Any] = _of_one(
    "ceil", "the smallest whole number that is not below the value, as a float."
)
fmod = _of_two("fmod", "the remainder of first / second with the sign of the first, exact (C's fmod).")
remainder = _of_two(
    "remainder", "first - n * second, exact, for the whole number n nearest to first / second (IEEE 754)."
)
copysign = _of_two("copysign", "the absolute value of the first with the sign of the second.")


def trunc(value: float) -> Any:
    """Returns the value without its fraction, as a float: towards 0.

    Parameters
    ----------
    value : float
        Any number.

    Returns
    -------
    float

    Examples
    --------
    >>> trunc(-1.7)
    -1.0
    """
    return value - fmod(value, 1.0)


def round(value: float) -> Any:
    """Returns the whole number nearest to the value, as a float; the even one of two, like Python's.

    Parameters
    ----------
    value : float
        Any number.

    Returns
    -------
    float

    Examples
    --------
    >>> round(2.5), round(3.5)
    (2.0, 4.0)
    """
    return value - remainder(value, 1.0)


def absolute(value: float) -> float:
    """Returns |value|; Python's `abs` does the same.

    Parameters
    ----------
    value : float
        Any number.

    Returns
    -------
    float
    """
    return abs(value)


def sign(value: float) -> float:
    """Returns -1.0 or 1.0, and a zero as it is.

    Parameters
    ----------
    value : float
        Any number.

    Returns
    -------
    float

    Examples
    --------
    >>> sign(-3.0), sign(0.0)
    (-1.0, 0.0)
    """
    if isinstance(value, (float, int)):
        return float((value > 0.0) - (value < 0.0)) or float(value)
    return casadi().sign(value)


def power(base: float, exponent: float) -> float:
    """Returns `base ** exponent` for a base of zero or more.

    Parameters
    ----------
    base : float
        0 or more.
    exponent : float
        Any number.

    Returns
    -------
    float

    Examples
    --------
    >>> power(2.0, 3.0)
    8.0
    """
    if are_numbers(base, exponent):
        # CasADi makes a root of the exponent 0.5, whose last bit can differ from C's pow
        return math.sqrt(base) if exponent == 0.5 else math.pow(base, exponent)
    return casadi().constpow(base, exponent)


def exp2(value: float) -> float:
    """Returns 2 to the power of the value.

    Parameters
    ----------
    value : float
        Any number.

    Returns
    -------
    float
    """
    return power(2.0, value)


def log2(value: float) -> float:
    """Returns the logarithm to base 2, within 2 units in the last place: log2(8.0) may not be 3.0 exactly.

    Parameters
    ----------
    value : float
        More than 0.

    Returns
    -------
    float
    """
    return log(value) * (1.0 / math.log(2.0))


def log10(value: float) -> float:
    """Returns the logarithm to base 10, within 2 units in the last place: log10(1e3) may not be 3 exactly.

    Parameters
    ----------
    value : float
        More than 0.

    Returns
    -------
    float
    """
    return log(value) * (1.0 / math.log(10.0))


def cbrt(value: float) -> float:
    """Returns the cube root of any value, within 2 units in the last place.

    Parameters
    ----------
    value : float
        Any number.

    Returns
    -------
    float
    """
    return copysign(power(abs(value), 1.0 / 3.0), value)


def radians(degrees: float) -> float:
    """Returns an angle in degrees, in rad.

    Parameters
    ----------
    degrees : float
        Angle [deg].

    Returns
    -------
    float
        Angle [rad].
    """
    return degrees * (math.pi / 180.0)


def degrees(radians: float) -> float:
    """Returns an angle in rad, in degrees.

    Parameters
    ----------
    radians : float
        Angle [rad].

    Returns
    -------
    float
        Angle [deg].
    """
    return radians * (180.0 / math.pi)


def hypot(*coordinates: float) -> float:
    """Returns the length of a vector, the root of the sum of squares, which may overflow above 1e154.

    Parameters
    ----------
    *coordinates : float
        Coordinates of the vector, in one unit.

    Returns
    -------
    float
        Length in that unit.

    Examples
    --------
    >>> hypot(3.0, 4.0)
    5.0
    """
    return sqrt(sum(x * x for x in coordinates))


def dist(first: Sequence[float], second: Sequence[float]) -> float:
    """Returns the distance between two points with as many coordinates.

    Parameters
    ----------
    first, second : sequence of float
        Coordinates of each point, in one unit.

    Returns
    -------
    float
        Distance in that unit.

    Examples
    --------
    >>> dist((1.0, 1.0), (4.0, 5.0))
    5.0
    """
    return hypot(*(a - b for a, b in zip(first, second, strict=True)))
