"""Scenario files (TOML) -> a system, an experiment and metrics. `file_format` declares what a file contains.

A file is laid over its base, and `overrides` over both (`layers`).
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from fmus.errors import FmuLoadError
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import FmiValue
from fmus.registry import Flavour
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.results import metrics
from orchestration.scenarios.changes import given_layers, other_fmu, values_of_settings
from orchestration.scenarios.composition import compose, with_actuators
from orchestration.scenarios.declarations import (
    as_input_takes,
    check_overlap,
    faults_of,
    signals_of,
    with_faulted_constants,
)
from orchestration.scenarios.file_tables import checked
from orchestration.scenarios.fmu_files import files_of, made_file, variables_of
from orchestration.scenarios.interface import Describe
from orchestration.scenarios.layers import (
    FILE,
    SHIPPED,
    TABLES,
    Data,
    Layer,
    file_layers,
    find,
    shipped,
)
from orchestration.scenarios.toml_file import TomlFile, placed
from orchestration.system.experiment import Event, Experiment
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.signal_derivatives import with_derivatives
from orchestration.system.system import Port, System
from orchestration.system.values import fmi_value

__all__ = ["SHIPPED", "Scenario", "find", "load", "load_scenario", "shipped"]


@dataclass(frozen=True)
class Scenario:
    """A scenario: a system, its experiment and the metrics.

    Attributes
    ----------
    name, title : str
        Name of the file, and title in results and figures.
    system : System
        The FMUs and their connections.
    experiment : Experiment
        Times, values, signals, events, faults and recorded variables.
    metrics : mapping
        Name -> function, its arguments and perhaps a unit.
    resolved : mapping
        The scenario as one file without a base.
    sweep : mapping
        The table `sweep`, empty if there is no sweep.
    files : tuple of TomlFile
        The files that were read, the uppermost first.
    arguments : tuple of str
        Arguments with which a command line loads the scenario again.
    from_actuators : mapping
        "component.parameter" -> value that follows from the actuators of another vehicle.
    """

    name: str
    title: str
    system: System
    experiment: Experiment
    metrics: Mapping[str, Mapping[str, Any]]
    resolved: Mapping[str, Any] = field(default_factory=dict)
    sweep: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[TomlFile, ...] = ()
    arguments: tuple[str, ...] = ()
    from_actuators: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def prepared(self) -> PreparedRun:
        """The run, checked and prepared; raises what `prepare` and `check_recorded` raise."""
        prepared = prepare(self.system, self.experiment)
        metrics.check_recorded(self.metrics, prepared.recorded)
        return prepared


def load(
    path: Path,
    overrides: Mapping[str, Any] | None = None,
    flavour: Flavour = Flavour.NATIVE,
    *,
    layers: Sequence[Layer] = (),
    settings: Mapping[str, FmiValue] | None = None,
    made: Mapping[str, Path] | None = None,
) -> Scenario:
    """Reads a scenario file; `overrides` is laid over it as a scenario over its base. Nothing is built.

    overrides: files that they name are relative to the present folder
    flavour: of our own blocks' FMUs
    layers: of the file, if they were read before, and of what else lies below `overrides`
    settings: "component.variable" -> value of a parameter or a constant input, and component -> the FMU or
    block in its place; checked and laid over all
    made: Python file or class -> its FMU
    Warns (ScenarioWarning) where an FMU that replaces the base's may not be the intended one.
    """
    made = made or {}
    layers = given_layers(layers or file_layers(path), overrides or {}, settings or {})
    files = [file for layer in reversed(layers) for file in layer.files]

    @cache
    def describe(fmu: str) -> Mapping[str, ScalarVariable]:
        return variables_of(fmu, made_file(fmu, flavour, made))

    layers.append(Layer(values_of_settings(settings or {}, layers, describe)))
    with placed(files):
        composed = compose(layers, describe)
        data = {"title": path.stem, **{table: {} for table in TABLES}, **composed.data}
        if not data["components"]:
            raise ScenarioError("components is missing")
        data, from_actuators = with_actuators(data, layers, composed)
        data = _converted(data, composed.interface.port)
    for replacement in composed.replacements:
        replacement.check(data)
    data["metrics"] = {name: metric for name, metric in data["metrics"].items() if metric is not False}
    _check_parameters([f for x in layers for f in x.parameter_files], data, describe)
    file = checked(FILE, data, lambda keys: str(path))
    times = file.experiment.given()
    with placed(files):
        data = with_faulted_constants(data)
        port, given = composed.interface.port, data["signals"].items()
        data["signals"] = {name: as_input_takes(name, x, port) for name, x in given}
        check_overlap(data["signals"], times.get("start_time", 0.0), times["stop_time"])
        signals, faults = signals_of(data["signals"]), faults_of(data.get("faults", []))
        experiment = Experiment(
            **times,
            parameters=data["parameters"],
            inputs=data["inputs"],
            signals=with_derivatives(signals, data["inputs"], data.get("connections", [])),
            events=tuple(Event(event.time, event.set) for event in file.events),
            record=tuple(file.record),
            step_sizes=file.step_sizes,
            faults=faults,
        )
        metrics.check_run(data["metrics"], experiment.start_time, experiment.stop_time, experiment.record)
    if dotted := [name for name in data["components"] if "." in name]:
        raise SystemDefinitionError(f"component {dotted[0]!r}: expected a name without a dot", dotted[0])
    return Scenario(
        name=path.stem,
        title=file.title,
        system=System(
            components={name: made_file(fmu, flavour, made) for name, fmu in data["components"].items()},
            connections=data.get("connections", []),
        ),
        experiment=experiment,
        metrics=data["metrics"],
        resolved=data,
        sweep=data["sweep"],
        files=tuple(files),
        from_actuators={n: v for n, v in from_actuators.items() if data["parameters"].get(n) == v},
        arguments=(path.stem if shipped().get(path.stem) == path else str(path),),
    )


def _converted(data: Data, port: Callable[[str], Port | None]) -> Data:
    """Returns the data with numbers in the units of the variables; raises SystemDefinitionError."""
    result = {**data, **{table: dict(data.get(table, {})) for table in ("parameters", "inputs")}}
    for entries in (result["parameters"], result["inputs"]):
        for name, value in entries.items():
            with suppress(FmuLoadError):
                # values of an FMU that is not built yet are converted when it runs
                if isinstance(value, str) and (own := port(name)) and own.variable.type == "Real":
                    entries[name] = fmi_value(own, value)
    return result


def _check_parameters(files: Sequence[TomlFile], data: Data, describe: Describe) -> None:
    """Refuses parameter files with a parameter that its component lacks: they are for another FMU."""
    for file in files:
        for name in (name for name in file.data.get("parameters", {}) if name in data["parameters"]):
            component, _, variable = name.partition(".")
            fmu = data["components"].get(component)
            with suppress(FmuLoadError):
                # an FMU that is not built yet is checked when it runs
                if fmu and variable not in describe(fmu):
                    raise ScenarioError(f"{file.at(('parameters', name))}: {other_fmu(name, fmu)}")


def load_scenario(
    scenario: str | Path,
    overrides: Mapping[str, Any] | None = None,
    *,
    settings: Mapping[str, FmiValue] | None = None,
) -> Scenario:
    """Returns the shipped scenario of a name, or the scenario of a file that ends with .toml.

    Parameters
    ----------
    scenario : str or Path
        The name or the file.
    overrides : mapping, optional
        Tables as in a file, laid over it.
    settings : mapping, optional
        "component.variable" -> value of a parameter or a constant input; component -> FMU or block.

    Returns
    -------
    Scenario
        System, experiment and metrics. FMUs of blocks have to be built to run it: `l1-depth build --cache`.

    Raises
    ------
    ScenarioError
        For a mistake in a file or an argument; it names file and line.

    Examples
    --------
    >>> scenario = load_scenario("nominal-extended", settings={"plant.inertia": 6.0})
    >>> scenario.experiment.parameters["plant.inertia"]
    6.0
    """
    path = find(str(scenario))
    layers = file_layers(path)
    made = files_of(given_layers(layers, overrides or {}, settings or {}))
    return load(path, overrides, layers=layers, settings=settings, made=made)
