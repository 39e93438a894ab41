"""Rules of types and of the ranges of variables: FMI 2.0.5, 2.2.3 Definition of Types (TypeDefinitions)."""

import math
from collections.abc import Iterator

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.variable import integer, number
from fmus.errors import nearest

_CLAUSE = "2.2.3 Definition of Types (TypeDefinitions)"
_VARIABLES = "2.2.7 Definition of Model Variables (ModelVariables)"


def _limits(fmu: FmuFile) -> Iterator[tuple[str, dict[str, float | None]]]:
    """Yields (type or variable, its min, max and nominal), each once; a variable inherits from its type."""
    names = ("min", "max", "nominal")
    for name, element in fmu.types.items():
        yield f"type {name}", {attribute: number(element.get(attribute)) for attribute in names}
    for v in fmu.variables:
        if any(attribute in v.typed for attribute in names):
            yield v.name, {attribute: v.number(attribute) for attribute in names}


@rule(_CLAUSE, Stage.DESCRIPTION)
def type_names(fmu: FmuFile) -> Iterator[str]:
    """Names of types are unique, and differ from those of variables."""
    names = [element.get("name", "") for element in fmu.root.iterfind("TypeDefinitions/SimpleType")]
    for name, count in repeated(names).items():
        yield f"type {name!r} is defined {count} times: expected once"
    for name in sorted({v.name for v in fmu.variables} & set(names)):
        yield f"type {name!r} is called like a variable: expected another name"


@rule(_CLAUSE, Stage.DESCRIPTION)
def types_are_used(fmu: FmuFile) -> Iterator[str]:
    """Each type that is defined is the declared type of a variable."""
    used = {v.typed.get("declaredType") for v in fmu.variables} - {None}
    unused = [name for name in fmu.types if name not in used]
    for name in unused if used <= fmu.types.keys() else ():  # otherwise one of them may be meant
        yield f"type {name!r} is declared by no variable: expected it to be, or left out"


@rule(_CLAUSE, Stage.DESCRIPTION)
def enumeration_items(fmu: FmuFile) -> Iterator[str]:
    """Items of an enumeration have names and values that occur once."""
    for name, kind in fmu.types.items():
        items = kind.findall("Item") if kind.tag == "Enumeration" else []
        for item, count in repeated(element.get("name") for element in items).items():
            yield f"enumeration {name!r}: item {item!r} is defined {count} times: expected once"
        values = [integer(element.get("value")) for element in items]
        for value, count in repeated(value for value in values if value is not None).items():
            yield f"enumeration {name!r}: {count} items have value {value}: expected one"


@rule(_CLAUSE, Stage.DESCRIPTION)
def range_is_not_empty(fmu: FmuFile) -> Iterator[str]:
    """max is not less than min."""
    for name, limits in _limits(fmu):
        low, high = limits["min"], limits["max"]
        if low is not None and high is not None and high < low:
            yield f"{name}: max {high:.17g}: expected at least min, {low:.17g}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def nominal_is_positive(fmu: FmuFile) -> Iterator[str]:
    """A nominal value is more than 0."""
    for name, limits in _limits(fmu):
        nominal = limits["nominal"]
        if nominal is not None and nominal <= 0:
            yield f"{name}: nominal {nominal:g}: expected more than 0"


@rule(_VARIABLES, Stage.DESCRIPTION)
def start_is_in_range(fmu: FmuFile) -> Iterator[str]:
    """A start value is not less than min and not more than max."""
    for v in fmu.variables:
        if v.kind not in ("Real", "Integer", "Enumeration"):
            continue
        low, value, high = v.number("min"), number(v.start), v.number("max")
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        if value is not None and low <= high and not low <= value <= high:
            yield f"{v.name}: start {value:.17g}: expected {low:.17g}..{high:.17g}"


@rule(_VARIABLES, Stage.DESCRIPTION)
def declared_type_fits(fmu: FmuFile) -> Iterator[str]:
    """declaredType is defined, and of the variable's own type."""
    for v in fmu.variables:
        name = v.typed.get("declaredType")
        if name is not None and name not in fmu.types:
            yield f"{v.name}: declaredType {name!r} is not defined; {nearest(name, fmu.types)}"
        elif name is not None and fmu.types[name].tag != v.kind:
            yield f"{v.name} is {v.kind}: expected a type of that kind, got {name!r}, {fmu.types[name].tag}"


def _items(fmu: FmuFile) -> Iterator[tuple[int, list[int]]]:
    """Yields (index of an Enumeration variable, sorted values of its items)."""
    for v in fmu.variables:
        declared = fmu.types.get(v.typed.get("declaredType", "")) if v.kind == "Enumeration" else None
        if declared is not None and declared.tag == "Enumeration":
            values = (integer(item.get("value")) for item in declared.iterfind("Item"))
            yield v.index, sorted(value for value in values if value is not None)


@rule(_VARIABLES, Stage.DESCRIPTION)
def enumeration_start_is_an_item(fmu: FmuFile) -> Iterator[str]:
    """The start value of an Enumeration is the value of an item."""
    for index, values in _items(fmu):
        v = fmu.variables[index - 1]
        start = integer(v.start)
        if start is not None and start not in values:
            listed = ", ".join(map(str, values)) or "its items, which have no values"
            yield f"{v.name}: start {start}: expected one of {listed}"


@rule(_VARIABLES, Stage.DESCRIPTION)
def enumeration_range_holds_an_item(fmu: FmuFile) -> Iterator[str]:
    """Between min and max of an Enumeration there is an item."""
    for index, values in _items(fmu):
        v = fmu.variables[index - 1]
        low, high = v.number("min"), v.number("max")
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        if low <= high and not any(low <= value <= high for value in values):
            listed = ", ".join(map(str, values)) or "which none has a value"
            yield f"{v.name}: min {low:g}, max {high:g}: expected an item between, of {listed}"
