"""The layers of a scenario, the lowest first: its bases, the file itself, and what a command lays over them.

Tables are merged key by key, lists are replaced. In a table, `false` removes an inherited entry. An input
that a layer drives in one way, by a connection, a signal or a constant, is not driven as in the layers below.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from fmus.errors import nearest
from fmus.registry import block_names
from orchestration.errors import ScenarioError
from orchestration.scenarios.file_format import ParameterFile, ScenarioFile
from orchestration.scenarios.file_tables import At, check_part, checked
from orchestration.scenarios.toml_file import KeyPath, TomlFile, read_toml
from orchestration.system.quantities import stated

SHIPPED = Path(__file__).parent
FILE, _PARAMETERS = TypeAdapter(ScenarioFile), TypeAdapter(ParameterFile)
# keys that a header [key] cannot begin
_ABOVE_TABLES = [key for key, x in ScenarioFile.model_fields.items() if isinstance(x.default, str | list)]
_OF_A_BASE = (("components",), ("experiment",), ("experiment", "stop_time"), ("experiment", "step_size"))
Data = dict[str, Any]
TABLES = ("components", "experiment", "parameters", "inputs", "signals", "metrics", "step_sizes", "sweep")
_MERGED = {*TABLES, "vary"}  # of [sweep]
_LISTS_AS_TABLES = ("connections", "record")
_DRIVING = ("connections", "inputs", "signals")


@dataclass(frozen=True)
class Layer:
    """The entries of one file, with its parameter files; or of a command, without a file."""

    data: Data
    file: TomlFile | None = None
    parameter_files: tuple[TomlFile, ...] = ()

    @property
    def files(self) -> tuple[TomlFile, ...]:
        """The file and its parameter files, whose values it goes over."""
        return (self.file, *self.parameter_files) if self.file else self.parameter_files

    def at(self, keys: KeyPath) -> str:
        """Returns the file and the line of these keys."""
        return self.file.at(keys) if self.file else "command line"


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
        # the title names the base's own experiment, not this scenario's
        below[-1].data.pop("title", None)
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

    at, keys: where it is named; begins the ScenarioError about another name
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


def with_file_paths(signals: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Returns the signals with the paths of files that are relative to a folder."""
    return {
        name: {**table, "file": str(folder / table["file"])}
        if isinstance(table, dict) and table.get("file")
        else table
        for name, table in signals.items()
    }


def components_of(layers: Sequence[Layer]) -> dict[str, str]:
    """Returns component -> block or path of its FMU, as the uppermost layer has it."""
    components: dict[str, str] = {}
    for layer in layers:
        components |= layer.data.get("components", {})
    return {name: fmu for name, fmu in components.items() if fmu}


def laid_over(
    data: Data, layer: Layer, is_boolean: Callable[[str], bool], joined: Collection[str] = ()
) -> Data:
    """Returns the data of the layers below with the data of a layer over them.

    is_boolean: whether a variable is, so that `false` is its value
    joined: inputs that something drives if the layers do not; `removed` lists those that a layer removes
    Raises ScenarioError for a removed entry that the layers below lack.
    """
    below = _without_other_drivers(data, layer.data)
    above = {name: value for name, value in layer.data.items() if name not in _LISTS_AS_TABLES}
    data = merge(below, above)
    for name, value in layer.data.items():
        if name == "connections":
            data[name] = _connections(below.get(name, []), value, layer, joined)
        elif name == "record":
            data[name] = _record(below.get(name, []), value, layer)
    _remove(data, below, layer, is_boolean, joined)
    return data


def driven_inputs(data: Data) -> set[str]:
    """Returns the inputs that the data of a layer drive."""
    driven = {target for _, target in given_connections(data)}
    return driven.union(*(data.get(table, {}) for table in ("inputs", "signals")))


def names_in(value: Any) -> Iterator[str]:
    """Yields the keys and the texts of a layer."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        yield from value
        value = list(value.values())
    for item in value if isinstance(value, list) else ():
        yield from names_in(item)


def merge(below: Data, above: Data) -> Data:
    """Returns `above` laid over `below`: tables key by key, anything else as a whole."""
    result = dict(below)
    for key, value in above.items():
        both_tables = isinstance(value, dict) and isinstance(result.get(key), dict)
        result[key] = merge(result[key], value) if both_tables and key in _MERGED else value
    return result


def given_connections(data: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yields (source, target) of the connections of a layer, whichever way they are written."""
    given = data.get("connections", [])
    if isinstance(given, dict):
        yield from ((source_of(source), target) for target, source in given.items() if source is not False)
    else:
        yield from ((source, target) for source, target, *_ in given)


def source_of(given: Any) -> str:
    """Returns the output of an entry of a table of connections."""
    return given["source"] if isinstance(given, dict) else given


def _listed(source: Any, target: str) -> list[Any]:
    """Returns an entry of a table of connections as a list has it."""
    if not isinstance(source, dict):
        return [source, target]
    return [source["source"], target, {key: value for key, value in source.items() if key != "source"}]


def _connections(below: list[Any], above: Any, layer: Layer, joined: Iterable[str]) -> list[Any]:
    if not isinstance(above, dict):
        return above
    _check_removed("connections", above, [*(target for _, target, *_ in below), *joined], layer)
    inherited = [connection for connection in below if connection[1] not in above]
    return [*inherited, *(_listed(source, target) for target, source in above.items() if source is not False)]


def _record(below: list[str], above: Any, layer: Layer) -> list[str]:
    if not isinstance(above, dict):
        return above
    if not below:
        raise ScenarioError(
            f"{layer.at(('record',))}: record: expected a list; "
            "a table changes the list of a base, and there is no base"
        )
    _check_removed("record", above, below, layer)
    added = (name for name, is_recorded in above.items() if is_recorded and name not in below)
    return [*(name for name in below if above.get(name, True)), *added]


def _remove(
    data: Data, below: Data, layer: Layer, is_boolean: Callable[[str], bool], joined: Collection[str]
) -> None:
    """Removes the components, signals, parameters and inputs that a layer gives as `false`."""
    _check_removed("components", layer.data.get("components", {}), below.get("components", {}), layer)
    _check_removed("signals", layer.data.get("signals", {}), [*below.get("signals", {}), *joined], layer)
    for table in ("components", "signals", "parameters", "inputs"):
        names = {name for name, value in layer.data.get(table, {}).items() if value is False}
        removed = {name for name in names & {*below.get(table, {}), *joined} if not is_boolean(name)}
        if removed:
            data[table] = {name: value for name, value in data[table].items() if name not in removed}
    tables = [entries for table in _DRIVING if isinstance(entries := layer.data.get(table), dict)]
    names = {name for entries in tables for name, value in entries.items() if value is False}
    undriven = [name for name in joined if name in names and not is_boolean(name)]
    data["removed"] = [*data.get("removed", []), *undriven]


def _check_removed(table: str, given: Mapping[str, Any], below: Iterable[str], layer: Layer) -> None:
    names = list(below)
    for name, value in given.items():
        if value is False and name not in names:
            entry = f'{table}."{name}" = false'
            raise ScenarioError(
                f"{layer.at((table, name))}: {entry}: nothing to remove; {nearest(name, names)}"
            )


def _without_other_drivers(below: Data, above: Data) -> Data:
    """Returns `below` without what drives or changes an input that `above` drives in another way."""
    driven = {table: {k for k, v in above.get(table, {}).items() if v is not False} for table in _DRIVING[1:]}
    # `false` is the value of a Boolean input there, not a removal
    driven["inputs"] |= above.get("inputs", {}).keys() - below.get("inputs", {})
    driven["connections"] = {target for _, target in given_connections(above)}
    result = dict(below)
    for table in _DRIVING:
        others: set[str] = set().union(*(names for other, names in driven.items() if other != table))
        entries = below.get(table)
        if isinstance(entries, dict):
            result[table] = {name: value for name, value in entries.items() if name not in others}
        elif entries:
            result[table] = [connection for connection in entries if connection[1] not in others]
    changed = {*below.get("signals", {}), *(target for _, target in given_connections(below))}
    constant = driven["inputs"] & changed
    if "faults" in below:
        result["faults"] = [fault for fault in below["faults"] if fault["input"] not in constant]
    if "events" in below:
        moved = driven["signals"] | driven["connections"]
        result["events"] = with_events(below["events"], lambda name, value: name not in moved)
    return result


def with_events(events: list[Any], is_kept: Callable[[str, Any], bool]) -> list[Any]:
    """Returns the events with those variables and values that `is_kept` approves."""
    changed = [{**e, "set": {k: v for k, v in e["set"].items() if is_kept(k, v)}} for e in events]
    return [event for event, old in zip(changed, events, strict=True) if event["set"] or not old["set"]]
