"""The model description of an FMI 2.0 FMU as objects, with the names of the standard (FMI 2.0.5, 2.2).

It holds the parts that running an FMU needs; `l1-depth check` judges the rest. FMPy reads the same, and takes
longer to import than a run takes.
"""
# ruff: noqa: N815  (names of the standard)

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element as Xml

from fmus.fmi.variable_types import INTEGER_RANGE, TRANSFER_TYPE, TYPES
from fmus.units import BASES, UnitDefinition

# the number of values of fmi2ValueReference
_REFERENCES = 2**32
# variability -> causality -> default of `initial` (2.2.7)
_OF_PARAMETERS = {"parameter": "exact", "calculatedParameter": "calculated", "local": "calculated"}
_OF_SIGNALS = {"input": "exact", "output": "calculated", "local": "calculated", "independent": None}
INITIAL = {
    "constant": {"output": "exact", "local": "exact"},
    "fixed": _OF_PARAMETERS,
    "tunable": _OF_PARAMETERS,
    "discrete": {name: initial for name, initial in _OF_SIGNALS.items() if initial},
    "continuous": _OF_SIGNALS,
}


@dataclass(eq=False)
class Item:
    name: str
    value: str


@dataclass(eq=False)
class SimpleType:
    """A type that variables declare; items: of an Enumeration."""

    name: str
    type: str
    items: list[Item]
    unit: str | None
    min: str | None
    max: str | None
    nominal: str | None
    is_relative: bool = False


@dataclass(eq=False)
class ScalarVariable:
    """A variable; numbers as text, None if they are not stated.

    units: unit definitions of its FMU, for this variable
    is_relative: whether it is a difference, for which the offset of a unit is ignored (`relativeQuantity`)
    is_float32: whether FMI 3.0 transfers it in single precision
    """

    name: str
    valueReference: int
    type: str
    causality: str
    variability: str
    initial: str | None
    description: str | None
    declaredType: SimpleType | None
    unit: str | None
    min: str | None
    max: str | None
    nominal: str | None
    start: str | None
    units: Mapping[str, UnitDefinition] = field(default_factory=dict, init=False)
    is_relative: bool = False
    is_float32: bool = False


@dataclass(eq=False)
class Unknown:
    """Unknown of the model structure; dependencies: None if they are not stated, so that it may have all."""

    variable: ScalarVariable
    dependencies: list[ScalarVariable] | None


@dataclass(eq=False)
class Unit:
    name: str
    baseUnit: UnitDefinition | None


@dataclass(eq=False)
class CoSimulation:
    """Capabilities (4.3.1)."""

    modelIdentifier: str
    needsExecutionTool: bool
    canHandleVariableCommunicationStepSize: bool
    canInterpolateInputs: bool
    canRunAsynchronuously: bool
    canBeInstantiatedOnlyOncePerProcess: bool
    canNotUseMemoryManagementFunctions: bool
    canGetAndSetFMUstate: bool
    canSerializeFMUstate: bool
    providesDirectionalDerivative: bool


@dataclass(eq=False)
class DefaultExperiment:
    startTime: str | None
    stopTime: str | None
    stepSize: str | None


class Element(NamedTuple):
    """A scalar variable of FMI 3.0, or a scalar of an array.

    type: index in `fmi3_description.TYPES`
    reference: value reference of the array
    first, size: index of the array's first scalar, and the number of its scalars
    start: start value; not a number for a string, without one, and of more digits than a double has
    """

    type: int
    reference: int
    first: int
    size: int
    start: float = math.nan


@dataclass(eq=False)
class ModelDescription:
    """The description of an FMU.

    coSimulation: capabilities; of an FMU for model exchange alone, those with a solver
    is_model_exchange: whether it is for model exchange alone
    elements: of FMI 3.0, the scalar of each value reference
    left_out: of FMI 3.0, name -> type of the variables that are not among `modelVariables`
    is_own_build: whether a build of this user wrote the file, which the description itself cannot prove
    """

    fmiVersion: str
    modelName: str
    guid: str
    description: str | None
    generationTool: str | None
    coSimulation: CoSimulation
    defaultExperiment: DefaultExperiment | None
    unitDefinitions: list[Unit]
    modelVariables: list[ScalarVariable]
    outputs: list[Unknown]
    initialUnknowns: list[Unknown]
    numberOfContinuousStates: int
    numberOfEventIndicators: int
    is_model_exchange: bool
    elements: Sequence[Element] = ()
    left_out: Mapping[str, str] = field(default_factory=dict)
    is_own_build: bool = False


def model_description(root: Xml) -> ModelDescription:
    """Returns the content of a modelDescription.xml; ValueError names the part that cannot be read."""
    types = {
        definition.name: definition for definition in map(_simple_type, root.findall("TypeDefinitions/*"))
    }
    variables = [_variable(element, types) for element in root.findall("ModelVariables/ScalarVariable")]
    interface, is_model_exchange = interface_of(root)
    capabilities = {f.name: interface.get(f.name) in ("true", "1") for f in fields(CoSimulation)[1:]}
    co_simulation = CoSimulation(interface.get("modelIdentifier", ""), **capabilities)
    return ModelDescription(
        **attributes_of(root),
        guid=root.get("guid", ""),
        coSimulation=with_solver(co_simulation) if is_model_exchange else co_simulation,
        modelVariables=variables,
        outputs=_unknowns(root, "Outputs", variables),
        initialUnknowns=_unknowns(root, "InitialUnknowns", variables),
        numberOfContinuousStates=len(root.findall("ModelStructure/Derivatives/Unknown")),
        numberOfEventIndicators=int(root.get("numberOfEventIndicators", "0")),
        is_model_exchange=is_model_exchange,
    )


def attributes_of(root: Xml) -> dict[str, Any]:
    """Returns the parts of a model description that FMI 2.0 and 3.0 write alike."""
    experiment = root.find("DefaultExperiment")
    times = None if experiment is None else map(experiment.get, ("startTime", "stopTime", "stepSize"))
    return {
        "fmiVersion": required(root, "fmiVersion"),
        "modelName": root.get("modelName", ""),
        "description": root.get("description"),
        "generationTool": root.get("generationTool"),
        "defaultExperiment": times and DefaultExperiment(*times),
        "unitDefinitions": [unit(element) for element in root.findall("UnitDefinitions/Unit")],
    }


def interface_of(root: Xml) -> tuple[Xml, bool]:
    """Returns the interface for co-simulation, or the one for model exchange; whether it is the latter."""
    for name in ("CoSimulation", "ModelExchange"):
        if (interface := root.find(name)) is not None:
            return interface, name == "ModelExchange"
    raise ValueError("neither CoSimulation nor ModelExchange: expected one of them at least")


def with_solver(interface: CoSimulation) -> CoSimulation:
    """Returns the interface of an FMU for model exchange with a solver, which can take any step."""
    return replace(interface, canHandleVariableCommunicationStepSize=True)


def required(element: Xml, attribute: str) -> str:
    """Returns an attribute; ValueError if it is missing."""
    value = element.get(attribute)
    if value is None:
        name = element.get("name")
        raise ValueError(f"{element.tag}{f' {name}' if name else ''} has no {attribute}")
    return value


def _simple_type(element: Xml) -> SimpleType:
    name = required(element, "name")
    for kind in element:
        stated = map(kind.get, ("unit", "min", "max", "nominal"))
        return SimpleType(name, kind.tag, items(kind), *stated, is_relative=is_relative(kind))
    raise ValueError(f"SimpleType {name} has no type")


def items(kind: Xml) -> list[Item]:
    """Returns the items of an enumeration, none of another type."""
    return [Item(required(item, "name"), required(item, "value")) for item in kind.findall("Item")]


def unit(element: Xml) -> Unit:
    """Returns a unit of UnitDefinitions."""
    name, base = required(element, "name"), element.find("BaseUnit")
    return Unit(name, None if base is None else base_unit(base))


def base_unit(base: Xml) -> UnitDefinition:
    """Returns the definition of a unit by an element BaseUnit of FMI or SSP."""
    exponents = {unit: power for unit in BASES if (power := int(base.get(unit, "0")))}
    return UnitDefinition(exponents, float(base.get("factor", "1")), float(base.get("offset", "0")))


def _variable(element: Xml, types: Mapping[str, SimpleType]) -> ScalarVariable:
    name = required(element, "name")
    kind = next((child for child in element if child.tag in TYPES), None)
    if kind is None:
        raise ValueError(f"variable {name} has no type: expected one of {', '.join(TYPES)}")
    declared = declared_type(kind, name, types)
    causality, variability = element.get("causality", "local"), element.get("variability", "continuous")
    initial = element.get("initial")
    if not initial:
        if causality not in INITIAL.get(variability, {}):
            raise ValueError(
                f"variable {name}: a causality {causality!r} of variability {variability!r} has no default "
                "of initial: expected that it is stated"
            )
        initial = INITIAL[variability][causality]
    low, high = INTEGER_RANGE
    if TRANSFER_TYPE[kind.tag] == "Integer" and not low <= int(kind.get("start") or 0) <= high:
        raise ValueError(f"variable {name}: start {kind.get('start')}: expected {low}..{high}")
    return ScalarVariable(
        name,
        value_reference(element),
        kind.tag,
        causality,
        variability,
        initial,
        element.get("description"),
        declared,
        *map(kind.get, ("unit", "min", "max", "nominal", "start")),
        is_relative=is_relative(kind, declared),
    )


def declared_type(element: Xml, variable: str, types: Mapping[str, SimpleType]) -> SimpleType | None:
    """Returns the declared type of a variable, None without one; ValueError if it is not defined."""
    name = element.get("declaredType")
    if name is not None and name not in types:
        raise ValueError(f"variable {variable}: declaredType {name!r} is not defined")
    return None if name is None else types[name]


def is_relative(element: Xml, declared: SimpleType | None = None) -> bool:
    """Whether a type or a variable is a relative quantity; declared: the type of the variable."""
    of_type = "true" if declared and declared.is_relative else "false"
    return element.get("relativeQuantity", of_type) in ("true", "1")


def value_reference(element: Xml) -> int:
    """Returns the value reference of a variable."""
    reference = int(required(element, "valueReference"))
    if not 0 <= reference < _REFERENCES:
        name = element.get("name")
        raise ValueError(f"variable {name}: valueReference {reference}: expected 0..{_REFERENCES - 1}")
    return reference


def _unknowns(root: Xml, name: str, variables: Sequence[ScalarVariable]) -> list[Unknown]:
    """Returns the unknowns of a part of the model structure, which numbers variables from 1."""

    def variable(number: str) -> ScalarVariable:
        if not 1 <= int(number) <= len(variables):
            raise ValueError(f"{name}: no variable {number}: expected 1 to {len(variables)}")
        return variables[int(number) - 1]

    unknowns = []
    for element in root.findall(f"ModelStructure/{name}/Unknown"):
        dependencies = element.get("dependencies")
        listed = None if dependencies is None else list(map(variable, dependencies.split()))
        unknowns.append(Unknown(variable(required(element, "index")), listed))
    return unknowns
