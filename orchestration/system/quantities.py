"""Quantities: numbers with the units that files and options state, in the units of the variables of FMUs."""

import math
import re
import tomllib
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

from fmus.errors import nearest
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import FmiValue
from fmus.units import PREFIXES, SYMBOLS, UnitDefinition, of_differences, si_unit
from orchestration.errors import SystemDefinitionError

Units = Mapping[str, UnitDefinition]
"""Name of a unit -> its definition by an FMU or a file."""
# Tools write the factor of one unit with 15 or with 17 digits.
_EQUAL = 1e-12
# not "1,5 m", "1.2.3 m" or "1 000 m"
_QUANTITY = re.compile(
    r"((?>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?|[-+]?(?:inf|nan)(?=\s)))\s*(?![.,']|\d[\d\s.,])(\S.*)"
)


class Conversion(NamedTuple):
    """A change of units: value * factor / divisor + offset."""

    factor: float = 1.0
    divisor: float = 1.0
    offset: float = 0.0

    def __call__(self, value: Any) -> Any:
        """Returns a number or an array of numbers in the other unit."""
        return value if self == Conversion() else value * self.factor / self.divisor + self.offset

    @property
    def inverse(self) -> "Conversion":
        """The change back."""
        return Conversion(self.divisor, self.factor, -self.offset * self.divisor / self.factor)


def conversion(
    unit: str, expected: str, own: Mapping[str, UnitDefinition] = {}, stated: Units | None = None
) -> Conversion:
    """Returns the change from a unit to the expected one; "" is the expected one.

    A definition goes over the meaning of a name in SI units.
    own: definitions of the FMU that has the expected unit; stated: definitions of the file or the FMU
    that states the other one, over these
    Raises SystemDefinitionError for a unit that is not known, or has another dimension.
    """
    stated = {**own, **(stated or {})}
    defined = stated.get(unit), own.get(expected)
    if not unit or {unit, expected} <= {"", "1", "-"} or (unit == expected and not all(defined)):
        return Conversion()
    unit = "1" if unit == "-" else unit
    meant = si_unit(unit), si_unit(expected)
    pairs = [defined] if all(defined) else [(defined[0] or meant[0], defined[1] or meant[1]), meant]
    for a, b in pairs:
        if a and b and a.exponents == b.exponents:
            return _between(a, b)
    prefixed = [prefix + expected for prefix in PREFIXES if si_unit(prefix + expected)]
    names = dict.fromkeys([expected, *prefixed, *stated, *SYMBOLS])
    known = "" if pairs[0][0] else f"; {nearest(unit, names)}"
    expectation = f"{expected} or a unit of its dimension" if expected else "no unit"
    text = f"{'unknown ' if known else ''}unit {unit!r}"
    raise SystemDefinitionError(f"{text}: expected {expectation}{known}")


def are_equal(unit: str | None, other: str | None, own: Units, stated: Units) -> bool:
    """Whether two units are equal but for rounding, or one is not stated; own: definitions of the other."""
    with suppress(SystemDefinitionError):
        return not (unit and other) or conversion(unit, other, own, stated) == Conversion()
    return False


def in_unit_of(variable: ScalarVariable, unit: str, stated: Units | None = None) -> Conversion:
    """Returns the change from a unit to a variable's unit, as `conversion`."""
    own = of_differences(stated) if stated and variable.is_relative else stated
    return conversion(unit, variable.unit or "", variable.units, own)


def _between(a: UnitDefinition, b: UnitDefinition) -> Conversion:
    """Returns the change from one unit to another of its dimension."""
    offset = 0.0 if math.isclose(a.offset, b.offset, rel_tol=_EQUAL) else (a.offset - b.offset) / b.factor
    if math.isclose(a.factor, b.factor, rel_tol=_EQUAL):
        return Conversion(offset=offset)
    # cm to m divides by 100: 0.01 is not exact
    if abs(a.factor) > abs(b.factor):
        return Conversion(a.factor / b.factor, offset=offset)
    return Conversion(divisor=b.factor / a.factor, offset=offset)


class StatedValue(str):
    """The text of a value as an option or a file states it.

    place: before messages; file: the parameter file that it stands in, or ""
    units: definitions of the file that states it
    """

    place, file = "", ""
    units: Units | None = None


def stated(text: str, place: str, file: str = "", units: Units | None = None) -> StatedValue:
    """Returns the text of a value with its place."""
    value = StatedValue(text)
    value.place, value.file, value.units = place, file, units
    return value


def read_value(text: str, variable: ScalarVariable) -> FmiValue:
    """Returns the value of a text for a variable: TOML, a number with a unit, or a text without quotes.

    Of a String 1.50 stays 1.50. A number is in the unit of the variable.
    """
    with suppress(tomllib.TOMLDecodeError):
        value = tomllib.loads(f"value = {text}")["value"]
        is_plain = isinstance(value, bool | int | float) and variable.type != "String"
        return value if is_plain or isinstance(value, str) else str(text)
    match = _QUANTITY.fullmatch(text.strip()) if variable.type == "Real" else None
    if match is None:
        return str(text)
    units, file = getattr(text, "units", None), getattr(text, "file", "")
    # many FMUs state no units: the units of a parameter file are then for readers
    return in_unit_of(variable, match[2] if variable.unit or not file else "", units)(float(match[1]))
