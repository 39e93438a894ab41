"""The model description of an FMI 3.0 FMU for co-simulation in the objects of FMI 2.0 (FMI 3.0.2, 2.4).

Arrays become scalars, row by row: `m[1,2]` is an element of `m`. The value reference of a scalar is its index
in `ModelDescription.elements`. Variables of types without an equivalent in FMI 2.0 are left out.
"""

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import fields
from itertools import product
from xml.etree.ElementTree import Element as Xml

from fmus.fmi.model_description import (
    INITIAL,
    CoSimulation,
    Element,
    ModelDescription,
    ScalarVariable,
    SimpleType,
    Unknown,
    attributes_of,
    declared_type,
    interface_of,
    is_relative,
    items,
    required,
    value_reference,
    with_solver,
)
from fmus.fmi.variable_types import INTEGER_RANGE

_, _HIGH = INTEGER_RANGE
# types by the functions that transfer them, in the order of fmi3_calls.c: the least and the largest value
_RANGES = {
    "Float64": None,
    "Float32": None,
    "Int8": (-(2**7), 2**7 - 1),
    "UInt8": (0, 2**8 - 1),
    "Int16": (-(2**15), 2**15 - 1),
    "UInt16": (0, 2**16 - 1),
    "Int32": INTEGER_RANGE,
    "UInt32": (0, _HIGH),
    "Int64": INTEGER_RANGE,
    "UInt64": (0, _HIGH),
    "Boolean": None,
    "String": None,
}
TYPES = tuple(_RANGES)
_LEFT_OUT = ("Binary", "Clock")
_CAPABILITIES = {
    "canGetAndSetFMUstate": "canGetAndSetFMUState",
    "canSerializeFMUstate": "canSerializeFMUState",
}
_MOST_SCALARS = 1_000_000


def fmi3_description(root: Xml) -> ModelDescription:
    """Returns the content of a modelDescription.xml; ValueError names the part that cannot be read."""
    interface, is_model_exchange = interface_of(root)
    types = {declared.name: declared for declared in map(_simple_type, root.findall("TypeDefinitions/*"))}
    elements: list[Element] = []
    variables: list[ScalarVariable] = []
    by_reference: dict[int, list[ScalarVariable]] = {}
    listed = root.findall("ModelVariables/*")
    sizes = {v.get("valueReference"): v.get("start") for v in listed if v.tag == "UInt64"}
    left_out = {required(xml, "name"): kind for xml in listed if (kind := _left_out(xml))}
    for xml in listed:
        if not _left_out(xml):
            reference, shape = value_reference(xml), _shape(xml, sizes)
            first, count = len(variables), math.prod(shape)
            if first + count > _MOST_SCALARS:
                raise ValueError(
                    f"variable {xml.get('name')}: expected at most {_MOST_SCALARS} scalars in all"
                )
            kind = _index(xml)
            variables += _scalars(xml, shape, first, types)
            elements += (Element(kind, reference, first, count, _start(v)) for v in variables[first:])
            by_reference[reference] = variables[first:]
    return ModelDescription(
        **attributes_of(root),
        guid=root.get("instantiationToken", ""),
        coSimulation=_co_simulation(interface, is_model_exchange),
        modelVariables=variables,
        outputs=[*_unknowns(root, "Output", by_reference)],
        initialUnknowns=[*_unknowns(root, "InitialUnknown", by_reference)],
        numberOfContinuousStates=len([*_unknowns(root, "ContinuousStateDerivative", by_reference)]),
        numberOfEventIndicators=len([*_unknowns(root, "EventIndicator", by_reference)]),
        is_model_exchange=is_model_exchange,
        elements=elements,
        left_out=left_out,
    )


def _left_out(xml: Xml) -> str:
    """Returns the type of a variable without an equivalent in FMI 2.0, "" for any other."""
    # 2.2.8: a clocked variable has a value only while its Clock is active, in event mode
    return f"{xml.tag} of a Clock" if xml.get("clocks") else xml.tag if xml.tag in _LEFT_OUT else ""


def _index(xml: Xml) -> int:
    """Returns the index in `TYPES` of the type whose functions transfer a variable."""
    name = "Int64" if xml.tag == "Enumeration" else xml.tag
    if name not in TYPES:
        known = ", ".join((*TYPES, "Enumeration"))
        raise ValueError(f"variable {xml.get('name')}: type {name!r}: expected one of {known}")
    return TYPES.index(name)


def _co_simulation(element: Xml, is_model_exchange: bool) -> CoSimulation:
    """Returns the interface for co-simulation; with a solver, an FMU for model exchange takes any step."""
    capabilities = {
        f.name: element.get(_CAPABILITIES.get(f.name, f.name)) in ("true", "1")
        for f in fields(CoSimulation)[1:]
    }
    # functions of FMI 2.0 that FMI 3.0 does not have, or that fmi3_calls.c does not
    absent = dict.fromkeys(
        ("canInterpolateInputs", "canRunAsynchronuously", "providesDirectionalDerivative"), False
    )
    found = CoSimulation(required(element, "modelIdentifier"), **capabilities | absent)
    return with_solver(found) if is_model_exchange else found


def _simple_type(element: Xml) -> SimpleType:
    return SimpleType(
        required(element, "name"),
        _kind(element.tag.removesuffix("Type")),
        items(element),
        *map(element.get, ("unit", "min", "max", "nominal")),
        is_relative=is_relative(element),
    )


def _kind(name: str) -> str:
    """Returns the type of FMI 2.0 for one of FMI 3.0."""
    if name.startswith("Float"):
        return "Real"
    return "Integer" if _RANGES.get(name) else name


def _shape(xml: Xml, sizes: Mapping[str | None, str | None]) -> list[int]:
    """Returns the dimensions, with structural parameters at their start values."""
    texts = (d.get("start") or sizes.get(d.get("valueReference")) for d in xml.findall("Dimension"))
    shape = [int(text or 0) for text in texts]
    if not all(size > 0 for size in shape):
        raise ValueError(f"variable {xml.get('name')}: dimensions {shape}: expected 1 at least")
    return shape


def _scalars(
    xml: Xml, shape: list[int], first: int, types: Mapping[str, SimpleType]
) -> Iterator[ScalarVariable]:
    name, count = required(xml, "name"), math.prod(shape)
    of_type = declared_type(xml, name, types)
    causality = xml.get("causality", "local")
    is_parameter = causality in ("parameter", "calculatedParameter", "structuralParameter")
    default = "fixed" if is_parameter else "continuous" if xml.tag.startswith("Float") else "discrete"
    variability = xml.get("variability", default)
    if variability not in INITIAL:
        raise ValueError(
            f"variable {name}: variability {variability!r}: expected one of {', '.join(INITIAL)}"
        )
    initial = INITIAL[variability].get("parameter" if causality == "structuralParameter" else causality)
    texts = xml.get("start", "").split() if xml.tag != "String" else []
    starts = [required(s, "value") for s in xml.findall("Start")] or texts
    if len(starts) not in (0, 1, count):
        expected = f"1 or {count}" if count > 1 else "1"
        raise ValueError(f"variable {name}: {len(starts)} start values: expected {expected}")
    low, high = (_limit(xml, of_type, i) for i in (0, 1))
    for i, index in enumerate(product(*(range(1, size + 1) for size in shape))):
        yield ScalarVariable(
            _element_name(name, index),
            first + i,
            _kind(xml.tag),
            causality,
            variability,
            xml.get("initial") or initial,
            xml.get("description"),
            of_type,
            xml.get("unit"),
            low,
            high,
            xml.get("nominal"),
            starts[i % len(starts)] if starts else None,
            is_relative(xml, of_type),
            xml.tag == "Float32",
        )


def _start(v: ScalarVariable) -> float:
    """Returns the `start` of an `Element`."""
    text = "" if v.type == "String" else v.start or ""
    with suppress(ValueError):
        start = float({"true": "1", "false": "0"}.get(text, text))
        return start if v.type == "Real" or abs(start) < 2**53 else math.nan
    return math.nan


def _element_name(name: str, index: tuple[int, ...]) -> str:
    """Returns the name of a scalar as in FMI 2.0: of der(x), der(x[1])."""
    if not index:
        return name
    end = ")" if name.startswith("der(") and name.endswith(")") else ""
    return f"{name.removesuffix(end)}[{','.join(map(str, index))}]{end}"


def _limit(xml: Xml, declared: SimpleType | None, side: int) -> str | None:
    """Returns the stated least (0) or largest value (1), or the limit of the type if it is narrower."""
    name, choose = ("min", max) if side == 0 else ("max", min)
    stated = xml.get(name, declared and getattr(declared, name))
    of_type = _RANGES.get(xml.tag)
    if of_type is None:
        return stated
    return str(choose(of_type[side], int(stated or of_type[side])))


def _unknowns(root: Xml, name: str, by_reference: Mapping[int, list[ScalarVariable]]) -> Iterator[Unknown]:
    for xml in root.findall(f"ModelStructure/{name}"):
        listed = xml.get("dependencies")
        references = None if listed is None else map(int, listed.split())
        known = None if references is None else [v for r in references for v in by_reference.get(r, [])]
        yield from (Unknown(v, known) for v in by_reference.get(value_reference(xml), []))
