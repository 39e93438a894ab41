"""Rules of the model description but for variables: head, units, types. FMI 2.0.5, 2.2 and 4.3.1."""

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from fmus.block.units import BASE_UNITS
from fmus.compliance.fmu_file import C_IDENTIFIER, DESCRIPTION, FmuFile, schema_errors
from fmus.compliance.rows import add_rows, alike, anything, elements, owner, repeats, row, told
from fmus.compliance.rule import Stage, rule
from fmus.compliance.rules.archive import unreadable
from fmus.compliance.rules.files import BUILD_DESCRIPTION, TERMINALS
from fmus.compliance.variable import Variable, integer, is_true, number
from fmus.errors import nearest

_DESCRIPTION = "2.2 FMI Description Schema"
_HEAD = "2.2.1 Definition of an FMU (fmiModelDescription)"
_CATEGORIES = "2.2.4 Definition of Log Categories (LogCategories)"
_EXPERIMENT = "2.2.5 Definition of a Default Experiment (DefaultExperiment)"
_VARIABLES = "2.2.7 Definition of Model Variables (ModelVariables)"
_UNITS = "2.2.2 Definition of Units (UnitDefinitions)"
_TYPES = "2.2.3 Definition of Types (TypeDefinitions)"
_FLAGS = "4.3.1 Co-Simulation FMU (CoSimulation), 3.3.1 Model Exchange FMU (ModelExchange)"
_DATE = re.compile(r"\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])T([01]\d|2[0-3]):[0-5]\d:[0-5]\dZ")
_UTF_8 = re.compile(
    rb"(\xef\xbb\xbf)?<\?xml[^>\r\n]*[ \t]encoding[ \t]*=[ \t]*[\"']utf-8[\"']", re.IGNORECASE
)
_NO_NUMBER = re.compile(r"\s*[+-]?(?:inf|infinity|nan)\s*", re.IGNORECASE)
_NUMBERS = {  # elements -> attributes of type xs:double
    "TypeDefinitions/SimpleType/Real": ("min", "max", "nominal"),
    "ModelVariables/ScalarVariable/Real": ("start", "min", "max", "nominal"),
    "UnitDefinitions/Unit/*": ("factor", "offset"),
    "DefaultExperiment": ("startTime", "stopTime", "tolerance", "stepSize"),
}
_STANDARD_CATEGORIES = (
    "logEvents", "logSingularLinearSystems", "logNonlinearSystems", "logDynamicStateSelection",
    "logStatusWarning", "logStatusDiscard", "logStatusError", "logStatusFatal", "logStatusPending", "logAll",
)  # fmt: skip
_ENUMERATIONS = "TypeDefinitions/SimpleType/Enumeration"
_EXPONENTS = ("kg", "m", "s", "A", "K", "mol", "cd", "rad")


@rule(_DESCRIPTION, Stage.FILE, condition=unreadable)
def description_is_readable(fmu: FmuFile) -> Iterable[str]:
    """modelDescription.xml is well-formed XML without a document type declaration."""
    return {fmu.description_problem} - {"", fmu.NO_DESCRIPTION}


@rule(_HEAD, Stage.FILE, condition=lambda fmu: fmu.description_problem and "there is no description to read")
def fmi_version(fmu: FmuFile) -> Iterable[str]:
    """fmiVersion is 2.0."""
    return {fmu.other_version} - {""}


@rule(_DESCRIPTION, Stage.DESCRIPTION)
def description_is_utf_8(fmu: FmuFile) -> Iterator[str]:
    """The first line of the model description states the encoding UTF-8."""
    return _other_encodings({DESCRIPTION: fmu.xml})


@rule(_DESCRIPTION, Stage.FILE, condition=unreadable)
def other_xml_is_utf_8(fmu: FmuFile) -> Iterator[str]:
    """The first line of buildDescription.xml and of terminalsAndIcons.xml states the encoding UTF-8."""
    return _other_encodings({path: fmu.read(path) for path in {BUILD_DESCRIPTION, TERMINALS} & fmu.paths})


def _other_encodings(contents: Mapping[str, bytes]) -> Iterator[str]:
    for path, content in contents.items():
        if not _UTF_8.match(content):
            yield f'{path} begins {content[:40]!r}: expected <?xml version="1.0" encoding="UTF-8"?>'


@rule(_DESCRIPTION, Stage.DESCRIPTION)
def schema(fmu: FmuFile) -> Iterator[str]:
    """The model description is valid by the XML schema of FMI 2.0."""
    for error in schema_errors(fmu.root, "fmi2/fmi2ModelDescription.xsd"):
        yield f"line {error.line}: {error.message}"


@rule(_DESCRIPTION, Stage.DESCRIPTION)
def numbers_are_finite(fmu: FmuFile) -> Iterator[str]:
    """No number is infinite or NaN."""
    for path, attributes in _NUMBERS.items():
        for element, attribute in itertools.product(fmu.root.iterfind(path), attributes):
            if _NO_NUMBER.fullmatch(element.get(attribute, "")):
                text = f"{attribute}={element.get(attribute)!r}"
                yield f"line {element.sourceline}: {element.tag} has {text}: expected a finite number"


@rule(_HEAD, Stage.DESCRIPTION)
def interfaces(fmu: FmuFile) -> Iterator[str]:
    """There is an element ModelExchange or CoSimulation, each at most once."""
    tags = [element.tag for element in fmu.root.iterchildren("ModelExchange", "CoSimulation")]
    if not tags:
        yield "neither ModelExchange nor CoSimulation: expected one of them at least"
    yield from told(fmu, repeats(tags), (anything, "{count} elements {name}: expected one"))


def _standard_category(category: Any, _: FmuFile) -> str:
    """Returns the standardized name that a log category means and does not have, if so."""
    name = category.get("name", "")
    standard = {name.lower(): name for name in _STANDARD_CATEGORIES}
    expected = standard.get(name.replace("_", "").replace(" ", "").lower(), name)
    return "" if expected == name else str(expected)


class _Positive(NamedTuple):
    """Size of something in the default experiment that should be above 0; what is wrong if it is not."""

    size: float
    text: str


def _experiment(fmu: FmuFile) -> Iterator[_Positive]:
    for experiment in fmu.root.iterfind("DefaultExperiment"):
        begin, end = experiment.get("startTime", "0"), experiment.get("stopTime", "inf")
        span = (number(end) or 0.0) - (number(begin) or 0.0) if number(end) is not None else math.inf
        yield _Positive(span, f"stopTime {end}: expected more than startTime {begin}")
        sizes = {name: number(experiment.get(name)) for name in ("stepSize", "tolerance")}
        for name, size in sizes.items():
            if size is not None:
                yield _Positive(size, f"{name} {size:g}: expected more than 0")
        if 0 < span < (sizes["stepSize"] or 0.0):
            text = f"stepSize {sizes['stepSize']:g}: expected at most the time from start to stop, {span:g} s"
            yield _Positive(0.0, text)


class _Use(NamedTuple):
    """Use of a unit by a type, or by a variable, which inherits from its type."""

    user: str
    unit: str | None
    display: str | None


def _uses(fmu: FmuFile) -> Iterator[_Use]:
    for real in fmu.root.iterfind("TypeDefinitions/SimpleType/Real"):
        yield _Use(f"type {owner(real)}", real.get("unit"), real.get("displayUnit"))
    for v in fmu.variables:
        if "unit" in v.typed or "displayUnit" in v.typed:
            yield _Use(v.name, v.get("unit"), v.get("displayUnit"))


def _unknown_display_unit(use: _Use, fmu: FmuFile) -> str:
    if use.display is None or use.unit is None or use.unit not in fmu.units:
        return ""
    known = [display.get("name", "") for display in fmu.units[use.unit].iterfind("DisplayUnit")]
    return "" if use.display in known else nearest(use.display, known)


def _unused(defined: Mapping[str, Any], used: set[str | None]) -> list[str]:
    """Returns the names that nothing uses; none if an undefined one is used, which may mean one of them."""
    return [name for name in defined if name not in used] if used - {None} <= defined.keys() else []


def _other_exponents(unit: Any, _: FmuFile) -> str:
    """Returns what a unit is and what it should be by its name, if these are not the same."""
    base, expected = unit.find("BaseUnit"), BASE_UNITS.get(unit.get("name", ""))
    if base is None or expected is None:
        return ""
    got = {name: integer(base.get(name, "0")) for name in _EXPONENTS}
    is_other = any(got[name] not in (None, expected.get(name, 0)) for name in _EXPONENTS if name != "rad")
    return f"{_product(got)}: expected {_product(expected)}" if is_other else ""


def _product(exponents: Mapping[Any, Any]) -> str:
    return " ".join(f"{name}^{exponent}" for name, exponent in exponents.items() if exponent) or "1"


def _type_names(fmu: FmuFile) -> list[str]:
    return [element.get("name", "") for element in fmu.root.iterfind("TypeDefinitions/SimpleType")]


def _limited(fmu: FmuFile) -> list[Variable]:
    """Returns types, as if they were variables, and variables that state limits; these inherit from types."""
    types = [Variable(0, {"name": f"type {name}"}, "", dict(e.attrib), {}) for name, e in fmu.types.items()]
    return [v for v in (*types, *fmu.variables) if v.typed.keys() & {"min", "max", "nominal"}]


def _starts_outside(v: Variable, _: FmuFile) -> bool:
    start = number(v.start)
    return start is not None and v.low <= v.high and not v.low <= start <= v.high


def _items(v: Variable) -> str:
    return ", ".join(map(str, sorted(v.items))) or "its items, which have no values"


def _enumerations(fmu: FmuFile) -> Iterator[Variable]:
    """Yields the variables with items."""
    for v in _declaring(fmu):
        declared = fmu.types.get(v.typed["declaredType"])
        if declared is not None and v.kind == declared.tag == "Enumeration":
            yield v


def _declaring(fmu: FmuFile) -> list[Variable]:
    return [v for v in fmu.variables if "declaredType" in v.typed]


def _undefined_type(v: Variable, fmu: FmuFile) -> str:
    name = v.typed["declaredType"]
    return nearest(name, fmu.types) if name not in fmu.types else ""


def _other_kind(v: Variable, fmu: FmuFile) -> str:
    """Returns the kind of the declared type, if it is not that of the variable."""
    tag = fmu.types[v.typed["declaredType"]].tag
    return tag if tag != v.kind else ""


add_rows(__name__, _HEAD, Stage.DESCRIPTION, rows=(
    row("name-and-guid-are-given",
        "modelName and guid, which ties description and library together, are not empty.", elements("."),
        (lambda root, _: not root.get("modelName", "-").strip(), "modelName is empty: expected one"),
        (lambda root, _: not root.get("guid", "-").strip(), "guid is empty: expected one")),
    row("generation-date", "generationDateAndTime is a date in UTC, YYYY-MM-DDThh:mm:ssZ.",
        elements(".[@generationDateAndTime]"),
        (lambda root, _: not _DATE.fullmatch(root.get("generationDateAndTime")),
         "generationDateAndTime {generationDateAndTime!r}: expected such as 2026-01-31T12:00:00Z")),
    row("log-categories-are-unique", "No two log categories have the same name.",
        alike("LogCategories", "Category"),
        (anything, "log category {name!r} is defined {count} times: expected once"), clause=_CATEGORIES),
    row("log-category-names", "A standardized log category has its standardized name.",
        elements("LogCategories/Category"),
        (_standard_category, "log category {name!r}: expected {value}, the standardized name"),
        clause=_CATEGORIES),
    row("log-category-descriptions",
        "The description of a log category, where there is one, is not empty.",
        elements("LogCategories/Category"),
        (lambda category, _: not category.get("description", "-").strip(),
         "log category {name!r} has an empty description: expected one or none"), clause=_CATEGORIES),
    row("default-experiment",
        "The default experiment does not stop before it starts; step size and tolerance are not negative.",
        _experiment, (lambda limit, _: limit.size < 0, "{text}"), clause=_EXPERIMENT),
    row("default-experiment-is-meaningful",
        "The default experiment takes a step at least; its step size and tolerance are not 0.",
        _experiment, (lambda limit, _: limit.size == 0, "{text}"), clause=_EXPERIMENT),
    row("annotations-are-unique",
        "No two annotations of the FMU, or of one variable, are of one tool.",
        lambda fmu: (*alike("VendorAnnotations", "Tool")(fmu),
                     *alike("ModelVariables/ScalarVariable/Annotations", "Tool")(fmu)),
        (anything, "{place}: tool {name!r} occurs {count} times: expected once"),
        clause="2.2.6 Definition of Vendor Annotations (VendorAnnotations)"),
    row("model-identifier",
        "modelIdentifier is a C identifier, as it names files and the prefix of functions.",
        elements("*[@modelIdentifier]"),
        (lambda interface, _: not C_IDENTIFIER.fullmatch(interface.get("modelIdentifier")),
         "{subject.tag} modelIdentifier {modelIdentifier!r}: expected letters, digits and _, no digit first"),
        clause=_FLAGS),
    row("capabilities-agree", "canSerializeFMUstate only with canGetAndSetFMUstate.",
        elements("*[@canSerializeFMUstate]"),
        (lambda i, _: is_true(i.get("canSerializeFMUstate")) and not is_true(i.get("canGetAndSetFMUstate")),
         "{subject.tag} has canSerializeFMUstate: expected canGetAndSetFMUstate too"), clause=_FLAGS),
))  # fmt: skip
add_rows(__name__, _UNITS, Stage.DESCRIPTION, rows=(
    row("unit-names-are-unique", "No two units have the same name.", alike("UnitDefinitions", "Unit"),
        (anything, "unit {name!r} is defined {count} times: expected once")),
    row("display-unit-names-are-unique", "No two display units of one unit have the same name.",
        alike("UnitDefinitions/Unit", "DisplayUnit"),
        (anything, "display unit {name!r} of {owner!r} is defined {count} times: expected once")),
    row("units-are-defined",
        "Each unit of a type or variable is defined; none has a display unit without unit.", _uses,
        (lambda use, fmu: use.unit is not None and use.unit not in fmu.units and nearest(use.unit, fmu.units),
         "{user}: unit {unit!r} is not defined; {value}"),
        (lambda use, _: use.display is not None and use.unit is None,
         "{user}: displayUnit {display!r} without unit: expected both or none"), clause=_TYPES),
    row("display-units-are-defined",
        "Each display unit belongs to its unit; otherwise importers ignore it.", _uses,
        (_unknown_display_unit, "{user}: displayUnit {display!r} of {unit!r} is ignored; {value}"),
        clause=_TYPES),
    row("units-are-used", "Each unit that is defined is used by a type or variable.",
        lambda fmu: _unused(fmu.units, {use.unit for use in _uses(fmu)}),
        (anything, "unit {subject!r} is used by no type and no variable: expected it to be, or left out")),
    row("unit-exponents",
        "A unit whose name means a coherent SI unit has the exponents of that unit; rad may be left out.",
        elements("UnitDefinitions/Unit"), (_other_exponents, "unit {name!r} is {value}"),
        clause="advice: the usual meaning of names of units"),
    row("unit-factors",
        "Factors of base units and display units are not 0, or nothing could be converted back.",
        elements("UnitDefinitions/Unit/*"),
        (lambda e, _: number(e.get("factor", "1")) == 0 and f"unit {owner(e.getparent())!r}: {e.tag}",
         "{value} with factor 0: expected another")),
))  # fmt: skip
add_rows(__name__, _TYPES, Stage.DESCRIPTION, rows=(
    row("type-names", "Names of types are unique, and differ from those of variables.",
        lambda fmu: repeats([*_type_names(fmu), *{v.name for v in fmu.variables} & {*_type_names(fmu)}]),
        (anything, "{count} types or variables are called {name!r}: expected other names")),
    row("enumeration-items", "Items of an enumeration have names and values that occur once.",
        lambda fmu: (*alike(_ENUMERATIONS, "Item")(fmu), *alike(_ENUMERATIONS, "Item", "value")(fmu)),
        (anything, "enumeration {owner!r}: {count} items have {attribute} {name!r}: expected one")),
    row("types-are-used", "Each type that is defined is the declared type of a variable.",
        lambda fmu: _unused(fmu.types, {v.typed.get("declaredType") for v in fmu.variables}),
        (anything, "type {subject!r} is declared by no variable: expected it to be, or left out")),
    row("range-is-not-empty", "max is not less than min.", _limited,
        (lambda v, _: v.high < v.low, "{name}: max {high:.17g}: expected at least min, {low:.17g}")),
    row("nominal-is-positive", "A nominal value is more than 0.", _limited,
        (lambda v, _: v.nominal <= 0, "{name}: nominal {nominal:g}: expected more than 0")),
    row("start-is-in-range", "A start value is not less than min and not more than max.",
        lambda fmu: fmu.variables,
        (_starts_outside, "{name}: start {start}: expected {low:.17g}..{high:.17g}"), clause=_VARIABLES),
    row("declared-type-fits", "declaredType is defined, and of the variable's own type.", _declaring,
        (_undefined_type, "{name}: declaredType {typed[declaredType]!r} is not defined; {value}"),
        (_other_kind,
         "{name} is {kind}: expected a type of that kind, got {typed[declaredType]!r}, {value}"),
        clause=_VARIABLES),
    row("enumeration-start-is-an-item", "The start value of an Enumeration is the value of an item.",
        _enumerations,
        (lambda v, _: integer(v.start) not in {*v.items, None} and _items(v),
         "{name}: start {start}: expected one of {value}"), clause=_VARIABLES),
    row("enumeration-range-holds-an-item", "Between min and max of an Enumeration there is an item.",
        _enumerations,
        (lambda v, _: v.low <= v.high and not any(v.low <= x <= v.high for x in v.items) and _items(v),
         "{name}: min {low:g}, max {high:g}: expected an item between, of {value}"), clause=_VARIABLES),
))  # fmt: skip
