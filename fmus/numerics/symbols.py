"""What the functions of this room have in common: is an argument a number, and CasADi once one is none."""

from functools import cache
from typing import Any

_NUMBERS = (float, int)


@cache
def casadi() -> Any:
    """The library of symbols, loaded when the first symbol arrives."""
    import casadi

    return casadi


def are_numbers(*values: object) -> bool:
    """Whether no value is a symbol."""
    return all(isinstance(value, _NUMBERS) for value in values)
