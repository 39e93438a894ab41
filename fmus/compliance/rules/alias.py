"""Rules of variables that share a value reference: alias sets, FMI 2.0.5, 2.2.7."""

from collections.abc import Iterator
from functools import lru_cache

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, rule
from fmus.compliance.variable import Variable, integer, is_true

_CLAUSE = "2.2.7 Definition of Model Variables (ModelVariables), alias variables"


@lru_cache(maxsize=1)
def _sets(fmu: FmuFile) -> tuple[list[Variable], ...]:
    """Returns the variables of one base type with one value reference, where there are several."""
    sets: dict[tuple[str, int | None], list[Variable]] = {}
    for v in fmu.variables:
        if v.reference is not None and v.kind:
            sets.setdefault((v.base_kind, v.reference), []).append(v)
    return tuple(members for members in sets.values() if len(members) > 1)


def _names(members: list[Variable]) -> str:
    return f"{', '.join(v.name for v in members)} (value reference {members[0].reference})"


@rule(_CLAUSE, Stage.DESCRIPTION)
def alias_units(fmu: FmuFile) -> Iterator[str]:
    """Variables of an alias set have the same unit, or none of them has one."""
    for members in _sets(fmu):
        units = {v.get("unit") for v in members}
        if len(units) > 1:
            yield f"{_names(members)}: expected one unit, got {', '.join(sorted(map(str, units)))}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def alias_settable_once(fmu: FmuFile) -> Iterator[str]:
    """At most one variable of an alias set can be set, and so has a start value; none beside the
    independent variable."""
    for members in _sets(fmu):
        chosen = [v for v in members if v.is_settable or v.causality == "independent"]
        if len(chosen) > 1:
            yield f"{_names(chosen)}: expected at most one that can be set or is independent"


@rule(_CLAUSE, Stage.DESCRIPTION)
def alias_constants(fmu: FmuFile) -> Iterator[str]:
    """In an alias set all variables are constant, with the same start value, or none is."""
    for members in _sets(fmu):
        constant = [v for v in members if v.variability == "constant"]
        if constant and len(constant) < len(members):
            yield f"{_names(members)}: expected all constant or none, got {len(constant)} constant"
        elif len({_value(v) for v in constant}) > 1:
            values = ", ".join(str(v.start) for v in constant)
            yield f"{_names(members)} are constant: expected one start value, got {values}"


def _value(v: Variable) -> float | int | bool | str | None:
    if v.base_kind == "Real":
        return v.number("start")
    if v.base_kind == "Boolean":
        return is_true(v.start)
    return integer(v.start) if v.base_kind == "Integer" else v.start


@rule(_CLAUSE, Stage.DESCRIPTION)
def alias_variability(fmu: FmuFile) -> Iterator[str]:
    """Variables of an alias set without input and parameter have the same variability."""
    for members in _sets(fmu):
        kinds = {v.variability for v in members} - {"constant"}
        if len(kinds) > 1 and not any(v.causality in ("input", "parameter", "independent") for v in members):
            yield f"{_names(members)} are {', '.join(sorted(kinds))}: expected the highest for all"
