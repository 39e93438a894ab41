"""The FMUs that scenarios name: where they are, what they are, and building those that need it.

The only file of this room that builds, for those who ask for a scenario: to load one does not.
"""

from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

from fmus.errors import ExportError, FmuLoadError
from fmus.fmi.description import describe, description_of
from fmus.fmi.model_description import ScalarVariable
from fmus.registry import BLOCKS, Flavour, fmu_path, installed
from fmus.registry import load as load_block
from orchestration.errors import ScenarioError
from orchestration.scenarios.layers import Layer, components_of


def fmu_file(fmu: str, flavour: Flavour = Flavour.NATIVE) -> Path:
    """Returns the file of an FMU: an .fmu as it is, or the place of a block's FMU.

    The FMU of a Python file's only block, or of a class, my.py:Policy, is made if it is missing or stale;
    ExportError if it cannot be.
    """
    if ".py:" in fmu:
        from fmus.generate.policy import fmu_of_class

        return fmu_of_class(fmu)
    if not fmu.endswith(".py"):
        return Path(fmu) if fmu.endswith(".fmu") else fmu_path(fmu, flavour)
    from fmus.generate import cache as builds

    if current := builds.BuildCache().current(builds.order_of_file(Path(fmu), flavour), to_run=True):
        return current[0]
    # imported here: it loads CasADi
    from fmus.generate import builder

    return builder.fmu_of_file(Path(fmu), flavour)


def build_missing(fmus: Iterable[Path]) -> None:
    """Builds the FMUs of our blocks that are missing or stale."""
    from fmus.generate import cache as builds

    if stale := builds.stale(fmus):
        from fmus.generate import builder

        builder.build_missing(stale)


def files_of(layers: Sequence[Layer], flavour: Flavour = Flavour.NATIVE) -> dict[str, Path]:
    """Returns FMU as the layers name it -> its file; makes the FMUs of Python files and classes."""
    files: dict[str, Path] = {}
    for component, fmu in components_of(layers).items():
        layer = [one for one in layers if component in one.data.get("components", {})][-1]
        try:
            files[fmu] = fmu_file(_from_here(fmu), flavour)
        except ExportError as error:
            where = layer.at(("components", component)) if layer.file else f"{component} = {_from_here(fmu)}"
            raise ScenarioError(f"{where}: {error}") from error
    return files


def _from_here(fmu: str) -> str:
    """Returns an FMU with a path relative to the present folder, if it lies there: messages name it so."""
    here = Path.cwd()
    return str(Path(fmu).relative_to(here)) if Path(fmu).is_relative_to(here) else fmu


def made_file(fmu: str, flavour: Flavour, files: Mapping[str, Path]) -> Path:
    """Returns the file of an FMU; for a Python file or a class, the one that was made before.

    Raises FmuLoadError if it was not made.
    """
    if fmu not in files and (fmu.endswith(".py") or ".py:" in fmu):
        raise FmuLoadError(f"{fmu}: its FMU was not made: l1-depth build {fmu} makes one")
    return files.get(fmu) or fmu_file(fmu, flavour)


def variables_of(fmu: str, file: Path) -> Mapping[str, ScalarVariable]:
    """Returns the variables of an FMU by name; of a block that is not built, as it declares them."""
    if not file.is_file() and fmu in installed(BLOCKS):
        return _declared(fmu)
    return {variable.name: variable for variable in describe(file).modelVariables}


@cache
def _declared(block: str) -> Mapping[str, ScalarVariable]:
    # imported here: it loads CasADi
    from fmus.generate.describe import model_description

    text = model_description(load_block(installed(BLOCKS)[block], "block"), block, {}, {})
    description = description_of(ElementTree.fromstring(text))
    return {variable.name: variable for variable in description.modelVariables}
