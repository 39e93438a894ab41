"""Block -> modelDescription.xml of FMI 2.0.5 or 3.0.2, in the native flavour for model exchange too.

All attributes are written, also those with FMI's default: causality, variability, initial, units, ranges,
enumerations, dependencies. In step mode no output depends directly on an input; in initialization mode
outputs follow the inputs.
"""

import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from itertools import groupby
from typing import TYPE_CHECKING, Any
from xml.etree import ElementTree

from fmus.block import Block
from fmus.block.units import display, per_second, rate, unit
from fmus.block.variables import BlockVariable
from fmus.errors import ExportError
from fmus.files import xml_document

if TYPE_CHECKING:  # these load CasADi, which the description of a class does without
    from fmus.generate.derivatives import Mode, Sensitivities
    from fmus.generate.trace import Traced

LOG_CATEGORIES = {
    "logStatusWarning": "Something that the user should know.",
    "logStatusDiscard": "A step that was refused; the state is what it was before.",
    "logStatusError": "A call that was refused; the state is what it was before.",
    "logStatusFatal": "The instance can not be used any more.",
    "logAll": "Every message.",
}

_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
}
_OF_CO_SIMULATION = {"canHandleVariableCommunicationStepSize": "true", "canRunAsynchronuously": "false"}


Dependencies = Mapping[int, Sequence[int]]
"""Value reference of an unknown -> value references of the knowns that it depends on."""


@dataclass(frozen=True)
class ModelExchange:
    """Description of model exchange, beside co-simulation.

    capabilities: the attributes of `ModelExchange`
    indicators: how many event indicators
    restarted: value references of the continuous states that an event may change
    dependencies: each output and derivative -> the inputs and states behind it
    """

    capabilities: dict[str, str]
    indicators: int
    restarted: Collection[int]
    dependencies: Dependencies


def model_description(
    block: Block,
    guid: str,
    capabilities: dict[str, str],
    initial: Dependencies,
    exchange: ModelExchange | None = None,
    source_files: Sequence[str] = (),
) -> bytes:
    """Returns the XML of FMI 2.0 of a block.

    capabilities: the attributes of `CoSimulation` that the flavour decides
    initial: each initial unknown -> the parameters and inputs behind it
    exchange: None for an FMU of co-simulation alone
    source_files: the files of the folder `sources` that an importer compiles to rebuild the FMU

    Raises ExportError for a unit that `fmus.block.units` does not define.
    """
    attributes = {"fmiVersion": "2.0", "guid": guid, **_model_attributes(block)}
    if exchange and exchange.indicators:
        attributes["numberOfEventIndicators"] = str(exchange.indicators)
    root = ElementTree.Element("fmiModelDescription", attributes)
    interfaces = {"ModelExchange": exchange.capabilities} if exchange else {}
    interfaces["CoSimulation"] = _OF_CO_SIMULATION | capabilities
    for name, own in interfaces.items():
        interface = _add(root, name, modelIdentifier=block.name, **(_CAPABILITIES | own))
        listed = _add(interface, "SourceFiles") if source_files else interface
        for file in source_files:
            _add(listed, "File", name=file)
    states = block.states if exchange else ()
    _add_units(root, block.variables, states)
    _add_enumerations(root, block)
    _add_experiment(root, block)
    variables = _add(root, "ModelVariables")
    restarted = exchange.restarted if exchange else ()
    for variable in (*block.variables, *states):
        of_state = variable.value_reference - len(states) // 2
        is_rate = of_state >= len(block.variables) and variable.causality == "local"
        of_all, of_type = _attributes_of(variable.name, [variable])
        # FMI 2.0 names the state by its index from 1, not by its value reference
        of_type["derivative"] = str(of_state + 1) if is_rate else None
        of_type["reinit"] = "true" if variable.value_reference in restarted else None
        _add(_add(variables, "ScalarVariable", **of_all), variable.type, **of_type)
    described = len(block.variables) + len(states)
    initial = {unknown: known for unknown, known in initial.items() if unknown < described}
    # One list of dependencies serves both interfaces: it also has those that hold in model exchange alone.
    _structure(root, block, exchange.dependencies if exchange else {}, initial)
    return _parsable(root, block)


def _model_attributes(block: Block) -> dict[str, str]:
    """Returns the attributes of a model that all versions of FMI have."""
    attributes = {
        "modelName": block.name,
        "description": block.description,
        "author": block.author,
        "version": block.version,
        "license": block.license,
        "generationTool": f"l1-depth {version('l1-depth')}",
        "generationDateAndTime": _generation_date(),
        "variableNamingConvention": "structured",
    }
    return _without_none(attributes)


def _add_experiment(root: Any, block: Block) -> None:
    """Adds the log categories and the experiment that the FMU suggests."""
    categories = _add(root, "LogCategories")
    for name, description in LOG_CATEGORIES.items():
        _add(categories, "Category", name=name, description=description)
    times = {"startTime": "0", "stopTime": repr(block.stop_time), "stepSize": repr(block.step_size)}
    _add(root, "DefaultExperiment", **times)


def _parsable(root: Any, block: Block) -> bytes:
    """Returns the XML of a tree; ExportError for texts of the block that XML cannot hold."""
    text = xml_document(root)
    try:
        ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ExportError(f"{block.name}: expected texts that XML can hold: {error}") from error
    return text


def _add(parent: Any, tag: str, **attributes: str | None) -> Any:
    """Adds an element with the attributes that are not None."""
    return ElementTree.SubElement(parent, tag, _without_none(attributes))


def _without_none(attributes: dict[str, str | None]) -> dict[str, str]:
    return {name: value for name, value in attributes.items() if value is not None}


def _generation_date() -> str | None:
    """Returns the date of SOURCE_DATE_EPOCH, None without it."""
    # The time of the build itself would make two builds of one source different files.
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ") if epoch else None


def _add_units(root: Any, variables: Sequence[BlockVariable], states: Sequence[BlockVariable]) -> None:
    """Adds the units of variables, continuous states and derivatives."""
    definitions = _add(root, "UnitDefinitions")
    of_states = [v.unit for v in states[: len(states) // 2] if v.unit is not None]
    units = {per_second(name): rate(name) for name in of_states}
    units |= {name: unit(name) for name in of_states}
    units |= {v.unit: unit(v.unit) for v in variables if v.unit is not None}
    for name, base in sorted(units.items()):
        definition = _add(definitions, "Unit", name=name)
        exponents = {symbol: str(exponent) for symbol, exponent in base.exponents.items()}
        _add(definition, "BaseUnit", **exponents, **_linear(base.factor, base.offset))
        shown = {
            v.display_unit for v in (*variables, *states) if v.unit == name and v.display_unit is not None
        }
        for other in sorted(shown):
            _add(definition, "DisplayUnit", name=other, **_linear(*display(name, other)))


def _linear(factor: float, offset: float) -> dict[str, str]:
    """Returns the attributes of a conversion, where they are not the defaults of FMI."""
    values = {"factor": (factor, 1.0), "offset": (offset, 0.0)}
    return {name: repr(value) for name, (value, default) in values.items() if value != default}


def _enumeration(parent: Any, **named: str) -> Any:
    return _add(_add(parent, "SimpleType", **named), "Enumeration")


def _add_enumerations(root: Any, block: Block, add_type: Callable[..., Any] = _enumeration) -> None:
    """Adds the enumerations of a block.

    add_type: adds an enumeration of a name and description, without its items
    """
    enumerations = {v.enumeration.__name__: v.enumeration for v in block.variables if v.enumeration}
    definitions = _add(root, "TypeDefinitions") if enumerations else root
    for name, enumeration in sorted(enumerations.items()):
        description = (enumeration.__doc__ or "").partition("\n")[0]
        items = add_type(definitions, name=name, description=description)
        for member in enumeration:
            _add(items, "Item", name=member.name.lower(), value=str(member.value))


def _attributes_of(name: str, scalars: Sequence[BlockVariable]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the attributes that every variable has, and the attributes of its type.

    scalars: its elements, which differ in start values and texts alone
    """
    v = scalars[0]
    texts = dict.fromkeys(s.description + (f" ({s.source})" if s.source else "") for s in scalars)
    limits = (v.minimum, v.maximum) if v.type in ("Real", "Integer") else (None, None)
    of_all = {
        "name": name,
        "valueReference": str(v.value_reference),
        "description": "; ".join(texts),
        "causality": v.causality,
        "variability": v.variability,
        "initial": v.initial,
    }
    of_type = {
        "declaredType": v.enumeration.__name__ if v.enumeration else None,
        "min": _attribute(limits[0]),
        "max": _attribute(limits[1]),
        "nominal": _attribute(v.nominal),
        "unit": v.unit,
        "displayUnit": v.display_unit,
        "start": " ".join(str(_attribute(s.start)) for s in scalars) if v.settable else None,
    }
    return of_all, of_type


def _attribute(value: Any) -> str | None:
    """Returns a value as XML writes it."""
    if value is None:
        return None
    # a bool is an int, too
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, float) else str(int(value))


def _structure(root: Any, block: Block, present: Dependencies, initial: Dependencies) -> None:
    outputs = {v.value_reference: present.get(v.value_reference, ()) for v in block.of_causality("output")}
    rates = {unknown: known for unknown, known in present.items() if unknown not in outputs}
    structure = _add(root, "ModelStructure")
    for name, dependencies in (("Outputs", outputs), ("Derivatives", rates), ("InitialUnknowns", initial)):
        section = _add(structure, name) if dependencies else structure
        for unknown, known in sorted(dependencies.items()):
            indices = " ".join(str(reference + 1) for reference in known)
            _add(section, "Unknown", index=str(unknown + 1), dependencies=indices)


# FMI 3.0.2, where it has more than FMI 2.0: the scalars of an array are one variable. Time and event
# indicators are the last variables. A value reference is the place of its variable, counted from 1, since
# OMSimulator 3 takes `dependencies` and `derivative` for such places.

TYPES = {"Real": "Float64", "Integer": "Int32", "Boolean": "Boolean", "Enumeration": "Enumeration"}
_CAPABILITIES_3 = {
    "canGetAndSetFMUState": "true",
    "canSerializeFMUState": "true",
    "providesDirectionalDerivatives": "true",
    "providesAdjointDerivatives": "true",
}
_OF_CO_SIMULATION_3 = {
    "canHandleVariableCommunicationStepSize": "true",
    "maxOutputDerivativeOrder": "0",
    "providesIntermediateUpdate": "true",
    "canReturnEarlyAfterIntermediateUpdate": "true",
}
_INDICES = re.compile(r"\[[\d,]+\]")
_TIME = "time"


def other_variables(traced: "Traced") -> tuple[BlockVariable, ...]:
    """Returns the variables that FMI 3.0 alone has: the time and, as an array, the event indicators."""
    block = traced.block
    reference = len(block.variables) + len(block.states)
    is_taken = _TIME in {array_name(v) for v in block.variables}
    # no variable of a block has a point in its name
    time = "independent.time" if is_taken else _TIME
    indicators = (f"event.indicators[{i + 1}]" for i in range(traced.indicators))
    about = "Changes its sign where a derivative has a corner or a jump"
    return (
        _variable(time, reference, "independent", "Time", "s"),
        *(_variable(name, reference + 1 + i, "local", about) for i, name in enumerate(indicators)),
    )


def _variable(
    name: str, reference: int, causality: str, description: str, unit: str | None = None
) -> BlockVariable:
    initial = "calculated" if causality == "local" else None
    nothing = (None, None, None, None)  # display unit, limits, nominal value
    return BlockVariable(
        name, reference, causality, "continuous", initial, 0.0, description, unit, *nothing, "", None
    )


def array_name(v: BlockVariable) -> str:
    """Returns the name of the array that a scalar belongs to, or the name of any other variable."""
    return _INDICES.sub("", v.name)


def variable_names(variables: Iterable[BlockVariable]) -> list[str]:
    """Returns the names in FMI 3.0 of the variables that some scalars become."""
    return [name for name, *_ in arrays(variables)]


def arrays(variables: Iterable[BlockVariable]) -> Iterator[tuple[str, list[int], list[BlockVariable]]]:
    """Yields name, dimensions and scalars of each variable; no dimensions for one that is no array.

    Scalars that differ in more than their start values are no array, and neither are rows of different
    lengths. Derivatives are an array if their states are one.
    """
    variables = list(variables)
    of_states = {f"der({v.name})": _common(v) for v in variables}
    for name, group in groupby(variables, array_name):
        scalars = list(group)
        indices = _INDICES.search(scalars[-1].name)
        shape = [int(index) for index in indices[0][1:-1].split(",")] if indices else []
        is_array = (
            len(scalars) == math.prod(shape)
            and len({(_common(v), of_states.get(v.name)) for v in scalars}) == 1
        )
        if shape and is_array:
            yield name, shape, scalars
        else:
            yield from ((v.name, [], [v]) for v in scalars)


def _common(v: BlockVariable) -> tuple[Any, ...]:
    """Returns what the scalars of an array have in common."""
    return (v.type, v.variability, v.unit, v.display_unit, v.minimum, v.maximum, v.nominal, v.enumeration)


def fmi3_variables(
    traced: "Traced", scalars: bool = False
) -> list[tuple[str, list[int], list[BlockVariable]]]:
    """Returns name, dimensions and scalars of each variable, in the order of ModelVariables.

    scalars: whether the elements of arrays are variables
    """
    described = (*traced.block.variables, *traced.block.states, *other_variables(traced))
    return [(v.name, [], [v]) for v in described] if scalars else [*arrays(described)]


def fmi3_description(traced: "Traced", modes: "Sensitivities", token: str, scalars: bool = False) -> bytes:
    """Returns the XML of FMI 3.0 of a block.

    token: the instantiation token
    scalars: whether the elements of arrays are variables

    Raises ExportError for a unit that `fmus.block.units` does not define.
    """
    block = traced.block
    others, count = other_variables(traced), len(block.states) // 2
    attributes = {"fmiVersion": "3.0", "instantiationToken": token, **_model_attributes(block)}
    root = ElementTree.Element("fmiModelDescription", attributes)
    for name, own in (("ModelExchange", {}), ("CoSimulation", _OF_CO_SIMULATION_3)):
        _add(root, name, modelIdentifier=block.name, **_CAPABILITIES_3, **own)
    _add_units(root, (*block.variables, *others), block.states)
    _add_enumerations(root, block, lambda parent, **named: _add(parent, "EnumerationType", **named))
    _add_experiment(root, block)
    variables = _add(root, "ModelVariables")
    groups = fmi3_variables(traced, scalars)
    places = {v.value_reference: place for place, (*_, members) in enumerate(groups, 1) for v in members}
    for name, shape, (v, *rest) in groups:
        of_state = v.value_reference - len(block.variables)
        of_all, of_type = _attributes_of(name, (v, *rest))
        of_all["valueReference"] = str(places[v.value_reference])
        if traced.restarted.intersection(scalar.value_reference for scalar in (v, *rest)):
            of_type["reinit"] = "true"
        elif count <= of_state < 2 * count:
            of_type["derivative"] = str(places[v.value_reference - count])
        elif v.causality in ("input", "output") and v.variability == "continuous":
            of_type["intermediateUpdate"] = "true"
        variable = _add(variables, TYPES[v.type], **of_all, **of_type)
        for size in shape:
            _add(variable, "Dimension", start=str(size))
    _add_structure(_add(root, "ModelStructure"), traced, modes, places)
    return _parsable(root, block)


def _add_structure(
    structure: Any, traced: "Traced", modes: "Sensitivities", places: Mapping[int, int]
) -> None:
    present, initial = (_of_arrays(mode, places) for mode in ((modes.step, modes.exchange), (modes.initial,)))
    outputs = {places[v.value_reference] for v in traced.block.of_causality("output")}
    indicators = {places[v.value_reference] for v in other_variables(traced) if v.causality == "local"}
    for tag, known in (
        ("Output", {r: known for r, known in present.items() if r in outputs}),
        ("ContinuousStateDerivative", {r: known for r, known in present.items() if r not in outputs}),
        ("InitialUnknown", initial),
    ):
        for reference, behind in sorted(known.items()):
            _add(
                structure, tag, valueReference=str(reference), dependencies=" ".join(map(str, sorted(behind)))
            )
    for reference in sorted(indicators):
        _add(structure, "EventIndicator", valueReference=str(reference))


def _of_arrays(modes: Iterable["Mode"], places: Mapping[int, int]) -> dict[int, set[int]]:
    """Returns the dependencies between whole variables that hold in one of the modes."""
    found: dict[int, set[int]] = {}
    for mode in modes:
        for unknown, known in mode.dependencies().items():
            found.setdefault(places[unknown], set()).update(places[reference] for reference in known)
    return found
