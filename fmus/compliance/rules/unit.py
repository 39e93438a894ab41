"""Rules of units: FMI 2.0.5, 2.2.2 Definition of Units (UnitDefinitions)."""

from collections.abc import Iterator
from typing import Any

from fmus.block.units import BASE_UNITS
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.variable import integer, number
from fmus.errors import nearest

_CLAUSE = "2.2.2 Definition of Units (UnitDefinitions)"
_TYPES = "2.2.3 Definition of Types (TypeDefinitions)"
_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


def _units(fmu: FmuFile) -> dict[str, Any]:
    return {element.get("name", ""): element for element in fmu.root.iterfind("UnitDefinitions/Unit")}


def _used(fmu: FmuFile) -> Iterator[tuple[str, str | None, str | None]]:
    """Yields (what uses them, unit, display unit) of types and variables, which inherit from types."""
    for simple in fmu.root.iterfind("TypeDefinitions/SimpleType[Real]"):
        real = simple.find("Real")
        yield f"type {simple.get('name')}", real.get("unit"), real.get("displayUnit")
    for v in fmu.variables:
        if v.typed.get("unit") is not None or v.typed.get("displayUnit") is not None:
            yield v.name, v.get("unit"), v.get("displayUnit")


@rule(_CLAUSE, Stage.DESCRIPTION)
def unit_names_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two units have the same name."""
    names = [element.get("name") for element in fmu.root.iterfind("UnitDefinitions/Unit")]
    for name, count in repeated(names).items():
        yield f"unit {name!r} is defined {count} times: expected once"


@rule(_CLAUSE, Stage.DESCRIPTION)
def display_unit_names_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two display units of one unit have the same name."""
    for unit in fmu.root.iterfind("UnitDefinitions/Unit"):
        names = [element.get("name") for element in unit.iterfind("DisplayUnit")]
        for name, count in repeated(names).items():
            yield f"display unit {name!r} of {unit.get('name')!r} is defined {count} times: expected once"


@rule(_TYPES, Stage.DESCRIPTION)
def units_are_defined(fmu: FmuFile) -> Iterator[str]:
    """Each unit of a type or variable is defined; none has a display unit without unit."""
    units = _units(fmu)
    for user, unit, display in _used(fmu):
        if unit is not None and unit not in units:
            yield f"{user}: unit {unit!r} is not defined; {nearest(unit, units)}"
        elif display is not None and unit is None:
            yield f"{user}: displayUnit {display!r} without unit: expected both or none"


@rule(_TYPES, Stage.DESCRIPTION)
def display_units_are_defined(fmu: FmuFile) -> Iterator[str]:
    """Each display unit belongs to its unit; otherwise importers ignore it."""
    units = _units(fmu)
    for user, unit, display in _used(fmu):
        if display is not None and unit in units:
            known = [element.get("name", "") for element in units[unit].iterfind("DisplayUnit")]
            if display not in known:
                yield f"{user}: displayUnit {display!r} of {unit!r} is ignored; {nearest(display, known)}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def units_are_used(fmu: FmuFile) -> Iterator[str]:
    """Each unit that is defined is used by a type or variable."""
    used = {unit for _, unit, _ in _used(fmu)} - {None}
    if (
        used <= _units(fmu).keys()
    ):  # otherwise one that is not used may be meant by a name that is not defined
        for name in _units(fmu).keys() - used:
            yield f"unit {name!r} is used by no type and no variable: expected it to be, or left out"


@rule("advice: the usual meaning of names of units", Stage.DESCRIPTION)
def unit_exponents(fmu: FmuFile) -> Iterator[str]:
    """A unit whose name means a coherent SI unit has the exponents of that unit; rad may be left out."""
    for unit in fmu.root.iterfind("UnitDefinitions/Unit"):
        base, expected = unit.find("BaseUnit"), BASE_UNITS.get(unit.get("name", ""))
        exponents = {name: integer(base.get(name, "0")) for name in _EXPONENTS} if base is not None else {}
        if base is None or expected is None or None in exponents.values():
            continue
        got = {name: exponent for name, exponent in exponents.items() if exponent}
        without_radian = {name: exponent for name, exponent in got.items() if name != "rad"}
        if without_radian != {name: exponent for name, exponent in expected.items() if name != "rad"}:
            yield f"unit {unit.get('name')!r} is {_text(got)}: expected {_text(expected)}"


def _text(exponents: dict) -> str:
    return " ".join(f"{name}^{exponent}" for name, exponent in exponents.items()) or "1"


@rule(_CLAUSE, Stage.DESCRIPTION)
def unit_factors(fmu: FmuFile) -> Iterator[str]:
    """Factors of base units and display units are not 0, or nothing could be converted back."""
    for unit in fmu.root.iterfind("UnitDefinitions/Unit"):
        for element in unit.iterchildren("BaseUnit", "DisplayUnit"):
            if number(element.get("factor", "1")) == 0:
                yield f"unit {unit.get('name')!r}: {element.tag} with factor 0: expected another"
