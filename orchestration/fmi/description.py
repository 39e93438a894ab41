"""The model description of an FMU."""

import zipfile
from itertools import product
from pathlib import Path
from typing import Any

import fmpy
from fmpy.model_description import ModelDescription, ScalarVariable

from fmus.errors import nearest
from fmus.fmi_types import FmiValue
from fmus.registry import block_fmus
from orchestration.errors import FmuLoadError


def describe(path: Path) -> ModelDescription:
    """The model description of an FMI 2.0 co-simulation FMU; FmuLoadError says what is wrong."""
    if not path.is_file():
        folder = path.parent
        beside = [other.name for other in folder.glob("*.fmu")]
        for block, flavour in block_fmus([path]):
            command = f"l1-depth build --cache --flavour {flavour} {block}"
            raise FmuLoadError(f"the FMU of block {block} is not built: {command} writes {path}")
        raise FmuLoadError(f"no FMU at {path}; in that folder, {nearest(path.name, beside)}")
    try:
        description: Any = fmpy.read_model_description(str(path), validate=False)
    except (zipfile.BadZipFile, EOFError, KeyError) as error:
        raise FmuLoadError(
            f"{path} is not an FMU: expected a zip with a modelDescription.xml: {error}"
        ) from error
    except Exception as error:  # fmpy raises bare exceptions on malformed XML
        reason = " ".join(str(error).split())
        raise FmuLoadError(f"{path}: the model description cannot be read: {reason}") from error
    if description.fmiVersion != "2.0":
        raise FmuLoadError(f"{path} is an FMU of FMI {description.fmiVersion}: expected FMI 2.0")
    if description.coSimulation is None:
        raise FmuLoadError(f"{path} is for model exchange alone: expected an FMU for co-simulation")
    identifier = str(description.coSimulation.modelIdentifier)
    if not (identifier.isascii() and identifier.isidentifier()):  # a path would lead out of the archive
        raise FmuLoadError(f"{path}: modelIdentifier {identifier!r}: expected a C identifier")
    _take_over_declared_types(description)
    return description


def of_causality(description: ModelDescription, causality: str) -> list[ScalarVariable]:
    """The variables of a causality, in the order of the model description."""
    return [variable for variable in description.modelVariables if variable.causality == causality]


def start_value(variable: ScalarVariable) -> FmiValue:
    """The start value in the Python type of the variable; 0, False or "" where none is given."""
    text = str(variable.start or "")
    if variable.type == "String":
        return text
    if variable.type == "Boolean":
        return text.lower() in ("true", "1")
    return float(text or 0) if variable.type == "Real" else int(text or 0)


def _take_over_declared_types(description: ModelDescription) -> None:
    """Give each variable what only its SimpleType states: unit, range, nominal (FMI 2.0.5, 2.2.3)."""
    for variable, attribute in product(description.modelVariables, ("unit", "min", "max", "nominal")):
        if getattr(variable, attribute) is None:
            setattr(variable, attribute, getattr(variable.declaredType, attribute, None))
