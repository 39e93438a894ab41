"""The model description of an FMU."""

import zipfile
from pathlib import Path
from typing import Any

import fmpy
from fmpy.model_description import ModelDescription

from fmus import catalogue
from fmus.errors import nearest
from orchestration.errors import FmuLoadError


def describe(path: Path) -> ModelDescription:
    """The model description of an FMI 2.0 co-simulation FMU; FmuLoadError says what is wrong."""
    if not path.is_file():
        folder = path.parent
        beside = [each.name for each in folder.glob("*.fmu")] if folder.is_dir() else []
        hint = (
            "; `l1-depth build` makes it"
            if path.parent in [flavour.folder for flavour in catalogue.Flavour]
            else ""
        )
        raise FmuLoadError(f"no FMU at {path}; in that folder, {nearest(path.name, beside)}{hint}")
    try:
        description: Any = fmpy.read_model_description(str(path), validate=False)
    except (zipfile.BadZipFile, EOFError, KeyError) as error:
        raise FmuLoadError(
            f"{path} is not an FMU: expected a zip with a modelDescription.xml: {error}"
        ) from error
    except Exception as error:  # fmpy raises bare exceptions on malformed XML
        reason = " ".join(str(error).split())
        raise FmuLoadError(f"{path}: the model description cannot be read: {reason}") from error
    if description.fmiVersion != "2.0" or description.coSimulation is None:
        raise FmuLoadError(f"{path}: expected FMI 2.0 for co-simulation, got FMI {description.fmiVersion}")
    _take_over_declared_types(description)
    return description


def _take_over_declared_types(description: ModelDescription) -> None:
    """Give each variable what only its SimpleType states: unit, range, nominal (FMI 2.0.5, 2.2.3)."""
    for variable in description.modelVariables:
        declared = variable.declaredType
        if declared is not None:
            for attribute in ("unit", "min", "max", "nominal"):
                if getattr(variable, attribute) is None:
                    setattr(variable, attribute, getattr(declared, attribute))
