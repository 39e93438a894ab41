"""Rules of variables that share a value reference: alias sets, FMI 2.0.5, 2.2.7."""

from collections.abc import Iterator

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, rule
from fmus.compliance.variable import Variable

_CLAUSE = "2.2.7 Definition of Model Variables (ModelVariables), alias variables"


def _sets(fmu: FmuFile) -> Iterator[list[Variable]]:
    """Variables of one base type with one value reference, where there are several."""
    sets: dict[tuple[str, int | None], list[Variable]] = {}
    for v in fmu.variables:
        if v.reference is not None:
            sets.setdefault((v.base_kind, v.reference), []).append(v)
    yield from (members for members in sets.values() if len(members) > 1)


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
    """At most one variable of an alias set can be set."""
    for members in _sets(fmu):
        settable = [v for v in members if v.is_settable]
        if len(settable) > 1:
            yield f"{_names(settable)}: expected at most one that can be set"


@rule(_CLAUSE, Stage.DESCRIPTION)
def alias_constants(fmu: FmuFile) -> Iterator[str]:
    """In an alias set all variables are constant, with the same start value, or none is."""
    for members in _sets(fmu):
        constant = [v for v in members if v.variability == "constant"]
        if constant and len(constant) < len(members):
            yield f"{_names(members)}: expected all constant or none, got {len(constant)} constant"
        elif len({v.number("start") if v.kind == "Real" else v.start for v in constant}) > 1:
            yield f"{_names(members)} are constant: expected one start value"
