"""The model description of an FMU."""

import zipfile
from collections import Counter
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

from fmus.errors import FmuLoadError, nearest
from fmus.fmi.fmi3_description import fmi3_description
from fmus.fmi.model_description import ModelDescription, ScalarVariable, model_description
from fmus.fmi.variable_types import FmiValue
from fmus.registry import block_fmus, block_names, is_in_cache
from fmus.store import is_own_build, keep_fmus, reason_for_distrust
from fmus.units import of_differences

# descriptions that stay in memory
_MOST_DESCRIPTIONS = 256


class FileVersion(NamedTuple):
    """Version of a file: another version differs in one of these."""

    path: Path
    inode: int
    size: int
    # ns; a copy may keep the first of these times, but not the second
    modified: int
    changed: int

    @staticmethod
    def of(path: Path) -> "FileVersion":
        status = path.stat()
        return FileVersion(
            path.absolute(), status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns
        )


def describe(path: Path) -> ModelDescription:
    """Returns the model description of an FMU; it is shared by all callers, who must not change it.

    Parameters
    ----------
    path : Path
        The FMU, of FMI 2.0 or 3.0. The file is read once while it does not change.

    Returns
    -------
    ModelDescription
        The description with complete variables; of FMI 3.0, in the terms of FMI 2.0.

    Raises
    ------
    FmuLoadError
        If the file is missing or no FMU of these versions. The message names the file and the reason.
    """
    if not path.is_file():
        if path.exists():
            raise FmuLoadError(f"{path} is a folder, or no regular file: expected an FMU")
        folder = path.parent
        beside = [other.name for other in folder.glob("*.fmu")]
        for block, flavour in block_fmus([path]):
            command = f"l1-depth build --cache --flavour {flavour} {block}"
            raise FmuLoadError(f"the FMU of block {block} is not built: {command} writes {path}")
        # the name of the FMU may be the name of a block that is not built
        name = path.stem
        build = f"; l1-depth build {name} writes fmus-built/{name}.fmu" if name in block_names() else ""
        raise FmuLoadError(f"no FMU at {path}; in that folder, {nearest(path.name, beside)}{build}")
    return _read(path, FileVersion.of(path))


@lru_cache(_MOST_DESCRIPTIONS)
def _read(path: Path, version: FileVersion) -> ModelDescription:
    keep_fmus()
    if is_in_cache(path) and (reason := reason_for_distrust(path)):
        raise FmuLoadError(reason)
    try:
        with zipfile.ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            # where FMI 3.0 lists the sources
            is_built = "sources/buildDescription.xml" in archive.namelist()
    except (zipfile.BadZipFile, EOFError, KeyError) as error:
        raise FmuLoadError(
            f"{path} is not an FMU: expected a zip with a modelDescription.xml: {error}"
        ) from error
    except (LookupError, ValueError) as error:
        raise _unreadable(path, ValueError(f"{error}: expected XML in UTF-8 (FMI 2.0.5, 2.2)")) from error
    # unpacking and parsing a damaged file raise errors of many kinds
    except Exception as error:
        raise _unreadable(path, error) from error
    fmi_version = root.get("fmiVersion", "")
    if fmi_version != "2.0" and not fmi_version.startswith("3."):
        raise FmuLoadError(f"{path} is an FMU of FMI {fmi_version}: expected FMI 2.0 or 3.0")
    try:
        description = model_description(root) if fmi_version == "2.0" else fmi3_description(root)
    except ValueError as error:
        raise _unreadable(path, error) from error
    identifier = description.coSimulation.modelIdentifier
    # such an identifier could lead out of the folder of the unpacked FMU
    if not identifier or set(identifier) & set("/\\:") or ".." in identifier:
        raise FmuLoadError(f"{path}: modelIdentifier {identifier!r}: expected a C identifier")
    names = Counter([*(variable.name for variable in description.modelVariables), *description.left_out])
    if repeated := [name for name, count in names.items() if count > 1]:
        raise FmuLoadError(f"{path}: {names[repeated[0]]} variables are called {repeated[0]!r}: expected one")
    _complete_variables(description)
    # Native FMUs of this exporter list sources: other FMUs, which may be large, need not be read.
    has_sources = is_built or root.find("CoSimulation/SourceFiles") is not None
    description.is_own_build = has_sources and is_own_build(path.read_bytes())
    return description


def description_of(root: ElementTree.Element) -> ModelDescription:
    """Returns the content of a modelDescription.xml of FMI 2.0 with complete variables."""
    description = model_description(root)
    _complete_variables(description)
    return description


def _unreadable(path: Path, error: Exception) -> FmuLoadError:
    return FmuLoadError(f"{path}: the model description cannot be read: {' '.join(str(error).split())}")


def is_independent(description: ModelDescription) -> bool:
    """Whether an FMU is a native one that a build of this user wrote."""
    # Instances of these share no memory, also within one library, and change nothing in the process, as
    # `tests/fmus/native/test_no_globals.py` proves. Any other FMU may do anything, whatever tool it names,
    # and so may the Python code of a block.
    return description.is_own_build


def of_causality(description: ModelDescription, causality: str) -> list[ScalarVariable]:
    """Returns the variables of a causality, in the order of the model description."""
    return [variable for variable in description.modelVariables if variable.causality == causality]


def start_value(variable: ScalarVariable) -> FmiValue:
    """Returns the start value in the Python type of the variable; 0, False or "" without one."""
    text = str(variable.start or "")
    if variable.type == "String":
        return text
    if variable.type == "Boolean":
        return text.lower() in ("true", "1")
    return float(text or 0) if variable.type == "Real" else int(text or 0)


def has_start_value(variable: ScalarVariable) -> bool:
    """Whether a variable that is no input can be set before the initialisation (FMI 2.0.5, 4.2.4)."""
    never = ("input", "independent", "structuralParameter")
    if variable.variability == "constant" or variable.causality in never:
        return False
    return variable.causality == "parameter" or variable.initial in ("exact", "approx")


def _complete_variables(description: ModelDescription) -> None:
    """Gives each variable the unit definitions and the attributes of its SimpleType (FMI 2.0.5, 2.2.3)."""
    units = {
        unit.name: unit.baseUnit
        for unit in description.unitDefinitions
        if unit.baseUnit and unit.baseUnit.factor
    }
    relative = of_differences(units)
    for variable in description.modelVariables:
        variable.units = relative if variable.is_relative else units
    for variable, attribute in product(description.modelVariables, ("unit", "min", "max", "nominal")):
        if getattr(variable, attribute) is None:
            setattr(variable, attribute, getattr(variable.declaredType, attribute, None))
