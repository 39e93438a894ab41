"""Values of FMI variables: types, ranges and items of enumerations."""

import math
import reprlib
import sys
from collections.abc import Sequence
from ctypes import c_float
from functools import lru_cache

import numpy as np

from fmus.errors import range_text
from fmus.fmi.description import start_value
from fmus.fmi.variable_types import INTEGER_RANGE, FmiValue
from orchestration.errors import SystemDefinitionError
from orchestration.system.quantities import StatedValue, read_value
from orchestration.system.system import Port

Value = FmiValue | np.generic  # as users give it

# Of a signal's largest value: some units in the last place, by which a computed curve may miss a limit.
_ROUNDING = 1e-15
_PYTHON_TYPES: dict[str, tuple[type, ...]] = {"Real": (int, float), "Boolean": (bool,)}  # others: int


def fmi_value(port: Port, value: Value) -> FmiValue:
    """Returns the value as the FMU takes it; an item of an enumeration may be given by its name.

    Raises SystemDefinitionError for a value of another type, or outside the declared range, also by name.
    """
    variable, place = port.variable, getattr(value, "place", "")
    plain: FmiValue = value.item() if isinstance(value, np.generic) else value
    if isinstance(plain, StatedValue) or (isinstance(plain, str) and variable.type == "Real"):
        try:
            plain = read_value(plain, variable)
        except SystemDefinitionError as error:
            message = f"{port.name} = {str(plain)!r}: {error}"
            raise SystemDefinitionError(message, port.name, place=place) from None
    if variable.type == "String":
        return str(plain)
    if isinstance(plain, str):
        plain = _allowed_items(port).get(plain, plain)
    return _number(port, plain, place)


def value_of_open_input(port: Port) -> FmiValue:
    """Returns the start value of an input; of an FMU of FMI 3.0 it may be INF or NaN."""
    value = start_value(port.variable)
    return value if isinstance(value, float) and not math.isfinite(value) else fmi_value(port, value)


def fmi_values(port: Port, values: Sequence[Value] | np.ndarray) -> list[FmiValue]:
    """Returns the values as the FMU takes them, as `fmi_value`."""
    # a sweep has thousands of values: plain floats are checked at once
    is_double = port.variable.type == "Real" and not port.variable.is_float32
    if is_double and all(type(value) is float for value in values):
        low, high = value_range(port)
        numbers = np.array(values)
        if (np.isfinite(numbers) & (low <= numbers) & (numbers <= high)).all():
            return numbers.tolist()
    return [fmi_value(port, value) for value in values]


def _number(port: Port, value: FmiValue, place: str) -> float | int | bool:
    variable = port.variable
    expected = _PYTHON_TYPES.get(variable.type, (int,))
    has_type = isinstance(value, expected) and (variable.type == "Boolean" or not isinstance(value, bool))
    low, high = value_range(port)
    if isinstance(value, str) and variable.type == "Real":
        expected = "a number" if port.variable.unit in (None, "1") else f"a number in {port.variable.unit}"
    elif (named := _allowed_items(port)) and value not in named.values():
        expected = _permitted(port)
    elif isinstance(value, str) or not has_type:
        has_unit = isinstance(value, str) and value[:1].isdigit() and value[-1].isalpha()
        expected = f"a value of type {variable.type}{', which has no unit' * has_unit}"
    elif not abs(value) <= sys.float_info.max:
        expected = "a finite number"
    elif not low <= value <= high:
        expected = _permitted(port)
    elif variable.is_float32 and (math.isinf(held := c_float(value).value) or (value and not held)):
        expected = "0, or 1.4e-45..3.4e38 in size, as it has single precision (Float32)"
    else:
        return value
    message = f"{port.name} = {reprlib.repr(value)}: expected {expected}"
    raise SystemDefinitionError(message, port.name, place=place)


def items(port: Port) -> dict[str, int]:
    """Returns the numbers of the items of an enumeration by their names."""
    declared = port.variable.declaredType
    return {str(item.name): int(str(item.value)) for item in (declared.items or [])} if declared else {}


def _allowed_items(port: Port) -> dict[str, int]:
    """Returns the items of an enumeration within the declared range."""
    low, high = value_range(port)
    return {name: number for name, number in items(port).items() if low <= number <= high}


def _permitted(port: Port) -> str:
    """Returns which numbers a variable may have, in words."""
    low, high = value_range(port)
    if named := _allowed_items(port):
        return f"one of {', '.join(f'{item} ({number})' for item, number in named.items())}"
    return range_text(low, high, port.variable.unit)


def is_discrete(port: Port) -> bool:
    """Whether a variable changes at events alone, so that no value between two of its values is meant."""
    return port.variable.type != "Real" or port.variable.variability == "discrete"


def possible_values(port: Port, values: np.ndarray) -> tuple[str, np.ndarray]:
    """Returns what is expected of a number for an input, in words, and which values, shape (n,), are that."""
    kind, (low, high) = port.variable.type, (0, 1) if port.variable.type == "Boolean" else value_range(port)
    is_finite = np.isfinite(values)
    slack = _ROUNDING * np.abs(values[is_finite]).max(initial=0.0)
    is_within = is_finite & (low - slack <= values) & (values <= high + slack)
    if kind == "Real":
        return _permitted(port), is_within
    if named := _allowed_items(port):
        return _permitted(port), np.isin(values, [*named.values()])
    integer = f"an integer, {range_text(low, high)}, as the input has type {kind}"
    return "true or false" if kind == "Boolean" else integer, is_within & (values == np.floor(values))


def value_range(port: Port) -> tuple[float, float]:
    """Returns the smallest and the largest value, as declared and as the type can hold."""
    variable = port.variable
    return _range(variable.type, variable.min, variable.max)


# thousands of values of one variable are checked
@lru_cache
def _range(kind: str, least: str | None, largest: str | None) -> tuple[float, float]:
    """Returns the range of a type, cut to the limits that a model description states."""
    low, high = (-math.inf, math.inf) if kind == "Real" else INTEGER_RANGE
    return low if least is None else float(least), high if largest is None else float(largest)
