"""Changes of a scenario: settings that are laid over its files, and values that a loaded one is given.

A name of a change is "component.variable"; of a setting also a component, for another FMU in its place; of a
value also "experiment.step_size" and the other `EXPERIMENT_SETTINGS`.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmus.errors import nearest
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.scenarios.interface import Describe, components_between
from orchestration.scenarios.layers import (
    Data,
    Layer,
    components_and_names,
    components_of,
    with_file_paths,
    with_parameter_files,
)
from orchestration.system.experiment import Experiment
from orchestration.system.quantities import StatedValue, read_value, stated
from orchestration.system.signals import Constant
from orchestration.system.system import Port
from orchestration.system.values import Value, fmi_value

EXPERIMENT_SETTINGS = {"experiment.step_size": "s", "experiment.stop_time": "s", "experiment.algorithm": ""}
"""Settings of an experiment that differ between runs of a sweep -> unit."""


def given_layers(
    layers: Sequence[Layer], overrides: Mapping[str, Any], settings: Mapping[str, FmiValue]
) -> list[Layer]:
    """Returns the layers of a file, and over them one of overrides and of FMUs that settings name.

    Paths in it are relative to the present folder. `values_of_settings` refuses other settings.
    """
    given, parameter_files = with_parameter_files(overrides, Path())
    entries = _command_entries(given, settings, components_of(layers))
    return [*layers, Layer(entries, None, tuple(reversed(parameter_files)))]


def _command_entries(
    overrides: Mapping[str, Any], settings: Mapping[str, FmiValue], known: Collection[str]
) -> Data:
    if "base" in overrides:
        raise ScenarioError(f"base = {overrides['base']!r}: expected it in the scenario file that is loaded")
    own = {name: {"fmu": str(fmu)} for name, fmu in settings.items() if name in known}
    given = {n: x if isinstance(x, dict) else {"fmu": x} for n, x in overrides.get("components", {}).items()}
    entries = {n: given.get(n, {}) | own.get(n, {}) for n in (*given, *own)}
    above = components_and_names(
        entries, Path(), lambda keys: f"{keys[-1]} = {entries[str(keys[-1])]['fmu']}"
    )
    above["signals"] = with_file_paths(overrides.get("signals", {}), Path())
    below = {table: value for table, value in overrides.items() if table not in above}
    return below | {table: value for table, value in above.items() if value}


def values_of_settings(settings: Mapping[str, FmiValue], layers: Sequence[Layer], describe: Describe) -> Data:
    """Returns the tables of a scenario file that the values of variables stand in.

    layers: the last is the command's (`given_layers`)
    Raises ScenarioError for a setting that names no component, parameter or input.
    """
    components = {**components_between(layers), **components_of(layers)}
    below, tables = components_of(layers[:-1]), Data()

    def settable_of(component: str) -> dict[str, ScalarVariable]:
        variables = describe(components[component]).items()
        return {name: v for name, v in variables if v.causality in ("parameter", "input")}

    for name, value in settings.items():
        component, dot, variable = name.partition(".")
        known, purpose = (components, "") if dot else (below, " to replace")
        if component not in known:
            meant = [] if dot else [f"{c}.{name}={value}" for c in components if name in settable_of(c)]
            hint = nearest(component, known) + ("" if dot else "; of a variable, component.variable=value")
            hint = f"expected {' or '.join(meant)}" if meant else hint
            raise ScenarioError(f"{name} = {value!r}: no component {component!r}{purpose}; {hint}")
        if not dot:
            continue
        settable, given, text = settable_of(component), value, f"{variable}={value}"
        names = [text[:i] for i, sign in enumerate(text) if sign == "=" and text[:i] in settable]
        if names and isinstance(value, StatedValue):  # the longest one: a name may have "="
            variable, rest = names[-1], text[len(names[-1]) + 1 :]
            given = stated(rest, value.place, value.file, value.units)
        if variable not in settable:
            if (file := getattr(value, "file", "")) and component not in settings:
                raise ScenarioError(f"{file}: {other_fmu(name, components[component])}")
            hint = nearest(name, (f"{component}.{known}" for known in settable))
            raise ScenarioError(f"{name} = {value!r}: expected a parameter or an input; {hint}")
        port = Port(component, settable[variable])
        if isinstance(given, StatedValue):
            # refuses a wrong value, with its place
            fmi_value(port, given)
            given = read_value(given, port.variable)
        tables.setdefault(f"{port.variable.causality}s", {})[port.name] = given
    return tables


def other_fmu(name: str, fmu: str) -> str:
    """Returns the message about a parameter of a file that was written for another FMU."""
    component = name.partition(".")[0]
    option = f"--{component} " if component in ("controller", "plant") else f"--set {component}="
    return (
        f"{name}: {component} is {Path(fmu).stem}, which has no such parameter: expected the {component} "
        f"that the file is for, {option}FMU"
    )


def table_of_value(name: str, experiment: Experiment) -> str:
    """Returns the table of a scenario file in which a value stands that an experiment is given."""
    if name in EXPERIMENT_SETTINGS:
        return "experiment"
    return next(
        (table for table in ("signals", "inputs") if name in getattr(experiment, table)), "parameters"
    )


def tables_of_values(values: Mapping[str, Value], experiment: Experiment) -> Data:
    """Returns the values in the tables of a scenario file; a constant signal is a table."""
    tables: Data = {}
    for name, value in values.items():
        table = table_of_value(name, experiment)
        key = name.partition(".")[2] if table == "experiment" else name
        entry = {"kind": "constant", "value": value} if table == "signals" else value
        tables.setdefault(table, {})[key] = entry
    return tables


def with_values(experiment: Experiment, values: Mapping[str, Value]) -> Experiment:
    """Returns the experiment with other values; unchanged members stay the same objects."""
    tables = tables_of_values(values, experiment)
    changed = tables.pop("experiment", {})
    if "signals" in tables:
        tables["signals"] = {name: Constant(entry["value"]) for name, entry in tables["signals"].items()}
    for table, entries in tables.items():
        changed[table] = {**getattr(experiment, table), **entries}
    return replace(experiment, **changed)
