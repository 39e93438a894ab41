"""The layers of a scenario from its files."""

from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from fmus.errors import nearest
from fmus.registry import block_names
from orchestration.errors import ScenarioError
from orchestration.scenarios.declarations import with_file_paths
from orchestration.scenarios.file_format import ParameterFile, ScenarioFile
from orchestration.scenarios.file_tables import At, check_part, checked
from orchestration.scenarios.layers import Data, Layer, merge
from orchestration.scenarios.toml_file import KeyPath, TomlFile, read_toml
from orchestration.system.quantities import stated

SHIPPED = Path(str(resources.files("orchestration.scenarios")))
FILE, _PARAMETERS = TypeAdapter(ScenarioFile), TypeAdapter(ParameterFile)
# those that a header [key] cannot begin
_ABOVE_TABLES = [key for key, x in ScenarioFile.model_fields.items() if isinstance(x.default, str | list)]
_OF_A_BASE = (("components",), ("experiment",), ("experiment", "stop_time"), ("experiment", "step_size"))


def shipped() -> dict[str, Path]:
    """Scenarios that come with the package, by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def shipped_bases() -> dict[str, Path]:
    """Returns the bases that the shipped scenarios share, by name; other files may use them too."""
    return {path.stem: path for path in sorted((SHIPPED / "base").glob("*.toml"))}


def find(name_or_path: str) -> Path:
    """Returns the scenario file of that path, or of that name among the shipped ones."""
    return _file(name_or_path, Path(), shipped())


def _file(name_or_path: str, folder: Path, known: Mapping[str, Path]) -> Path:
    if name_or_path.endswith(".toml"):
        return folder / name_or_path
    if name_or_path not in known:
        raise ScenarioError(f"no scenario {name_or_path!r}; {nearest(name_or_path, known)}")
    return known[name_or_path]


def file_layers(path: Path, above: tuple[Path, ...] = ()) -> list[Layer]:
    """Returns a file and its bases, the lowest first; above: the files that it is a base of."""
    if path.resolve() in above:
        raise ScenarioError(f"{path}: is its own base")
    file = read_toml(path)
    data = file.data
    check_part(FILE, data, file.at, absent=_OF_A_BASE, top=_ABOVE_TABLES)
    data |= components_and_names(data.get("components", {}), path.parent, file.at)
    if "signals" in data:
        data["signals"] = with_file_paths(data["signals"], path.parent)
    base = data.pop("base", "")
    below: list[Layer] = []
    if base:
        base_path = _file(base, path.parent, shipped() | shipped_bases())
        below = file_layers(base_path, (*above, path.resolve()))
        below[-1].data.pop("title", None)  # a scenario is not called as its base is
    own, parameter_files = with_parameter_files(data, path.parent)
    return [*below, Layer(own, file, tuple(reversed(parameter_files)))]


def with_parameter_files(data: Mapping[str, Any], folder: Path) -> tuple[Data, list[TomlFile]]:
    """Returns the data over the values of the parameter files that they name, and these files.

    folder: that the files are relative to
    """
    names = data.get("parameter_files", [])
    if isinstance(names, str):
        raise ScenarioError(f"parameter_files = {names!r}: expected a list")
    files = [read_toml(folder / name) for name in names]
    parameters = {name: value for file in files for name, value in stated_values(file).items()}
    own = {key: value for key, value in data.items() if key != "parameter_files"}
    return merge({"parameters": parameters}, own) if parameters else own, files


def stated_values(file: TomlFile) -> dict[str, Any]:
    """Returns the values of a parameter file by "component.variable"; one with a unit is a text."""
    values: dict[str, Any] = {}
    for name, entry in checked(_PARAMETERS, file.data, file.at).parameters.items():
        value, unit, place = entry.value, entry.unit, f"{file.at(('parameters', name))}: "
        values[name] = value
        if (type(value) is float and unit) or unit not in ("", "1"):
            if isinstance(value, bool | str):
                raise ScenarioError(f"{place}{name} = {value!r} has the unit {unit!r}: expected a number")
            values[name] = stated(f"{value!r} {unit}", place, str(file.path))
    return values


def components_and_names(given: Mapping[str, Any], folder: Path, at: At) -> Data:
    """Returns the tables `components` and `names` of [components]; folder: that paths are relative to."""
    tables = {name: entry if isinstance(entry, dict) else {"fmu": entry} for name, entry in given.items()}
    fmus = {name: table["fmu"] for name, table in tables.items() if "fmu" in table}
    names = {name: table["names"] for name, table in tables.items() if "names" in table}
    components = {
        n: fmu is not False and named_fmu(fmu, folder, at, ("components", n)) for n, fmu in fmus.items()
    }
    return {"components": components} | ({"names": names} if names else {})


def named_fmu(fmu: str, folder: Path, at: At, keys: KeyPath) -> str:
    """Returns the name of a known block, or the absolute path of an .fmu or a .py relative to a folder.

    at, keys: where it is named; begins the ScenarioError about a name that is none of these
    """
    if fmu.endswith((".fmu", ".py")) or ".py:" in fmu:
        return str((folder / fmu).absolute())
    known = block_names()
    if fmu not in known:
        raise ScenarioError(
            f"{at(keys)}: no block {fmu!r}, and a path must end in .fmu, .py or .py:Class; "
            f"{nearest(fmu, known)}"
        )
    return fmu
