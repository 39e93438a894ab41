"""FMUs that hold a model description and no library: enough to load a scenario and to check a system."""

import zipfile
from collections.abc import Iterable
from pathlib import Path


def described(
    path: Path,
    inputs: Iterable[str] = (),
    outputs: Iterable[str] = (),
    parameters: Iterable[str] = (),
    units: dict[str, str] | None = None,
) -> Path:
    """Write an FMU with Real variables of these names; `NAME:TYPE` has another type of FMI 2.0."""
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
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
    return path
