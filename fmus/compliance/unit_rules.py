"""Rules of units: FMI 2.0.5, 2.2.2 Definition of Units (UnitDefinitions)."""

from collections.abc import Iterator

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.variable import integer, number
from fmus.errors import nearest
from fmus.units import BASE_UNITS

_CLAUSE = "2.2.2 Definition of Units (UnitDefinitions)"
_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@rule(_CLAUSE, Stage.DESCRIPTION)
def unit_names_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two units have the same name, nor two display units of one unit."""
    units = fmu.root.findall("UnitDefinitions/Unit")
    groups = [("unit", [element.get("name") for element in units])]
    groups += [
        (
            f"display unit of {unit.get('name')!r}",
            [element.get("name") for element in unit.iterfind("DisplayUnit")],
        )
        for unit in units
    ]
    for what, names in groups:
        for name, count in repeated(names).items():
            yield f"{what} {name!r} is defined {count} times: expected once"


@rule(_CLAUSE, Stage.DESCRIPTION)
def units_are_defined(fmu: FmuFile) -> Iterator[str]:
    """Each unit of a variable is defined, and its display unit belongs to it."""
    units = {element.get("name", ""): element for element in fmu.root.iterfind("UnitDefinitions/Unit")}
    for v in fmu.variables:
        unit, display = v.get("unit"), v.get("displayUnit")
        if unit is not None and unit not in units:
            yield f"{v.name}: unit {unit!r} is not defined; {nearest(unit, units)}"
        elif display is not None and unit is None:
            yield f"{v.name}: displayUnit {display!r} without unit: expected both or none"
        elif display is not None and unit is not None:
            known = [element.get("name", "") for element in units[unit].iterfind("DisplayUnit")]
            if display not in known:
                yield f"{v.name}: displayUnit {display!r} of {unit!r} is unknown; {nearest(display, known)}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def unit_exponents(fmu: FmuFile) -> Iterator[str]:
    """A coherent SI unit that the name tells has the exponents of that unit."""
    for unit in fmu.root.iterfind("UnitDefinitions/Unit"):
        base, expected = unit.find("BaseUnit"), BASE_UNITS.get(unit.get("name", ""))
        if base is None or expected is None:
            continue
        got = {name: integer(base.get(name)) for name in _EXPONENTS if integer(base.get(name))}
        radian_left_out = {k: e for k, e in expected.items() if k != "rad"}  # a radian is 1 as well
        if got not in (expected, radian_left_out):
            yield f"unit {unit.get('name')!r} is {_text(got)}: expected {_text(expected)}"


def _text(exponents: dict) -> str:
    return " ".join(f"{name}^{exponent}" for name, exponent in exponents.items()) or "1"


@rule(_CLAUSE, Stage.DESCRIPTION)
def unit_factors(fmu: FmuFile) -> Iterator[str]:
    """Factors of base units and display units are not zero, or nothing could be converted back."""
    for unit in fmu.root.iterfind("UnitDefinitions/Unit"):
        for element in unit.iterchildren("BaseUnit", "DisplayUnit"):
            if number(element.get("factor", "1")) == 0:
                yield f"unit {unit.get('name')!r}: {element.tag} with factor 0: expected another"
