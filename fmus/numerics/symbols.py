"""Symbols among the arguments of a function: told from numbers here, and CasADi, loaded once one is there."""

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
    """Whether no value is a symbol. NumPy's numbers and truth values, which have a dtype, are none either."""
    for value in values:  # noqa: SIM110  (called at each step many times, where `all` takes twice as long)
        if not isinstance(value, _NUMBERS) and not hasattr(value, "dtype"):
            return False
    return True


def unsimplified(function: Callable[..., Any], *arguments: Any) -> Any:
    """Returns what a function of CasADi gives, with sums with the constant 0, which give 0 for -0."""
    casadi().GlobalOptions.setSimplificationOnTheFly(False)
    try:
        return function(*arguments)
    finally:
        casadi().GlobalOptions.setSimplificationOnTheFly(True)
