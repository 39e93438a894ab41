"""Block -> modelDescription.xml of FMI 2.0.5, for co-simulation and, in the native flavour, model exchange.

Everything explicit: causality, variability, initial, units, ranges, enumerations, dependencies. In
step mode no output depends directly on an input; in initialisation mode outputs follow the inputs. One list
of dependencies serves both interfaces: it has the inputs that outputs follow in model exchange alone too.
"""

import os
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any
from xml.etree import ElementTree

from fmus.block import Block
from fmus.block.units import display, per_second, rate, unit
from fmus.block.variables import BlockVariable
from fmus.errors import ExportError
from fmus.files import xml_document
from fmus.generate.sensitivities import sensitivities
from fmus.generate.symbolic import indicator_count, restarted_states

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


def model_description(
    block: Block,
    guid: str,
    capabilities: dict[str, str],
    exchange: dict[str, str] | None = None,
    source_files: Sequence[str] = (),
    dependencies: Mapping[int, Sequence[int]] | None = None,
) -> bytes:
    """Returns the XML of a block; capabilities: the attributes of `CoSimulation` that the flavour decides.

    exchange: those of `ModelExchange`; None for an FMU of co-simulation alone
    source_files: what an importer must compile to rebuild the FMU, inside the folder `sources`.
    dependencies: value reference of each initial unknown -> those of the parameters and inputs behind it; by
        default of the block as it is traced

    Raises ExportError for a unit that `fmus.block.units` does not know.
    """
    attributes = {"fmiVersion": "2.0", "guid": guid, **model_attributes(block)}
    if exchange and (count := indicator_count(block)):
        attributes["numberOfEventIndicators"] = str(count)
    root = ElementTree.Element("fmiModelDescription", attributes)
    interfaces = {"ModelExchange": exchange} if exchange else {}
    interfaces["CoSimulation"] = _OF_CO_SIMULATION | capabilities
    for name, own in interfaces.items():
        interface = add(root, name, modelIdentifier=block.name, **(_CAPABILITIES | own))
        listed = add(interface, "SourceFiles") if source_files else interface
        for file in source_files:
            add(listed, "File", name=file)
    states = block.states if exchange else ()
    add_units(root, block.variables, states)
    add_enumerations(root, block)
    add_experiment(root, block)
    variables = add(root, "ModelVariables")
    restarted = restarted_states(block) if exchange else set()
    for variable in (*block.variables, *states):
        of_state = variable.value_reference - len(states) // 2
        is_rate = of_state >= len(block.variables) and variable.causality == "local"
        of_all, of_type = attributes_of(variable.name, [variable])
        of_type["derivative"] = str(of_state + 1) if is_rate else None  # index of the state
        of_type["reinit"] = "true" if variable.value_reference in restarted else None
        add(add(variables, "ScalarVariable", **of_all), variable.type, **of_type)
    if dependencies is None:
        settable = (*block.of_causality("parameter"), *block.of_causality("input"))
        dependencies = sensitivities(block).initial.dependencies(settable)
    described = len(block.variables) + len(states)
    initial = {unknown: known for unknown, known in dependencies.items() if unknown < described}
    known = (*block.of_causality("input"), *block.states)
    present = sensitivities(block).exchange.dependencies(known) if exchange else {}
    _structure(root, block, present, initial)
    return parsable(root, block)


def model_attributes(block: Block) -> dict[str, str]:
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


def add_experiment(root: Any, block: Block) -> None:
    """Adds the log categories and the experiment that the FMU suggests."""
    categories = add(root, "LogCategories")
    for name, description in LOG_CATEGORIES.items():
        add(categories, "Category", name=name, description=description)
    times = {"startTime": "0", "stopTime": repr(block.stop_time), "stepSize": repr(block.step_size)}
    add(root, "DefaultExperiment", **times)


def parsable(root: Any, block: Block) -> bytes:
    """Returns the XML of a tree; ExportError for texts of the block that XML cannot hold."""
    text = xml_document(root)
    try:
        ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ExportError(f"{block.name}: expected texts that XML can hold: {error}") from error
    return text


def add(parent: Any, tag: str, **attributes: str | None) -> Any:
    """Adds an element with the attributes that are not None."""
    return ElementTree.SubElement(parent, tag, _without_none(attributes))


def _without_none(attributes: dict[str, str | None]) -> dict[str, str]:
    return {name: value for name, value in attributes.items() if value is not None}


def _generation_date() -> str | None:
    """Returns the date of SOURCE_DATE_EPOCH, None without it: two builds of one source are the same file."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ") if epoch else None


def add_units(root: Any, variables: Sequence[BlockVariable], states: Sequence[BlockVariable]) -> None:
    """Adds the units of variables, continuous states and derivatives."""
    definitions = add(root, "UnitDefinitions")
    of_states = [v.unit for v in states[: len(states) // 2] if v.unit is not None]
    units = {per_second(name): rate(name) for name in of_states}
    units |= {name: unit(name) for name in of_states}
    units |= {v.unit: unit(v.unit) for v in variables if v.unit is not None}
    for name, base in sorted(units.items()):
        definition = add(definitions, "Unit", name=name)
        exponents = {symbol: str(exponent) for symbol, exponent in base.exponents.items()}
        add(definition, "BaseUnit", **exponents, **_linear(base.factor, base.offset))
        shown = {
            v.display_unit for v in (*variables, *states) if v.unit == name and v.display_unit is not None
        }
        for other in sorted(shown):
            add(definition, "DisplayUnit", name=other, **_linear(*display(name, other)))


def _linear(factor: float, offset: float) -> dict[str, str]:
    """Returns the attributes of a conversion, where they are not the defaults of FMI."""
    values = {"factor": (factor, 1.0), "offset": (offset, 0.0)}
    return {name: repr(value) for name, (value, default) in values.items() if value != default}


def _enumeration(parent: Any, **named: str) -> Any:
    return add(add(parent, "SimpleType", **named), "Enumeration")


def add_enumerations(root: Any, block: Block, add_type: Callable[..., Any] = _enumeration) -> None:
    """Adds the enumerations of a block; add_type: adds one of a name and description, without its items."""
    enumerations = {v.enumeration.__name__: v.enumeration for v in block.variables if v.enumeration}
    definitions = add(root, "TypeDefinitions") if enumerations else root
    for name, enumeration in sorted(enumerations.items()):
        description = (enumeration.__doc__ or "").partition("\n")[0]
        items = add_type(definitions, name=name, description=description)
        for member in enumeration:
            add(items, "Item", name=member.name.lower(), value=str(member.value))


def attributes_of(name: str, scalars: Sequence[BlockVariable]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Returns the attributes of a variable of some scalars, alike but for start values and texts.

    They are those of every variable, and those of its type.
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
        "min": attribute(limits[0]),
        "max": attribute(limits[1]),
        "nominal": attribute(v.nominal),
        "unit": v.unit,
        "displayUnit": v.display_unit,
        "start": " ".join(str(attribute(s.start)) for s in scalars) if v.settable else None,
    }
    return of_all, of_type


def attribute(value: Any) -> str | None:
    """Returns a value as XML has it."""
    if value is None:
        return None
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, float) else str(int(value))


def _structure(
    root: Any, block: Block, present: Mapping[int, Sequence[int]], initial: Mapping[int, Sequence[int]]
) -> None:
    outputs = {v.value_reference: present.get(v.value_reference, ()) for v in block.of_causality("output")}
    rates = {unknown: known for unknown, known in present.items() if unknown not in outputs}
    structure = add(root, "ModelStructure")
    for name, dependencies in (("Outputs", outputs), ("Derivatives", rates), ("InitialUnknowns", initial)):
        section = add(structure, name) if dependencies else structure
        for unknown, known in sorted(dependencies.items()):
            indices = " ".join(str(reference + 1) for reference in known)
            add(section, "Unknown", index=str(unknown + 1), dependencies=indices)
