"""Rules of variables one by one: names, causality, start values, ranges. FMI 2.0.5, 2.2.7 and 2.2.9."""

import math
import re
from collections.abc import Iterator

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Level, Stage, repeated, rule
from fmus.compliance.variable import INITIAL, Variable, integer

_CLAUSE = "2.2.7 Definition of Model Variables (ModelVariables)"
_RANGE = "2.2.3 Definition of Types (TypeDefinitions)"
_NAMING = "2.2.9 Variable Naming Conventions"
LONGEST_NAME = 55

_QUOTED = r"'(?:[^'\"\\\x00-\x1f]|\\['\"?\\abfnrtv])+'"
_PART = rf"(?:[A-Za-z_][A-Za-z0-9_]*|{_QUOTED})(?:\[[0-9]+(?:,[0-9]+)*\])?"
_IDENTIFIER = rf"{_PART}(?:\.{_PART})*"
_STRUCTURED = re.compile(rf"{_IDENTIFIER}|der\({_IDENTIFIER}(?:,[0-9]+)?\)")


@rule(_CLAUSE, Stage.DESCRIPTION)
def variable_names_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two variables have the same name."""
    for name, count in repeated(v.name for v in fmu.variables).items():
        yield f"{count} variables are called {name!r}: expected one"


@rule(_NAMING, Stage.DESCRIPTION)
def variable_names_are_legal(fmu: FmuFile) -> Iterator[str]:
    """Names are not empty and on one line; with the structured convention they follow its grammar."""
    structured = fmu.root.get("variableNamingConvention") == "structured"
    for v in fmu.variables:
        if not v.name or re.search(r"[\r\n\t]", v.name):
            yield f"variable {v.index}, {v.name!r}: expected a name without tab or line break"
        elif structured and not _STRUCTURED.fullmatch(v.name):
            yield f"{v.name!r}: expected a structured name such as tank.level[1] or der(x)"


@rule("not FMI: Simulink truncates identifiers beyond 63 characters", Stage.DESCRIPTION, Level.WARNING)
def variable_names_are_short(fmu: FmuFile) -> Iterator[str]:
    """Names have at most 55 characters, so that importers can put something before them."""
    for v in fmu.variables:
        if len(v.name) > LONGEST_NAME:
            yield f"{v.name} has {len(v.name)} characters: expected at most {LONGEST_NAME}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def variables_have_a_type(fmu: FmuFile) -> Iterator[str]:
    """Each variable has a type, and a value reference from 0 to 2^32 - 1."""
    for v in fmu.variables:
        if not v.kind:
            yield f"{v.name}: no type; expected Real, Integer, Boolean, String or Enumeration"
        if v.reference is None:
            yield f"{v.name}: value reference {v.attributes.get('valueReference')!r}: expected 0..4294967295"


@rule(_CLAUSE, Stage.DESCRIPTION)
def causality_and_variability(fmu: FmuFile) -> Iterator[str]:
    """Causality and variability are one of the pairs that FMI allows; only Real is continuous."""
    for v in fmu.variables:
        if (v.causality, v.variability) not in INITIAL:
            yield f"{v.name}: causality {v.causality} with variability {v.variability}: expected a legal pair"
        elif v.variability == "continuous" and v.kind not in ("Real", ""):
            yield f"{v.name} is a continuous {v.kind}: expected another variability"


@rule(_CLAUSE, Stage.DESCRIPTION)
def initial_is_legal(fmu: FmuFile) -> Iterator[str]:
    """`initial` is what causality and variability allow."""
    for v in fmu.variables:
        stated, allowed = v.attributes.get("initial"), INITIAL.get((v.causality, v.variability))
        if stated is not None and allowed is not None and stated not in allowed:
            yield f"{v.name}: initial {stated}: expected {' or '.join(allowed) or 'none'}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def start_is_given(fmu: FmuFile) -> Iterator[str]:
    """Inputs and variables with initial exact or approx have a start value, no others."""
    for v in fmu.variables:
        needed = v.causality == "input" or v.initial in ("exact", "approx")
        if needed and v.start is None:
            yield f"{v.name} ({v.causality}, initial {v.initial or 'not stated'}): expected a start value"
        elif not needed and v.start is not None:
            yield f"{v.name} ({v.causality}, initial {v.initial or 'none'}) has start: expected none"


@rule(_RANGE, Stage.DESCRIPTION)
def numbers_are_finite(fmu: FmuFile) -> Iterator[str]:
    """Start, min, max and nominal of a Real are finite."""
    for v in fmu.variables:
        for attribute in ("start", "min", "max", "nominal") if v.kind == "Real" else ():
            if (v.get(attribute) or "").strip().lstrip("+-").lower() in ("inf", "nan"):
                yield f"{v.name}: {attribute} {v.get(attribute)}: expected a finite number"


@rule(_RANGE, Stage.DESCRIPTION)
def range_is_not_empty(fmu: FmuFile) -> Iterator[str]:
    """max is not less than min."""
    for v in fmu.variables:
        low, high = v.number("min"), v.number("max")
        if low is not None and high is not None and high < low:
            yield f"{v.name}: max {high:.12g}: expected at least min, {low:.12g}"


@rule(_RANGE, Stage.DESCRIPTION)
def start_is_in_range(fmu: FmuFile) -> Iterator[str]:
    """A start value is not less than min and not more than max."""
    for v in fmu.variables:
        low, value, high = v.number("min"), v.number("start"), v.number("max")
        too_low = value is not None and low is not None and value < low
        if too_low or (value is not None and high is not None and value > high):
            limits = f"{-math.inf if low is None else low:.12g}..{math.inf if high is None else high:.12g}"
            yield f"{v.name}: start {value:.12g}: expected {limits}"


@rule(_RANGE, Stage.DESCRIPTION, Level.WARNING)
def nominal_is_positive(fmu: FmuFile) -> Iterator[str]:
    """A nominal value is positive, as importers divide by it."""
    for v in fmu.variables:
        nominal = v.number("nominal")
        if nominal is not None and nominal <= 0:
            yield f"{v.name}: nominal {nominal:g}: expected more than 0"


@rule(_CLAUSE, Stage.DESCRIPTION)
def declared_type_fits(fmu: FmuFile) -> Iterator[str]:
    """declaredType is defined and of the variable's own type; an Enumeration has one."""
    for v in fmu.variables:
        name = v.typed.get("declaredType")
        if name is None and v.kind == "Enumeration":
            yield f"{v.name} is an Enumeration: expected a declaredType"
        elif name is not None and name not in fmu.types:
            yield f"{v.name}: declaredType {name!r}: expected one of {', '.join(fmu.types) or 'none'}"
        elif name is not None and fmu.types[name].tag != v.kind:
            yield f"{v.name} is {v.kind}: expected a type of that kind, got {name!r}, {fmu.types[name].tag}"


@rule(_RANGE, Stage.DESCRIPTION)
def enumeration_start_is_an_item(fmu: FmuFile) -> Iterator[str]:
    """Start value, min and max of an Enumeration are values of its items."""
    for v in fmu.variables:
        declared = fmu.types.get(v.typed.get("declaredType", "")) if v.kind == "Enumeration" else None
        if declared is None or declared.tag != "Enumeration":
            continue
        values = {integer(item.get("value")) for item in declared.iterfind("Item")}
        for attribute in ("start", "min", "max"):
            value = integer(v.typed.get(attribute))
            if value is not None and value not in values:
                known = ", ".join(
                    str(value) for value in sorted(value for value in values if value is not None)
                )
                yield f"{v.name}: {attribute} {value}: expected one of {known}"


@rule(_CLAUSE, Stage.DESCRIPTION)
def one_independent_variable(fmu: FmuFile) -> Iterator[str]:
    """At most one variable is independent; it is a Real."""
    independent: list[Variable] = [v for v in fmu.variables if v.causality == "independent"]
    if len(independent) > 1:
        yield f"{', '.join(v.name for v in independent)} are independent: expected one at most"
    for v in independent:
        if v.kind != "Real":
            yield f"{v.name} is independent and {v.kind}: expected Real"


@rule(_CLAUSE, Stage.DESCRIPTION)
def derivative_is_of_a_variable(fmu: FmuFile) -> Iterator[str]:
    """The attribute derivative is the index of another variable, both continuous Real."""
    for v in fmu.variables:
        if "derivative" not in v.typed:
            continue
        index = integer(v.typed["derivative"])
        if index is None or not 1 <= index <= len(fmu.variables) or index == v.index:
            yield f"{v.name}: derivative {v.typed['derivative']}: expected another variable's index"
        elif fmu.variables[index - 1].kind != "Real" or v.variability != "continuous":
            yield f"{v.name}: derivative of {fmu.variables[index - 1].name}: expected continuous Reals"
