"""Differences of two model descriptions, FMI 2.0 or 3.0, and of the files of two FMUs."""

import zipfile
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from fmus.errors import listed
from fmus.files import write_archive
from fmus.fmi.description import describe, start_value
from fmus.fmi.model_description import ModelDescription, ScalarVariable
from orchestration.diff.change import Change, Level
from orchestration.system.quantities import are_equal

_CONNECTED = ("input", "output", "parameter", "structuralParameter")
# attribute of a variable -> level of another value
_ATTRIBUTES = {
    "type": Level.MAJOR,
    "causality": Level.MAJOR,
    "variability": Level.MINOR,
    "min": Level.MINOR,
    "max": Level.MINOR,
    "nominal": Level.PATCH,
    "description": Level.PATCH,
}
_LIMITING = (
    "needsExecutionTool",
    "canBeInstantiatedOnlyOncePerProcess",
    "canNotUseMemoryManagementFunctions",
)
# identifiers differ in every build, and no importer's model holds them
_IDENTIFIERS = ("modelIdentifier",)
# that the description of FMI 3.0 does not hold
_OF_FMI2 = ("canInterpolateInputs", "canRunAsynchronuously", _LIMITING[-1], "providesDirectionalDerivative")
_DESCRIPTION = "modelDescription.xml"


def of_interfaces(fmu: Path, folder: Path) -> dict[str, Path]:
    """Returns each interface of an FMU with the FMU that has it: of model exchange beside co-simulation,
    a copy in the folder without co-simulation, which the master would run. FmuLoadError as `describe`.
    """
    if describe(fmu).is_model_exchange:
        return {"ModelExchange": fmu}
    with zipfile.ZipFile(fmu) as archive:
        root = ElementTree.fromstring(archive.read(_DESCRIPTION))
        if root.find("ModelExchange") is None:
            return {"CoSimulation": fmu}
        members = {name: archive.read(name) for name in archive.namelist() if name[-1] != "/"}
    root.remove(*root.findall("CoSimulation"))
    copy = write_archive(folder / fmu.name, members | {_DESCRIPTION: ElementTree.tostring(root)})
    return {"CoSimulation": fmu, "ModelExchange": copy}


def interface_changes(old: Path, new: Path) -> list[Change]:
    """Returns the differences of the interfaces; FmuLoadError for a file that is no FMU."""
    one, other = describe(old), describe(new)
    found = [*_of_variables(one, other), *_of_dependencies(one, other), *_of_capabilities(one, other)]
    return [Change(level, "interface", text) for level, text in found]


def _of_variables(one: ModelDescription, other: ModelDescription) -> Iterator[tuple[Level, str]]:
    before, after = ({v.name: v for v in d.modelVariables} for d in (one, other))
    for name, variable in before.items():
        if name not in after:
            level = Level.MAJOR if variable.causality in _CONNECTED else Level.MINOR
            yield level, f"{variable.causality} {name} is gone"
        else:
            yield from _of_variable(variable, after[name])
    for name in (name for name in after if name not in before):
        level = Level.MINOR if after[name].causality in _CONNECTED else Level.PATCH
        yield level, f"{after[name].causality} {name} is new"


def _of_variable(one: ScalarVariable, other: ScalarVariable) -> Iterator[tuple[Level, str]]:
    for attribute, level in _ATTRIBUTES.items():
        a, b = getattr(one, attribute), getattr(other, attribute)
        if a != b and not _are_one_number(a, b):
            yield level, f"{one.name}: {attribute} {a} -> {b}"
    is_equal = are_equal(one.unit, other.unit, other.units, one.units)
    if (one.unit or "") != (other.unit or "") or not is_equal:
        yield Level.MAJOR, f"{one.name}: unit {one.unit} -> {other.unit}"
    if one.type == other.type and start_value(one) != start_value(other):
        yield Level.MINOR, f"{one.name}: start {one.start} -> {other.start}"


def _are_one_number(a: str | None, b: str | None) -> bool:
    try:
        return float(a or "") == float(b or "")
    except ValueError:
        return False


def _of_dependencies(one: ModelDescription, other: ModelDescription) -> Iterator[tuple[Level, str]]:
    before, after = (
        {
            unknown.variable.name: None
            if unknown.dependencies is None
            else sorted(v.name for v in unknown.dependencies)
            for unknown in d.outputs
        }
        for d in (one, other)
    )
    for name in (name for name in before if name in after):
        if before[name] != after[name]:
            a, b = ("any" if x is None else listed(x, 3) or "none" for x in (before[name], after[name]))
            yield Level.MINOR, f"{name}: dependencies {a} -> {b}"


def _of_capabilities(one: ModelDescription, other: ModelDescription) -> Iterator[tuple[Level, str]]:
    if one.fmiVersion != other.fmiVersion:
        yield Level.MAJOR, f"FMI {one.fmiVersion} -> {other.fmiVersion}"
    passed_over = _IDENTIFIERS if one.fmiVersion[0] == other.fmiVersion[0] else (*_IDENTIFIERS, *_OF_FMI2)
    for name, a in vars(one.coSimulation).items():
        b = getattr(other.coSimulation, name)
        if a != b and name not in passed_over:
            is_lost = b if name in _LIMITING else a
            yield Level.MAJOR if is_lost else Level.MINOR, f"{name} {str(a).lower()} -> {str(b).lower()}"
    for name in ("numberOfContinuousStates", "numberOfEventIndicators"):
        a, b = getattr(one, name), getattr(other, name)
        if a != b:
            yield Level.PATCH, f"{name} {a} -> {b}"
    times = [vars(d.defaultExperiment) if d.defaultExperiment else {} for d in (one, other)]
    for name in ("startTime", "stopTime", "stepSize"):
        a, b = (own.get(name) for own in times)
        if a != b and not _are_one_number(a, b):
            yield Level.MINOR, f"default experiment: {name} {a} -> {b}"


def file_changes(old: Path, new: Path) -> list[Change]:
    """Returns the differences of libraries, sources and other files: gone, new or with other content."""
    before, after = (_checksums(path) for path in (old, new))
    changes: list[Change] = []
    for verb, names in (
        ("gone", before.keys() - after.keys()),
        ("new", after.keys() - before.keys()),
        ("other content", {n for n in before.keys() & after.keys() if before[n] != after[n]}),
    ):
        for kind in sorted({name.partition("/")[0] for name in names}):
            own = sorted(name for name in names if name.partition("/")[0] == kind)
            level = Level.PATCH
            if kind == "binaries" and verb != "other content":
                level = Level.MAJOR if verb == "gone" else Level.MINOR
            changes.append(Change(level, "files", f"{verb}: {listed(own, 3)}"))
    return changes


def _checksums(path: Path) -> dict[str, tuple[int, int]]:
    """Returns the name of each file but the model description -> its checksum and size."""
    with zipfile.ZipFile(path) as archive:
        files = [file for file in archive.infolist() if not file.is_dir()]
    return {file.filename: (file.CRC, file.file_size) for file in files if file.filename != _DESCRIPTION}
