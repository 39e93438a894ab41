"""Block -> modelDescription.xml of FMI 2.0.5 for co-simulation.

Everything explicit: causality, variability, initial, units, ranges, enumerations, dependencies. In
step mode no output depends directly on an input; in initialisation mode outputs follow the inputs.
"""

import hashlib
import os
import uuid
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any
from xml.etree import ElementTree

from fmus.block import Block, BlockVariable
from fmus.block.units import display, unit
from fmus.build.symbolic import initial_dependencies
from fmus.errors import ExportError
from fmus.files import xml_document

# They stand for the GUID, and for a part of it in Python names, until it is known.
GUID, GUID_IN_NAMES = "GUID-of-this-FMU", "GUID_of_this_FMU"
LOG_CATEGORIES = {
    "logStatusWarning": "Something that the user should know.",
    "logStatusDiscard": "A step that was refused; the state is what it was before.",
    "logStatusError": "A call that was refused; the state is what it was before.",
    "logStatusFatal": "The instance can not be used any more.",
    "logAll": "Every message.",
}

_CAPABILITIES = {
    "needsExecutionTool": "false",
    "canHandleVariableCommunicationStepSize": "true",
    "canRunAsynchronuously": "false",
    "canBeInstantiatedOnlyOncePerProcess": "false",
    "canGetAndSetFMUstate": "true",
    "canSerializeFMUstate": "true",
}


def model_description(
    block: Block,
    guid: str,
    capabilities: dict[str, str],
    source_files: Sequence[str] = (),
    dependencies: Mapping[int, Sequence[int]] | None = None,
) -> bytes:
    """Returns the XML of a block; capabilities: the attributes of `CoSimulation` that the flavour decides.

    source_files: what an importer must compile to rebuild the FMU, inside the folder `sources`.
    dependencies: as `initial_dependencies`, which traces the block, returns them by default

    Raises ExportError for a unit that `fmus.block.units` does not know.
    """
    release = version("l1-depth")
    attributes = {
        "fmiVersion": "2.0",
        "modelName": block.name,
        "guid": guid,
        "description": block.description,
        "author": block.author,
        "version": block.version,
        "license": block.license,
        "generationTool": f"l1-depth {release}",
        "generationDateAndTime": _generation_date(),
        "variableNamingConvention": "structured",
    }
    root = ElementTree.Element("fmiModelDescription", _without_none(attributes))
    interface = _add(root, "CoSimulation", modelIdentifier=block.name, **(_CAPABILITIES | capabilities))
    listed = _add(interface, "SourceFiles") if source_files else interface
    for file in source_files:
        _add(listed, "File", name=file)
    _units(root, block)
    _enumerations(root, block)
    categories = _add(root, "LogCategories")
    for name, description in LOG_CATEGORIES.items():
        _add(categories, "Category", name=name, description=description)
    times = {"startTime": "0", "stopTime": repr(block.stop_time), "stepSize": repr(block.step_size)}
    _add(root, "DefaultExperiment", **times)
    variables = _add(root, "ModelVariables")
    for variable in block.variables:
        _variable(variables, variable)
    _structure(root, block, initial_dependencies(block) if dependencies is None else dependencies)
    text = xml_document(root)
    try:
        ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ExportError(f"{block.name}: expected texts that XML can hold: {error}") from error
    return text


def _add(parent: Any, tag: str, **attributes: str | None) -> Any:
    return ElementTree.SubElement(parent, tag, _without_none(attributes))


def _without_none(attributes: dict[str, str | None]) -> dict[str, str]:
    return {name: value for name, value in attributes.items() if value is not None}


def _generation_date() -> str | None:
    """Returns the date of SOURCE_DATE_EPOCH, None without it: two builds of one source are the same file."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    return datetime.fromtimestamp(int(epoch), UTC).strftime("%Y-%m-%dT%H:%M:%SZ") if epoch else None


def _units(root: Any, block: Block) -> None:
    definitions = _add(root, "UnitDefinitions")
    for name in sorted({v.unit for v in block.variables if v.unit is not None}):
        definition, base = _add(definitions, "Unit", name=name), unit(name)
        exponents = {symbol: str(exponent) for symbol, exponent in base.exponents.items()}
        _add(definition, "BaseUnit", **exponents, **_linear(base.factor, base.offset))
        shown = {v.display_unit for v in block.variables if v.unit == name and v.display_unit is not None}
        for other in sorted(shown):
            _add(definition, "DisplayUnit", name=other, **_linear(*display(name, other)))


def _linear(factor: float, offset: float) -> dict[str, str]:
    """Returns the attributes of a conversion, where they are not the defaults of FMI."""
    values = {"factor": (factor, 1.0), "offset": (offset, 0.0)}
    return {name: repr(value) for name, (value, default) in values.items() if value != default}


def _enumerations(root: Any, block: Block) -> None:
    enumerations = {v.enumeration.__name__: v.enumeration for v in block.variables if v.enumeration}
    definitions = _add(root, "TypeDefinitions") if enumerations else root
    for name, enumeration in sorted(enumerations.items()):
        description = (enumeration.__doc__ or "").partition("\n")[0]
        simple = _add(definitions, "SimpleType", name=name, description=description)
        items = _add(simple, "Enumeration")
        for member in enumeration:
            _add(items, "Item", name=member.name.lower(), value=str(member.value))


def _variable(parent: Any, v: BlockVariable) -> None:
    source = f" ({v.source})" if v.source else ""
    scalar = _add(
        parent,
        "ScalarVariable",
        name=v.name,
        valueReference=str(v.value_reference),
        description=v.description + source,
        causality=v.causality,
        variability=v.variability,
        initial=v.initial,
    )
    limits = {"min": _text(v.minimum), "max": _text(v.maximum)} if v.type in ("Real", "Integer") else {}
    start, nominal = _text(v.start) if v.settable else None, _text(v.nominal)
    declared = v.enumeration.__name__ if v.enumeration else None
    units = {"unit": v.unit, "displayUnit": v.display_unit}
    _add(scalar, v.type, declaredType=declared, **limits, nominal=nominal, **units, start=start)


def _text(value: Any) -> str | None:
    if value is None:
        return None
    if isinstance(value, bool):
        return str(value).lower()
    return repr(value) if isinstance(value, float) else str(int(value))


def _structure(root: Any, block: Block, dependencies: Mapping[int, Sequence[int]]) -> None:
    structure = _add(root, "ModelStructure")
    outputs = _add(structure, "Outputs")
    for v in block.of_causality("output"):
        _add(outputs, "Unknown", index=str(v.value_reference + 1), dependencies="")
    initial = _add(structure, "InitialUnknowns")
    for unknown, known in sorted(dependencies.items()):
        indices = " ".join(str(reference + 1) for reference in known)
        _add(initial, "Unknown", index=str(unknown + 1), dependencies=indices)


def with_guid(members: dict[str, bytes], recipe: str = "") -> tuple[str, dict[str, bytes]]:
    """Returns a GUID that follows from members and recipe, and the members with it in names and contents."""
    digest = hashlib.sha256(recipe.encode())
    for name, data in sorted(members.items()):
        digest.update(hashlib.sha256(name.encode()).digest() + hashlib.sha256(data).digest())
    guid = str(uuid.uuid5(uuid.NAMESPACE_OID, digest.hexdigest()))
    for placeholder, text in ((GUID, guid), (GUID_IN_NAMES, guid.replace("-", "")[:16])):
        members = {
            name.replace(placeholder, text): data.replace(placeholder.encode(), text.encode())
            for name, data in members.items()
        }
    return guid, members
