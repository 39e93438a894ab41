"""Scenario files (TOML) -> a system, an experiment and metrics. `file_format` declares what a file contains.

A file is laid over its base, and `overrides` over both (`layers`).
"""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from fmpy.model_description import ModelDescription
from pydantic import TypeAdapter

from fmus.errors import nearest
from fmus.fmi_types import FmiValue
from fmus.registry import Flavour, block_names, fmu_path
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.fmi.description import describe
from orchestration.results import metrics
from orchestration.scenarios.declarations import fault, signal
from orchestration.scenarios.file_format import ParameterFile, ScenarioFile
from orchestration.scenarios.file_tables import check_part, checked
from orchestration.scenarios.layers import TABLES, Layer, merge, merged
from orchestration.scenarios.replaced import Describe, replacements, without_misfits, without_removed
from orchestration.scenarios.toml_file import KeyPath, TomlFile, read_toml
from orchestration.system.experiment import Event, Experiment
from orchestration.system.system import System

SHIPPED = Path(str(resources.files("orchestration.scenarios")))
_FILE, _PARAMETERS = TypeAdapter(ScenarioFile), TypeAdapter(ParameterFile)
_OF_A_BASE = (("components",), ("experiment",), ("experiment", "stop_time"), ("experiment", "step_size"))


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


def shipped_bases() -> dict[str, Path]:
    """What the shipped scenarios share, by name: files that others may have as their base."""
    return {path.stem: path for path in sorted((SHIPPED / "base").glob("*.toml"))}


def find(name_or_path: str) -> Path:
    """The scenario file of that path, or of that name among the shipped ones."""
    return Path(name_or_path) if name_or_path.endswith(".toml") else _named(name_or_path, shipped())


def _named(name: str, known: Mapping[str, Path]) -> Path:
    if name not in known:
        raise ScenarioError(f"no scenario {name!r}; {nearest(name, known)}")
    return known[name]


def load(
    path: Path,
    overrides: Mapping[str, Any] | None = None,
    flavour: Flavour = Flavour.NATIVE,
    *,
    settings: Mapping[str, FmiValue] | None = None,
    build: Callable[[Path], object] = lambda fmu: None,
) -> Scenario:
    """Read a scenario file; `overrides` is laid over it as a scenario over its base.

    flavour: of our own blocks' FMUs
    settings: "component.variable" -> value of a parameter or a constant input, and component -> the FMU or
    block in its place; laid over all
    build: called with the file of an FMU whose model description is needed to load the scenario
    Warns (ScenarioWarning) of inherited entries that do not fit an FMU which replaces that of the base.
    """
    layers = [*_layers(path, bases=()), Layer(_with_paths(overrides or {}))]
    layers.append(Layer(_replaced_components(layers, settings or {})))
    files = [file for layer in reversed(layers) for file in layer.files]
    components = _components(layers)

    @cache
    def description(component: str) -> ModelDescription:
        file = _path(components[component], flavour)
        build(file)
        return describe(file)

    layers.append(Layer(_settings(settings or {}, components, description)))
    fitting = without_misfits(layers, replacements(layers, description))
    data = {"title": path.stem, **{table: {} for table in TABLES}, **merged(fitting)}
    for table in ("parameters", "inputs"):
        data[table] = without_removed(data[table], table, fitting, description)
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
            components={name: _path(fmu, flavour) for name, fmu in data["components"].items()},
            connections=tuple((source, target) for source, target in data.get("connections", [])),
        ),
        experiment=experiment,
        metrics=data["metrics"],
        resolved=data,
        sweep=data["sweep"],
        files=tuple(files),
    )


def _layers(path: Path, bases: tuple[Path, ...]) -> list[Layer]:
    """A file and its bases, the lowest first."""
    if path.resolve() in bases:
        raise ScenarioError(f"{path}: is its own base")
    file = read_toml(path)
    data = file.data
    check_part(_FILE, data, file.at, absent=_OF_A_BASE)
    if "components" in data:
        data["components"] = {name: _fmu(name, fmu, file) for name, fmu in data["components"].items()}
    base = data.pop("base", "")
    below: list[Layer] = []
    if base:
        base_path = (
            path.parent / base if base.endswith(".toml") else _named(base, shipped() | shipped_bases())
        )
        below = _layers(base_path, (*bases, path.resolve()))
        below[-1].data.pop("title", None)  # a scenario is not called as its base is
    parameters: dict[str, Any] = {}
    files = [file]
    for name in data.pop("parameter_files", []):
        files.insert(1, read_toml(path.parent / name))
        parameters |= _values_of(files[1])
    own = merge({"parameters": parameters}, data) if parameters else data
    return [*below, Layer(own, tuple(files))]


def _components(layers: Sequence[Layer]) -> dict[str, str]:
    """Component -> block or path of its FMU, as the uppermost layer has it."""
    return merged(Layer({"components": layer.data.get("components", {})}, layer.files) for layer in layers)[
        "components"
    ]


def _replaced_components(layers: Sequence[Layer], settings: Mapping[str, FmiValue]) -> dict[str, Any]:
    """The table of components, of those settings that name one."""
    known = _components(layers)
    replaced = {name: str(fmu) for name, fmu in settings.items() if "." not in name}
    for name, fmu in replaced.items():
        if name not in known:
            raise ScenarioError(f"{name} = {fmu!r}: no component {name!r} to replace; {nearest(name, known)}")
    return _with_paths({"components": replaced} if replaced else {})


def _settings(
    settings: Mapping[str, FmiValue], components: Mapping[str, str], description: Describe
) -> dict[str, dict[str, FmiValue]]:
    """The tables of a scenario file that the values of variables stand in."""
    tables: dict[str, dict[str, FmiValue]] = {}
    for name, value in settings.items():
        component, dot, variable = name.partition(".")
        if not dot:
            continue
        if component not in components:
            hint = nearest(component, components)
            raise ScenarioError(f"{name} = {value!r}: no component {component!r}; {hint}")
        causalities = {v.name: v.causality for v in description(component).modelVariables}
        settable = {name: c for name, c in causalities.items() if c in ("parameter", "input")}
        if variable not in settable:
            hint = nearest(name, (f"{component}.{known}" for known in settable))
            raise ScenarioError(f"{name} = {value!r}: expected a parameter or an input; {hint}")
        tables.setdefault(f"{settable[variable]}s", {})[name] = value
    return tables


def parameter_values(path: Path) -> dict[str, Any]:
    """ "component.variable" -> value of a parameter file, whose entries also tell provenance."""
    return _values_of(read_toml(path))


def _values_of(file: TomlFile) -> dict[str, Any]:
    parameters = checked(_PARAMETERS, file.data, file.at).parameters
    return {name: entry.value for name, entry in parameters.items()}


def fmu_of(fmu: str, folder: Path, where: str) -> str:
    """The name of a block, or the absolute path of an FMU named relative to a folder.

    where: begins the ScenarioError about a name that is neither
    """
    if fmu.endswith(".fmu"):
        return str((folder / fmu).absolute())
    if fmu not in block_names():
        raise ScenarioError(
            f"{where}: no block {fmu!r}, and a path must end in .fmu; {nearest(fmu, block_names())}"
        )
    return fmu


def _fmu(component: str, fmu: str | bool, scenario: TomlFile) -> str | bool:
    if isinstance(fmu, bool):
        return fmu
    return fmu_of(fmu, scenario.path.parent, scenario.at(("components", component)))


def _with_paths(overrides: Mapping[str, Any]) -> dict[str, Any]:
    """The overrides, the paths of their FMUs relative to the present folder."""
    components = {n: fmu_of(f, Path(), f"{n} = {f}") for n, f in overrides.get("components", {}).items()}
    return {**overrides, **({"components": components} if components else {})}


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
