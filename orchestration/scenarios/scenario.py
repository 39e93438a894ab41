"""A scenario file (TOML) -> a system, an experiment and metrics, all plain data.

title = "..."
base = "other.toml"                       what is not said here is taken from there
parameter_files = ["parameters/x.toml"]   values with their provenance
[components]                              name = block name, or path of an .fmu
connections = [["a.output", "b.input"]]
[experiment]                              stop_time, step_size, start_time, algorithm, tolerance, ...
[step_sizes]                              component = its own step size
[parameters] / [inputs]                   "component.variable" = value
[signals."component.variable"]            kind = "ramps" | "cosine" | "constant" | "samples", ...
[[events]]                                time = ..., set = { "component.variable" = value }
[[faults]]                                input = "component.variable", kind = "freeze", ...
record = ["component.variable"]
[metrics.name]                            function = "rmse", ...
[sweep]                                   samples, seed, vary: many runs of it (docs/how-to/sweeps.md)
"""

import sys
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

from fmus.errors import nearest
from fmus.registry import Flavour, block_names, fmu_path
from orchestration.errors import ScenarioError
from orchestration.results import metrics
from orchestration.system.experiment import Algorithm, Event, Experiment, Initialisation
from orchestration.system.faults import Fault, fault
from orchestration.system.signals import Signal, signal
from orchestration.system.system import System

_Choice = TypeVar("_Choice", bound=StrEnum)
SHIPPED = Path(str(resources.files("orchestration.scenarios")))
_TABLES = {"components", "experiment", "parameters", "inputs", "signals", "metrics", "step_sizes", "sweep"}
_MERGED = _TABLES | {"vary"}  # of [sweep]
_KEYS = _TABLES | {"title", "connections", "events", "faults", "record", "base", "parameter_files"}
_EXPERIMENT_KEYS = {
    "start_time",
    "stop_time",
    "step_size",
    "algorithm",
    "extrapolation",
    "tolerance",
    "initialisation",
}


@dataclass(frozen=True)
class Scenario:
    """What to run and what to measure; `resolved` is the same as one self-contained file."""

    name: str
    title: str
    system: System
    experiment: Experiment
    metrics: Mapping[str, Mapping[str, Any]]
    resolved: Mapping[str, Any] = field(default_factory=dict)
    sweep: Mapping[str, Any] = field(default_factory=dict)


def shipped() -> dict[str, Path]:
    """Scenarios that come with the package, by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def find(name_or_path: str) -> Path:
    """The scenario file of that path, or of that name among the shipped ones."""
    if name_or_path.endswith(".toml"):
        path = Path(name_or_path)
        if path.is_file():
            return path
        beside = [each.name for each in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        raise ScenarioError(f"no scenario file {name_or_path}; beside it, {nearest(path.name, beside)}")
    known = shipped()
    if name_or_path not in known:
        raise ScenarioError(f"no scenario {name_or_path!r}; {nearest(name_or_path, known)}")
    return known[name_or_path]


def load(
    path: Path, overrides: Mapping[str, Any] | None = None, flavour: Flavour = Flavour.NATIVE
) -> Scenario:
    """Read a scenario file; `overrides` is laid over it as a scenario over its base.

    flavour: of our own blocks' FMUs.
    """
    data = _merge(_read(path, seen=()), dict(overrides or {}))
    _check_keys(data, _KEYS, path)
    for table in _TABLES:
        _typed(data.setdefault(table, {}), dict, f"{path}: {table}")
    data["metrics"] = {name: metric for name, metric in data["metrics"].items() if metric is not False}
    for name, metric in data["metrics"].items():
        _typed(metric, dict, f"{path}: metric {name}")
    metrics.check(data["metrics"], str(path))
    experiment = _experiment(data, path)
    metrics.check_run(
        data["metrics"], experiment.start_time, experiment.stop_time, experiment.record, str(path)
    )
    return Scenario(
        name=path.stem,
        title=_typed(data.get("title", path.stem), str, f"{path}: title"),
        system=System(
            components={name: _path(fmu, flavour) for name, fmu in _need(data, "components", path).items()},
            connections=_connections(data, path),
        ),
        experiment=experiment,
        metrics=data["metrics"],
        resolved=data,
        sweep=data["sweep"],
    )


def _read(path: Path, seen: tuple[Path, ...]) -> dict[str, Any]:
    """One file with its base and parameter files laid under it."""
    if path.resolve() in seen:
        raise ScenarioError(f"{path}: is its own base")
    data = read_toml(path)
    if isinstance(data.get("components"), dict):
        data["components"] = {name: _fmu(fmu, path) for name, fmu in data["components"].items()}
    base = _typed(data.pop("base", ""), str, f"{path}: base")
    named = path.parent / base if base.endswith(".toml") or not base else find(base)
    below = _read(named, (*seen, path.resolve())) if base else {}
    for file in _typed(data.pop("parameter_files", []), list, f"{path}: parameter_files"):
        named = path.parent / _typed(file, str, f"{path}: parameter_files")
        below = _merge(below, {"parameters": parameter_values(named)})
    return _merge(below, data)


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file; ScenarioError says what is wrong with it."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        beside = [each.name for each in path.parent.glob("*.toml")] if path.parent.is_dir() else []
        raise ScenarioError(f"no file {path}; beside it, {nearest(path.name, beside)}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: expected TOML: {error}") from error


def parameter_values(path: Path) -> dict[str, Any]:
    """ "component.variable" -> value of a parameter file, whose entries also tell provenance."""
    values = {}
    for name, entry in _typed(read_toml(path).get("parameters", {}), dict, f"{path}: parameters").items():
        if not isinstance(entry, dict) or "value" not in entry:
            raise ScenarioError(f"{path}: {name}: expected a table with a value")
        values[name] = entry["value"]
    return values


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        both_tables = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge(merged[key], value) if both_tables and key in _MERGED else value
    return merged


def _check_keys(data: Mapping[str, Any], known: set[str], path: Path) -> None:
    for key in data:
        if key not in known:
            raise ScenarioError(f"{path}: unknown key {key!r}; {nearest(key, known)}")


_NAMES = {dict: "a table", list: "a list", str: "a text"}


def _typed(value: Any, kind: type, what: str) -> Any:
    """The value if it is of that TOML type; the message says what it should be."""
    if not isinstance(value, kind):
        raise ScenarioError(f"{what}: expected {_NAMES[kind]}, got {value!r}")
    return value


def _need(data: Mapping[str, Any], key: str, path: Path) -> Any:
    if key not in data or data[key] == {}:
        raise ScenarioError(f"{path}: {key} is missing")
    return data[key]


def _fmu(name: Any, scenario: Path) -> str:
    """The name of a block, or the absolute path of an FMU named relative to its scenario file."""
    _typed(name, str, f"{scenario}: components")
    if name.endswith(".fmu"):
        return str((scenario.parent / name).absolute())
    if name not in block_names():
        raise ScenarioError(
            f"{scenario}: no block {name!r}, and a path must end in .fmu; {nearest(name, block_names())}"
        )
    return name


def _path(fmu: str, flavour: Flavour) -> Path:
    """File of an FMU; a block's is where `l1-depth build --cache` writes it."""
    return Path(fmu) if fmu.endswith(".fmu") else fmu_path(fmu, flavour)


def _connections(data: Mapping[str, Any], path: Path) -> tuple[tuple[str, str], ...]:
    found = []
    for entry in _typed(data.get("connections", []), list, f"{path}: connections"):
        if not (isinstance(entry, list) and len(entry) == 2 and all(isinstance(e, str) for e in entry)):
            raise ScenarioError(f'{path}: connections: expected ["a.output", "b.input"], got {entry!r}')
        found.append((entry[0], entry[1]))
    return tuple(found)


def _experiment(data: Mapping[str, Any], path: Path) -> Experiment:
    declared = _need(data, "experiment", path)
    _check_keys(declared, _EXPERIMENT_KEYS, path)
    return Experiment(
        stop_time=_seconds(_need(declared, "stop_time", path), "stop_time", path),
        step_size=_seconds(_need(declared, "step_size", path), "step_size", path),
        start_time=_seconds(declared.get("start_time", 0.0), "start_time", path),
        algorithm=_choice(Algorithm, declared.get("algorithm", Algorithm.JACOBI), "algorithm", path),
        parameters=data["parameters"],
        inputs=data["inputs"],
        signals={n: _signal(d, f"{path}: signal {n}") for n, d in data["signals"].items()},
        events=tuple(_event(e, path) for e in _typed(data.get("events", []), list, f"{path}: events")),
        record=tuple(
            _typed(name, str, f"{path}: record")
            for name in _typed(data.get("record", []), list, f"{path}: record")
        ),
        extrapolation=declared.get("extrapolation", 0),
        tolerance=_number(declared["tolerance"], "tolerance", path) if "tolerance" in declared else None,
        step_sizes={n: _seconds(size, f"step_sizes: {n}", path) for n, size in data["step_sizes"].items()},
        initialisation=_choice(
            Initialisation, declared.get("initialisation", Initialisation.AUTOMATIC), "initialisation", path
        ),
        faults=tuple(_fault(e, path) for e in _typed(data.get("faults", []), list, f"{path}: faults")),
    )


def _signal(declared: Any, what: str) -> Signal:
    return signal(_typed(declared, dict, what), what)


def _fault(entry: Any, path: Path) -> Fault:
    return fault(_typed(entry, dict, f"{path}: faults"), f"{path}: faults")


def _seconds(value: Any, name: str, path: Path) -> float:
    return _number(value, name, path, "a number of seconds")


def _number(value: Any, name: str, path: Path, wanted: str = "a number") -> float:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not abs(value) <= sys.float_info.max:
        raise ScenarioError(f"{path}: {name} = {value!r}: expected {wanted}")
    return float(value)


def _choice(choices: type[_Choice], name: Any, what: str, path: Path) -> _Choice:
    try:
        return choices(str(name))
    except ValueError:
        raise ScenarioError(
            f"{path}: unknown {what} {name!r}; {nearest(str(name), [str(each) for each in choices])}"
        ) from None


def _event(entry: Any, path: Path) -> Event:
    if not isinstance(entry, dict) or set(entry) != {"time", "set"}:
        raise ScenarioError(f"{path}: events: expected time and set, got {entry!r}")
    changes = _typed(entry["set"], dict, f"{path}: events: set")
    return Event(_seconds(entry["time"], "time", path), changes)
