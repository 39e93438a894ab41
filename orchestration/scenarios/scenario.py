"""Scenario files (TOML) -> a system, an experiment and metrics. `file_format` declares what a file contains.

A file is laid over its base, and `overrides` over both: tables key by key, anything else as a whole.
"""

import re
from collections.abc import Mapping, Sequence
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
from orchestration.scenarios.toml_file import KeyPath, TomlFile, read_toml
from orchestration.system.experiment import Event, Experiment
from orchestration.system.system import System

SHIPPED = Path(str(resources.files("orchestration.scenarios")))
_FILE, _PARAMETERS = TypeAdapter(ScenarioFile), TypeAdapter(ParameterFile)
_OF_A_BASE = (("components",), ("experiment",), ("experiment", "stop_time"), ("experiment", "step_size"))
_TABLES = ("components", "experiment", "parameters", "inputs", "signals", "metrics", "step_sizes", "sweep")
_MERGED = {*_TABLES, "vary"}  # of [sweep]


@dataclass(frozen=True)
class Scenario:
    """What to run and what to measure.

    resolved: the same as one self-contained file; files: those that it was read from, the uppermost first
    """

    name: str
    title: str
    system: System
    experiment: Experiment
    metrics: Mapping[str, Mapping[str, Any]]
    resolved: Mapping[str, Any] = field(default_factory=dict)
    sweep: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[TomlFile, ...] = ()


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
    own, files = _read(path, bases=())
    data = {"title": path.stem, **{table: {} for table in _TABLES}, **_merge(own, dict(overrides or {}))}
    if not data["components"]:
        raise ScenarioError(f"{path}: components is missing")
    data["metrics"] = {name: metric for name, metric in data["metrics"].items() if metric is not False}
    file = checked(_FILE, data, lambda keys: str(path))
    try:
        experiment = _experiment(file, data)
        metrics.check_run(data["metrics"], experiment.start_time, experiment.stop_time, experiment.record)
    except (ScenarioError, SystemDefinitionError) as error:
        raise ScenarioError(located(str(error), files)) from error
    return Scenario(
        name=path.stem,
        title=file.title,
        system=System(
            components={name: _path(fmu, flavour) for name, fmu in file.components.items()},
            connections=tuple((source, target) for source, target in file.connections),
        ),
        experiment=experiment,
        metrics=data["metrics"],
        resolved=data,
        sweep=data["sweep"],
        files=tuple(files),
    )


def _read(path: Path, bases: tuple[Path, ...]) -> tuple[dict[str, Any], list[TomlFile]]:
    """A file with its base and parameter files laid under it; and these files, the uppermost first."""
    if path.resolve() in bases:
        raise ScenarioError(f"{path}: is its own base")
    file = read_toml(path)
    data = file.data
    check_part(_FILE, data, file.at, absent=_OF_A_BASE)
    if "components" in data:
        data["components"] = {name: _fmu(name, fmu, file) for name, fmu in data["components"].items()}
    base = data.pop("base", "")
    below: dict[str, Any] = {}
    files = []
    if base:
        base_path = path.parent / base if base.endswith(".toml") else find(base)
        below, files = _read(base_path, (*bases, path.resolve()))
        below.pop("title", None)  # a scenario is not called as its base is
    for name in data.pop("parameter_files", []):
        files.insert(0, read_toml(path.parent / name))
        below = _merge(below, {"parameters": _values_of(files[0])})
    return _merge(below, data), [file, *files]


def parameter_values(path: Path) -> dict[str, Any]:
    """ "component.variable" -> value of a parameter file, whose entries also tell provenance."""
    return _values_of(read_toml(path))


def _values_of(file: TomlFile) -> dict[str, Any]:
    parameters = checked(_PARAMETERS, file.data, file.at).parameters
    return {name: entry.value for name, entry in parameters.items()}


def _merge(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    merged = dict(below)
    for key, value in above.items():
        both_tables = isinstance(value, dict) and isinstance(merged.get(key), dict)
        merged[key] = _merge(merged[key], value) if both_tables and key in _MERGED else value
    return merged


def _fmu(component: str, fmu: str, scenario: TomlFile) -> str:
    """The name of a block, or the absolute path of an FMU named relative to its scenario file."""
    if fmu.endswith(".fmu"):
        return str((scenario.path.parent / fmu).absolute())
    if fmu not in block_names():
        raise ScenarioError(
            f"{scenario.at(('components', component))}: no block {fmu!r}, and a path must end in .fmu; "
            f"{nearest(fmu, block_names())}"
        )
    return fmu


def _path(fmu: str, flavour: Flavour) -> Path:
    """File of an FMU; a block's is where `l1-depth build --cache` writes it."""
    return Path(fmu) if fmu.endswith(".fmu") else fmu_path(fmu, flavour)


def _experiment(file: ScenarioFile, data: Mapping[str, Any]) -> Experiment:
    return Experiment(
        **file.experiment.given(),
        parameters=data["parameters"],
        inputs=data["inputs"],
        signals={name: signal(declared, f'signals."{name}"') for name, declared in data["signals"].items()},
        events=tuple(Event(event.time, event.set) for event in file.events),
        record=tuple(file.record),
        step_sizes=file.step_sizes,
        faults=tuple(fault(declared, f"faults[{i}]") for i, declared in enumerate(data.get("faults", []))),
    )


def located(message: str, files: Sequence[TomlFile]) -> str:
    """A message about a scenario after its file, and the line of what it names.

    files: of the scenario, the uppermost first; a line of another file stands at the end
    """
    names = re.findall(r"[A-Za-z_]\w*\.[\w.\[\]]*[\w\]]", message)
    tables: list[KeyPath] = [("metrics", name) for name in re.findall(r"metric (\w+):", message)]
    tables += [("step_sizes", name) for name in re.findall(r"step size of (\w+)", message)]
    tables += [("signals", name) for name in re.findall(r'signals\."(.+?)"', message)]
    tables += [("faults", int(index)) for index in re.findall(r"faults\[(\d+)\]", message)]
    for file in files:
        keys = [key for key in tables if key in file.lines]
        keys += [key for key in file.lines if _is_spoken_of(key, message)]
        lines = [file.lines[key] for key in keys] or [
            n for name in names if (n := file.line_that_names(name))
        ]
        if lines and file is files[0]:
            return f"{file.path}:{lines[0]}: {message}"
        if lines:
            return f"{files[0].path}: {message} ({file.path}:{lines[0]})"
    return f"{files[0].path}: {message}"


def _is_spoken_of(keys: KeyPath, message: str) -> bool:
    """Whether a message speaks of a setting of the experiment: step_size as "step size"."""
    return keys[0] == "experiment" and len(keys) == 2 and str(keys[1]).replace("_", " ") in message
