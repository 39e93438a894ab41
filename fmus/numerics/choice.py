"""Conditions, and choices between values: in place of `if`, `and`, `or`, `not`, `min` and `max`.

All alternatives are evaluated. In compiled code an alternative that is not taken changes neither the result
nor its derivatives. In Python its division by zero, or its root of a negative number, raises an error: give
such an alternative as a function without arguments, which Python calls only if it is taken.

    where(x > 0.0, lambda: sqrt(x), 0.0)
"""

import math
from collections.abc import Callable, Iterable, Sequence
from functools import partial, reduce
from operator import add
from typing import Any, TypeVar

from fmus.block.scalars import flatten, members, unflatten
from fmus.numerics.symbols import are_numbers, casadi, unsimplified

__all__ = ["all", "any", "choose", "clip", "maximum", "minimum", "select", "where"]
__all__ += ["logical_and", "logical_not", "logical_or", "logical_xor"]

T = TypeVar("T")


def where(condition: bool | float, if_true: T | Callable[[], T], if_false: T | Callable[[], T]) -> T:
    """Returns `if_true` where the condition holds, else `if_false`; 0.0 for -0.0.

    Parameters
    ----------
    condition : bool or float
        A comparison, a Boolean variable, or the result of a logical function.
    if_true, if_false : float, tuple, dataclass, or function without arguments
        Alternatives of one shape, or functions that return them.

    Returns
    -------
    float, tuple or dataclass
        The alternative that is taken.

    Raises
    ------
    TypeError
        If the alternatives are symbols of different shapes.

    Examples
    --------
    >>> x = 0.0
    >>> where(x > 0.0, lambda: 1.0 / x, 100.0)
    100.0
    """
    if condition.__class__ is bool or are_numbers(condition):
        return _without_minus_zeros(_value(if_true if condition else if_false))
    first, second = _value(if_true), _value(if_false)
    _check_shapes(first, second)
    if isinstance(first, tuple) or hasattr(first, "__dataclass_fields__"):
        pairs = zip(flatten(first), flatten(second), strict=True)
        return unflatten(first, [where(condition, *pair) for pair in pairs])
    return unsimplified(casadi().if_else, condition, first, second)


def _check_shapes(if_true: Any, if_false: Any, path: str = "") -> None:
    """Raises TypeError for alternatives of different shapes, at any level."""
    shapes = _shape(if_true), _shape(if_false)
    if shapes[0] != shapes[1]:
        where = f" at {path}" if path else ""
        raise TypeError(f"alternatives {shapes[0]} and {shapes[1]}{where}: expected two of one shape")
    for (name, first), (_, second) in zip(members(if_true, 0) or (), members(if_false, 0) or (), strict=True):
        _check_shapes(first, second, f"{path}{name}")


def _shape(value: Any) -> str:
    if hasattr(value, "__dataclass_fields__"):
        return type(value).__name__
    return f"a tuple of {len(value)}" if isinstance(value, tuple) else "a number"


def _value(alternative: Any) -> Any:
    return alternative() if callable(alternative) else alternative


def _without_minus_zeros(value: Any) -> Any:
    """Returns the value with 0.0 for -0.0."""
    # compiled code adds 0.0 to an alternative: Python must give the same bits
    if isinstance(value, float):
        return value + 0.0
    if isinstance(value, tuple) or hasattr(value, "__dataclass_fields__"):
        scalars = flatten(value)
        if are_numbers(*scalars) and not [x for x in scalars if not x and math.copysign(1.0, x) < 0.0]:
            return value
        return unflatten(value, list(map(_without_minus_zeros, scalars)))
    # of a symbol, where the condition is known
    return value if are_numbers(value) else unsimplified(add, value, 0.0)


def logical_and(first: bool | float, second: bool | float) -> bool:
    """Whether both conditions hold.

    Parameters
    ----------
    first, second : bool or float
        Conditions of `where`.

    Returns
    -------
    bool
    """
    if are_numbers(first, second):
        return bool(first and second)
    return casadi().logic_and(first, second)


def logical_or(first: bool | float, second: bool | float) -> bool:
    """Whether one condition holds, or both.

    Parameters
    ----------
    first, second : bool or float
        Conditions of `where`.

    Returns
    -------
    bool
    """
    if are_numbers(first, second):
        return bool(first or second)
    return casadi().logic_or(first, second)


def logical_xor(first: bool | float, second: bool | float) -> bool:
    """Whether exactly one of two conditions holds.

    Parameters
    ----------
    first, second : bool or float
        Conditions of `where`.

    Returns
    -------
    bool
    """
    if are_numbers(first, second):
        return bool(first) != bool(second)
    return logical_not(first) != logical_not(second)


def logical_not(condition: bool | float) -> bool:
    """Whether the condition does not hold.

    Parameters
    ----------
    condition : bool or float
        Condition of `where`.

    Returns
    -------
    bool
    """
    if are_numbers(condition):
        return not condition
    return casadi().logic_not(condition)


def all(conditions: Iterable[bool | float]) -> bool:
    """Whether every condition holds; True for none.

    Parameters
    ----------
    conditions : iterable of bool or float
        Conditions of `where`.

    Returns
    -------
    bool

    Examples
    --------
    >>> all(a < b for a, b in ((1.0, 2.0), (2.0, 3.0)))
    True
    """
    return reduce(logical_and, conditions, True)


def any(conditions: Iterable[bool | float]) -> bool:
    """Whether at least one condition holds; False for none.

    Parameters
    ----------
    conditions : iterable of bool or float
        Conditions of `where`.

    Returns
    -------
    bool
    """
    return reduce(logical_or, conditions, False)


def select(conditions: Sequence[bool | float], choices: Sequence[Any], default: Any = 0.0) -> Any:
    """Returns the choice of the first condition that holds, else the default.

    Parameters
    ----------
    conditions : sequence of bool or float
        Conditions of `where`.
    choices : sequence
        Alternatives of `where`, as many as conditions.
    default : float, tuple, dataclass, or function without arguments
        Alternative if no condition holds.

    Returns
    -------
    float, tuple or dataclass

    Examples
    --------
    >>> select([False, True], [1.0, 2.0], 3.0)
    2.0
    """
    chosen = default
    for condition, choice in reversed(list(zip(conditions, choices, strict=True))):
        chosen = partial(where, condition, choice, chosen)
    return _value(chosen)


def choose(index: float, choices: Sequence[Any]) -> Any:
    """Returns `choices[index]`; the first choice for lower indices, the last for higher ones.

    Parameters
    ----------
    index : float
        Whole number from 0.
    choices : sequence
        Alternatives of `where`.

    Returns
    -------
    float, tuple or dataclass

    Examples
    --------
    >>> choose(1, (10.0, 20.0, 30.0)), choose(7, (10.0, 20.0, 30.0))
    (20.0, 30.0)
    """
    return select([index < i + 1 for i in range(len(choices) - 1)], choices[:-1], choices[-1])


def minimum(first: float, second: float) -> float:
    """Returns the smaller of two numbers; the second of 0.0 and -0.0.

    Parameters
    ----------
    first, second : float
        Numbers in one unit.

    Returns
    -------
    float
    """
    if are_numbers(first, second):
        return first if first < second or math.isnan(second) else second
    return casadi().fmin(second, first)


def maximum(first: float, second: float) -> float:
    """Returns the larger of two numbers; the second of 0.0 and -0.0.

    Parameters
    ----------
    first, second : float
        Numbers in one unit.

    Returns
    -------
    float
    """
    if are_numbers(first, second):
        return first if first > second or math.isnan(second) else second
    return casadi().fmax(second, first)


def clip(value: float, low: float, high: float) -> float:
    """Returns `value` limited to low..high.

    Parameters
    ----------
    value : float
        Any number.
    low, high : float
        Ends of the range, in the unit of the value.

    Returns
    -------
    float

    Examples
    --------
    >>> clip(15.0, -12.0, 12.0)
    12.0
    """
    return minimum(maximum(value, low), high)
