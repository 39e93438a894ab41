"""FMUs with only a model description, which a scenario can name, or with a changed one."""

import zipfile
from collections.abc import Callable, Iterable
from pathlib import Path

from fmus.files import write_archive

XML = "modelDescription.xml"


def described(
    path: Path,
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    parameters: Iterable[str] = (),
    units: dict[str, str] | None = None,
) -> Path:
    """Writes an FMU with Real variables of these names; `NAME:TYPE` gives another type of FMI 2.0."""
    variables = []
    for causality, names in (("input", inputs), ("output", outputs), ("parameter", parameters)):
        for name, _, kind in (name.partition(":") for name in names):
            variability = "tunable" if causality == "parameter" else "continuous" if not kind else "discrete"
            value = {"": "0.0", "Boolean": "false"}.get(kind, "0")
            start = "" if causality == "output" else f' start="{value}"'
            unit = f' unit="{(units or {})[name]}"' if name in (units or {}) else ""
            variables.append(
                f'<ScalarVariable name="{name}" valueReference="{len(variables)}" causality="{causality}" '
                f'variability="{variability}"><{kind or "Real"}{start}{unit}/></ScalarVariable>'
            )
    text = (
        f'<fmiModelDescription fmiVersion="2.0" modelName="{path.stem}" guid="none">'
        '<CoSimulation modelIdentifier="described" canHandleVariableCommunicationStepSize="true"/>'
        f"<ModelVariables>{''.join(variables)}</ModelVariables><ModelStructure/></fmiModelDescription>"
    )
    return write_archive(path, {XML: text.encode()})


def members(path: Path) -> dict[str, bytes]:
    """Returns the content of each member of an archive by its name."""
    with zipfile.ZipFile(path) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


def redescribed(fmu: Path, path: Path, change: Callable[[str], str]) -> Path:
    """Writes a copy of an FMU with another model description."""
    content = members(fmu)
    return write_archive(path, content | {XML: change(content[XML].decode()).encode()})
