"""Rules of the model description but for variables: head, units, types. FMI 2.0.5, 2.2 and 4.3.1."""

import math
import re
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any

from fmus.compliance.fmu_file import (
    C_IDENTIFIER,
    CO_SIMULATION,
    DESCRIPTION,
    MODEL_EXCHANGE,
    FmuFile,
    schema_errors,
)
from fmus.compliance.rows import add_rows, anything, elements, repeats, row
from fmus.compliance.rule import Stage, repeated, rule
from fmus.compliance.rules.archive import unreadable
from fmus.compliance.rules.files import BUILD_DESCRIPTION, TERMINALS
from fmus.compliance.variable import Variable, integer, is_true, number
from fmus.errors import nearest

_UTF_8 = re.compile(rb"(\xef\xbb\xbf)?<\?xml[^>\r\n]*[ \t]encoding[ \t]*=[ \t]*[\"']utf-8[\"']", re.I)
_NOT_UTF_8 = (
    lambda file, _: not _UTF_8.match(file[1]) and file[1][:40],
    '{subject[0]} begins {value!r}: expected <?xml version="1.0" encoding="UTF-8"?>',
)
_VARIABLE = "ModelVariables/ScalarVariable"
_NUMBERS = f"""(
    TypeDefinitions/SimpleType/Real | {_VARIABLE}/Real | UnitDefinitions/Unit/*
    | DefaultExperiment
)/@*[contains('|INF|-INF|NaN|', concat('|', normalize-space(), '|'))]"""
_RESERVED = re.compile(r"con|prn|aux|nul|(com|lpt)[1-9]", re.I)  # names of devices on Windows
_ROUNDED = 1e-4  # relative: tools write factors with as few as five digits, and wrong ones are far away
_DEGREES, _TURNS = math.degrees(1.0), 30 / math.pi  # in a radian, and in a minute at 1 rad/s
_DISPLAYED = {  # factor and offset of a display unit: it shows factor value + offset
    "degC of K": (1.0, -273.15), "degF of K": (1.8, -459.67), "deg of rad": (_DEGREES, 0.0),
    "deg/s of rad/s": (_DEGREES, 0.0), "rpm of rad/s": (_TURNS, 0.0), "rev/min of rad/s": (_TURNS, 0.0),
    "km/h of m/s": (3.6, 0.0), "mm of m": (1e3, 0.0), "cm of m": (1e2, 0.0), "km of m": (1e-3, 0.0),
    "bar of Pa": (1e-5, 0.0), "kPa of Pa": (1e-3, 0.0), "MPa of Pa": (1e-6, 0.0), "kW of W": (1e-3, 0.0),
    "min of s": (1 / 60, 0.0), "h of s": (1 / 3600, 0.0), "ms of s": (1e3, 0.0), "l of m3": (1e3, 0.0),
}  # fmt: skip
_TYPE_NAMES, _ITEM = "TypeDefinitions/*/@name", "TypeDefinitions//Item"
_INTERFACES = {2: (MODEL_EXCHANGE, CO_SIMULATION), 3: (MODEL_EXCHANGE, CO_SIMULATION, "ScheduledExecution")}


@rule("2.2", Stage.FILE, condition=unreadable)
def description_is_readable(fmu: FmuFile) -> Iterable[str]:
    """modelDescription.xml is well-formed XML without a document type declaration."""
    return {fmu.description_problem} - {"", fmu.NO_DESCRIPTION}


@rule("2.2.1", Stage.FILE, condition=lambda fmu: fmu.description_problem and "no description can be read")
def fmi_version(fmu: FmuFile) -> Iterable[str]:
    """fmiVersion is 2.0, or 3.0 for an FMU of that version."""
    is_known = fmu.version == "2.0" or fmu.is_fmi3
    return [] if is_known else [f"fmiVersion {fmu.version!r}: expected '2.0' or '3.0'"]


def _schema_problems(fmu: FmuFile) -> list[str]:
    errors = schema_errors(fmu.root, f"fmi{fmu.fmi}/fmi{fmu.fmi}ModelDescription.xsd")
    return [f"line {error.line}: {error.message}" for error in errors]


def _owner(element: Any, _: FmuFile | None = None) -> str:
    """Returns the name of the nearest element around one that has a name."""
    names = (one.get("name") or one.get("modelName") for one in element.iterancestors())
    return next(filter(None, names), "")


def _experiment(fmu: FmuFile) -> Iterator[tuple[float, str]]:
    """Yields what should be above 0 in the default experiment, with the message if it is not."""
    for experiment in fmu.root.iterfind("DefaultExperiment"):
        begin, end = number(experiment.get("startTime", "0")), number(experiment.get("stopTime"))
        span = None if end is None else end - (begin or 0.0)
        step, tolerance = number(experiment.get("stepSize")), number(experiment.get("tolerance"))
        if span is not None:
            yield span, f"stopTime {end:g}: expected more than startTime {begin or 0.0:g}"
        for name, size in (("stepSize", step), ("tolerance", tolerance)):
            if size is not None:
                yield size, f"{name} {size:g}: expected more than 0"
        if span is not None and step is not None and 0 < span < step:
            yield 0.0, f"stepSize {step:g}: expected at most the time from start to stop, {span:g} s"


def _stating(*attributes: str) -> Callable[[FmuFile], Iterator[Variable]]:
    """Returns the subjects of a row: types, as if they were variables, and variables that state an attribute;
    these inherit from types.
    """

    def subjects(fmu: FmuFile) -> Iterator[Variable]:
        types = (Variable(0, {"name": f"type {n}"}, "", dict(e.attrib), {}) for n, e in fmu.types.items())
        return (v for v in (*types, *fmu.variables) if v.typed.keys() & {*attributes})

    return subjects


_using_units, _limited = _stating("unit", "displayUnit"), _stating("min", "max", "nominal")


def _is_claimed(interface: Any, flag: str, fmu: FmuFile) -> bool:
    """Whether an interface has a flag, whose letter S is small in FMI 2.0."""
    return is_true(interface.get(flag.format("sS"[fmu.is_fmi3])))


def _unit_problem(v: Variable, fmu: FmuFile) -> str:
    unit, display = v.get("unit"), v.get("displayUnit")
    if unit is None:
        return "" if display is None else f"displayUnit {display!r} without unit: expected both or none"
    return "" if unit in fmu.units else f"unit {unit!r} is not defined; {nearest(unit, fmu.units)}"


def _display_unit_problem(v: Variable, fmu: FmuFile) -> str:
    unit, display = v.get("unit"), v.get("displayUnit")
    if unit not in fmu.units or display is None:
        return ""
    known = [element.get("name", "") for element in fmu.units[unit].iterfind("DisplayUnit")]
    return "" if display in known else f"{display!r} of {unit!r} is ignored; {nearest(display, known)}"


def _wrong_display_unit(display: Any, _: FmuFile) -> str:
    """Returns factor and offset of a display unit, and expected ones by its name, if they differ."""
    unit, pairs = display.getparent().get("name"), (("factor", "1"), ("offset", "0"))
    stated = [number(display.get(name, default)) or 0.0 for name, default in pairs]
    known = _DISPLAYED.get(f"{display.get('name')} of {unit}")
    # `unit-factors` reports a factor of 0
    if (
        not known
        or not stated[0]
        or is_true(display.get("inverse"))
        or all(map(partial(math.isclose, rel_tol=_ROUNDED), stated, known))
    ):
        return ""
    got, expected = (f"factor {factor:g} and offset {offset:g}" for factor, offset in (stated, known))
    return f"{unit!r} has {got}: expected {expected}"


def _starts_outside(v: Variable, _: FmuFile) -> str:
    """Returns the first start value that is outside of the range."""
    starts = ((text, number(text)) for text in v.starts if v.low <= v.high)
    return next((text for text, x in starts if x is not None and not v.low <= x <= v.high), "")


def _type_problem(v: Variable, fmu: FmuFile) -> str:
    name = v.typed["declaredType"]
    if name not in fmu.types:
        return f": declaredType {name!r} is not defined; {nearest(name, fmu.types)}"
    tag = fmu.types[name].tag.removesuffix("Type")
    return "" if tag == v.kind else f" is {v.kind}: expected a type of that kind, got {name!r}, {tag}"


add_rows(__name__, Stage.DESCRIPTION, rows=(
    row("description-is-utf-8", lambda fmu: [(DESCRIPTION, fmu.read(DESCRIPTION))], _NOT_UTF_8),
    row("other-xml-is-utf-8",
        lambda fmu: [
            (path, fmu.read(path))
            for path in fmu.names
            if path in (BUILD_DESCRIPTION, TERMINALS) or path.endswith("/fmi-ls-manifest.xml")
        ],
        _NOT_UTF_8),
    row("schema", _schema_problems, (anything, "{subject}")),
    row("numbers-are-finite", lambda fmu: fmu.root.xpath(_NUMBERS),
        (lambda text, _: [text.getparent()],
         "line {value[0].sourceline}: {value[0].tag} has {attrname}={subject!r}: expected a finite number")),
    row("interfaces",
        lambda fmu: [[element.tag for element in fmu.root.iterchildren(*_INTERFACES[fmu.fmi])]],
        (lambda tags, fmu: not tags and ", ".join(_INTERFACES[fmu.fmi]), "none of {value}: expected one"),
        (lambda tags, _: ", ".join(f"{n} elements {tag}" for tag, n in repeated(tags).items()),
         "{value}: expected one")),
    row("name-and-guid-are-given", elements("."),
        (lambda root, _: not root.get("modelName", "-").strip(), "modelName is empty: expected one"),
        (lambda root, _: not root.get("guid", "-").strip(), "guid is empty: expected one")),
    row("log-categories-are-unique", elements(repeats("LogCategories/Category")),
        (anything, "log category {name!r} is defined again in line {subject.sourceline}: expected once")),
    row("log-category-descriptions", elements("LogCategories/Category"),
        (lambda category, _: not category.get("description", "-").strip(),
         "log category {name!r} has an empty description: expected one or none")),
    row("default-experiment", _experiment, (lambda size, _: size[0] < 0, "{subject[1]}")),
    row("default-experiment-is-meaningful", _experiment, (lambda size, _: size[0] == 0, "{subject[1]}")),
    row("annotations-are-unique",
        elements(f"{repeats('VendorAnnotations/Tool')} | {repeats(f'{_VARIABLE}/Annotations/Tool')}"),
        (_owner, "{value}: tool {name!r} occurs again in line {subject.sourceline}: expected once")),
    row("model-identifier", elements("*[@modelIdentifier]"),
        (lambda interface, _: not C_IDENTIFIER.fullmatch(interface.get("modelIdentifier")),
         "{subject.tag} modelIdentifier {modelIdentifier!r}: expected letters, digits and _, no digit first"),
        (lambda interface, _: _RESERVED.fullmatch(interface.get("modelIdentifier")),
         "{subject.tag} modelIdentifier {modelIdentifier!r}: expected another, Windows reserves it")),
    row("capabilities-agree", elements("*[@canSerializeFMUstate or @canSerializeFMUState]"),
        (lambda i, fmu: _is_claimed(i, "canSerializeFMU{}tate", fmu)
         and not _is_claimed(i, "canGetAndSetFMU{}tate", fmu) and "sS"[fmu.is_fmi3],
         "{subject.tag} has canSerializeFMU{value}tate: expected canGetAndSetFMU{value}tate too")),
    row("unit-names-are-unique", elements(repeats("UnitDefinitions/Unit")),
        (anything, "unit {name!r} is defined again in line {subject.sourceline}: expected once")),
    row("display-unit-names-are-unique", elements(repeats("UnitDefinitions/Unit/DisplayUnit")),
        (_owner,
         "display unit {name!r} of {value!r} is defined again in line {subject.sourceline}: expected once")),
    row("units-are-defined", _using_units, (_unit_problem, "{name}: {value}")),
    row("display-units-are-defined", _using_units, (_display_unit_problem, "{name}: displayUnit {value}")),
    row("display-units-are-right", elements("UnitDefinitions/Unit/DisplayUnit"),
        (_wrong_display_unit, "display unit {name!r} of {value}")),
    row("unit-factors", elements("UnitDefinitions/Unit/*"),
        (lambda e, _: number(e.get("factor", "1")) == 0 and f"unit {_owner(e)!r}: {e.tag}",
         "{value} with factor 0: expected another")),
    row("type-names",
        lambda fmu: repeated([*fmu.root.xpath(_TYPE_NAMES), *{v.name for v in fmu.variables}]).items(),
        (anything, "{subject[1]} types or variables are called {subject[0]!r}: expected other names")),
    row("enumeration-items", elements(f"{repeats(_ITEM)}/@name | {repeats(_ITEM, 'value')}/@value"),
        (lambda text, _: [_owner(text.getparent())],
         "enumeration {value[0]!r}: several items have {attrname} {subject!r}: expected one")),
    row("range-is-not-empty", _limited,
        (lambda v, _: v.high < v.low, "{name}: max {high:.17g}: expected at least min, {low:.17g}")),
    row("nominal-is-positive", _limited,
        (lambda v, _: v.nominal <= 0, "{name}: nominal {nominal:g}: expected more than 0")),
    row("start-is-in-range", lambda fmu: fmu.variables,
        (_starts_outside, "{name}: start {value}: expected {low:.17g}..{high:.17g}")),
    row("declared-type-fits", lambda fmu: [v for v in fmu.variables if "declaredType" in v.typed],
        (_type_problem, "{name}{value}")),
    row("enumeration-start-is-an-item", lambda fmu: [v for v in fmu.variables if v.items],
        (lambda v, _: {*map(integer, v.starts)} - {*v.items, None} and sorted(v.items),
         "{name}: start {start}: expected one of {value}")),
    row("enumeration-range-holds-an-item", lambda fmu: [v for v in fmu.variables if v.items],
        (lambda v, _: v.low <= v.high and not any(v.low <= x <= v.high for x in v.items) and sorted(v.items),
         "{name}: min {low:g}, max {high:g}: expected an item between, one of {value}")),
))  # fmt: skip
