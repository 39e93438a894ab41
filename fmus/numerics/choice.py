"""Conditions, and choices between values: in place of `if`, `and`, `or`, `not`, `min` and `max`.

All alternatives are evaluated. In compiled code one that is not taken cannot spoil the result nor its
derivatives. In Python a division by zero or the root of a negative number in it raises an error: give such an
alternative as a function without arguments, which Python calls only if it is taken.

    where(x > 0.0, lambda: sqrt(x), 0.0)
"""

from collections.abc import Iterable, Sequence
from functools import partial, reduce
from typing import Any

from fmus.block import flatten, unflatten
from fmus.numerics.symbols import are_numbers, casadi


def where(condition: Any, if_true: Any, if_false: Any) -> Any:
    """`if_true` where the condition holds, else `if_false`.

    condition: a comparison, a Boolean variable, or what the logical functions give
    if_true, if_false: numbers, or tuples or dataclasses of one shape; or functions that return them
    """
    if condition.__class__ is bool or are_numbers(condition):
        return _value(if_true if condition else if_false)
    if_true, if_false = _value(if_true), _value(if_false)
    _check_shapes(if_true, if_false)
    if isinstance(if_true, tuple) or hasattr(if_true, "__dataclass_fields__"):
        pairs = zip(flatten(if_true), flatten(if_false), strict=True)
        return unflatten(if_true, [where(condition, *pair) for pair in pairs])
    if if_true is if_false:
        return if_true
    return casadi().if_else(condition, if_true, if_false)


def _check_shapes(if_true: Any, if_false: Any, place: str = "") -> None:
    """TypeError for a number beside a tuple or dataclass, or for another number of elements, at any level."""
    shapes = [
        type(value).__name__ if hasattr(value, "__dataclass_fields__")
        else f"a tuple of {len(value)}" if isinstance(value, tuple)
        else "a number"
        for value in (if_true, if_false)
    ]  # fmt: skip
    if shapes[0] != shapes[1]:
        where = f" at {place}" if place else ""
        raise TypeError(f"alternatives {shapes[0]} and {shapes[1]}{where}: expected two of one shape")
    for (name, first), (_, second) in zip(_elements(if_true), _elements(if_false), strict=True):
        _check_shapes(first, second, f"{place}{name}")


def _elements(value: Any) -> list[tuple[str, Any]]:
    """Place and value of what a tuple or dataclass consists of."""
    if isinstance(value, tuple):
        return [(f"[{i}]", element) for i, element in enumerate(value)]
    return [(f".{name}", getattr(value, name)) for name in getattr(value, "__dataclass_fields__", ())]


def _value(alternative: Any) -> Any:
    return alternative() if callable(alternative) else alternative


def logical_and(first: Any, second: Any) -> Any:
    """Whether both conditions hold."""
    if are_numbers(first, second):
        return bool(first and second)
    return casadi().logic_and(first, second)


def logical_or(first: Any, second: Any) -> Any:
    """Whether one condition holds, or both."""
    if are_numbers(first, second):
        return bool(first or second)
    return casadi().logic_or(first, second)


def logical_xor(first: Any, second: Any) -> Any:
    """Whether exactly one of two conditions holds."""
    if are_numbers(first, second):
        return bool(first) != bool(second)
    return logical_not(first) != logical_not(second)


def logical_not(condition: Any) -> Any:
    """Whether the condition does not hold."""
    if are_numbers(condition):
        return not condition
    return casadi().logic_not(condition)


def all(conditions: Iterable[Any]) -> Any:
    """Whether every condition holds; True for none."""
    return reduce(logical_and, conditions, True)


def any(conditions: Iterable[Any]) -> Any:
    """Whether at least one condition holds; False for none."""
    return reduce(logical_or, conditions, False)


def select(conditions: Sequence[Any], choices: Sequence[Any], default: Any = 0.0) -> Any:
    """The choice of the first condition that holds, else the default.

    choices: as many as conditions; each as an alternative of `where`, as the default
    """
    chosen = default
    for condition, choice in reversed(list(zip(conditions, choices, strict=True))):
        chosen = partial(where, condition, choice, chosen)
    return _value(chosen)


def choose(index: Any, choices: Sequence[Any]) -> Any:
    """choices[index]: the first for 0 and for what is below, the last for what is beyond."""
    return select([index < i + 1 for i in range(len(choices) - 1)], choices[:-1], choices[-1])


def minimum(first: Any, second: Any) -> Any:
    """The smaller of two numbers."""
    if are_numbers(first, second):
        return first if first < second else second
    return casadi().fmin(first, second)


def maximum(first: Any, second: Any) -> Any:
    """The larger of two numbers."""
    if are_numbers(first, second):
        return first if first > second else second
    return casadi().fmax(first, second)


def clip(value: Any, low: Any, high: Any) -> Any:
    """`value` limited to low..high."""
    return minimum(maximum(value, low), high)
