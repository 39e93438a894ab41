"""Scenario files (TOML) -> a system, an experiment and metrics. `file_format` declares what a file contains.

A file is laid over its base, and `overrides` over both: tables key by key, anything else as a whole.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from fmus.errors import nearest
from fmus.registry import Flavour, block_names, fmu_path
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.results import metrics
from orchestration.scenarios.declarations import fault, signal
from orchestration.scenarios.file_format import ParameterFile, ScenarioFile
from orchestration.scenarios.file_tables import check_part, checked
from orchestration.system.experiment import Event, Experiment
from orchestration.system.system import System

SHIPPED = Path(str(resources.files("orchestration.scenarios")))
_FILE, _PARAMETERS = TypeAdapter(ScenarioFile), TypeAdapter(ParameterFile)
_OF_A_BASE = (("components",), ("experiment",), ("experiment", "stop_time"), ("experiment", "step_size"))
_TABLES = ("components", "experiment", "parameters", "inputs", "signals", "metrics", "step_sizes", "sweep")
_MERGED = {*_TABLES, "vary"}  # of [sweep]


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
        return Path(name_or_path)
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
    data = {**{table: {} for table in _TABLES}, **_merge(_read(path, bases=()), dict(overrides or {}))}
    if not data["components"]:
        raise ScenarioError(f"{path}: components is missing")
    data["metrics"] = {name: metric for name, metric in data["metrics"].items() if metric is not False}
    file = checked(_FILE, data, str(path))
    try:
        experiment = _experiment(file, data, path)
    except SystemDefinitionError as error:
        raise ScenarioError(f"{path}: {error}") from error
    metrics.check_run(
        data["metrics"], experiment.start_time, experiment.stop_time, experiment.record, str(path)
    )
    return Scenario(
        name=path.stem,
        title=file.title or path.stem,
        system=System(
            components={name: _path(fmu, flavour) for name, fmu in file.components.items()},
            connections=tuple((source, target) for source, target in file.connections),
        ),
        experiment=experiment,
        metrics=data["metrics"],
        resolved=data,
        sweep=data["sweep"],
    )


def _read(path: Path, bases: tuple[Path, ...]) -> dict[str, Any]:
    """One file with its base and parameter files laid under it."""
    if path.resolve() in bases:
        raise ScenarioError(f"{path}: is its own base")
    data = read_toml(path)
    check_part(_FILE, data, str(path), absent=_OF_A_BASE)
    if "components" in data:
        data["components"] = {name: _fmu(fmu, path) for name, fmu in data["components"].items()}
    base = data.pop("base", "")
    below: dict[str, Any] = {}
    if base:
        below = _read(path.parent / base if base.endswith(".toml") else find(base), (*bases, path.resolve()))
    for file in data.pop("parameter_files", []):
        below = _merge(below, {"parameters": parameter_values(path.parent / file)})
    return _merge(below, data)


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file; ScenarioError says what is wrong with it."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        beside = (file.name for file in path.parent.glob("*.toml"))
        raise ScenarioError(f"no file {path}; beside it, {nearest(path.name, beside)}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ScenarioError(f"{path}: expected TOML: {error}") from error


def parameter_values(path: Path) -> dict[str, Any]:
    """ "component.variable" -> value of a parameter file, whose entries also tell provenance."""
    file = checked(_PARAMETERS, read_toml(path), str(path))
    return {name: entry.value for name, entry in file.parameters.items()}


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        both_tables = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge(merged[key], value) if both_tables and key in _MERGED else value
    return merged


def _fmu(name: str, scenario: Path) -> str:
    """The name of a block, or the absolute path of an FMU named relative to its scenario file."""
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


def _experiment(file: ScenarioFile, data: Mapping[str, Any], path: Path) -> Experiment:
    return Experiment(
        **file.experiment.given(),
        parameters=data["parameters"],
        inputs=data["inputs"],
        signals={
            name: signal(declared, f'{path}: signals."{name}"') for name, declared in data["signals"].items()
        },
        events=tuple(Event(event.time, event.set) for event in file.events),
        record=tuple(file.record),
        step_sizes=file.step_sizes,
        faults=tuple(
            fault(declared, f"{path}: faults[{i}]") for i, declared in enumerate(data.get("faults", []))
        ),
    )
