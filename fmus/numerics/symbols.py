"""Symbols of CasADi among the arguments of a function: their detection, and the library, loaded on demand."""

from collections.abc import Callable
from functools import cache
from typing import Any

_NUMBERS = (float, int)


@cache
def casadi() -> Any:
    """Returns the library of symbols, loaded when the first symbol arrives."""
    import casadi

    return casadi


def are_numbers(*values: object) -> bool:
    """Whether no value is a symbol."""
    # called many times in each step, where `all` takes twice as long
    for value in values:  # noqa: SIM110
        # numbers and truth values of NumPy have a dtype, symbols have not
        if not isinstance(value, _NUMBERS) and not hasattr(value, "dtype"):
            return False
    return True


def unsimplified(function: Callable[..., Any], *arguments: Any) -> Any:
    """Returns the result of a function of CasADi, in which sums with the constant 0 remain."""
    # such a sum makes 0 of -0: without it, the C code would differ from Python in the sign of a zero
    options = casadi().GlobalOptions
    before = options.getSimplificationOnTheFly()
    options.setSimplificationOnTheFly(False)
    try:
        return function(*arguments)
    finally:
        options.setSimplificationOnTheFly(before)
