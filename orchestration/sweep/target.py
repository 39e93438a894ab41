"""Targets of a sweep: a parameter, a constant input or signal, or a setting of the experiment."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from fmus.errors import nearest
from fmus.fmi.description import start_value
from fmus.fmi.variable_types import FmiValue
from orchestration.errors import ScenarioError
from orchestration.system.experiment import Algorithm, Experiment
from orchestration.system.signals import Constant
from orchestration.system.system import CheckedSystem, Port
from orchestration.system.values import fmi_value, value_range

_EXPERIMENT_UNITS = {"experiment.step_size": "s", "experiment.stop_time": "s", "experiment.algorithm": ""}
_PURPOSE = "sweep"

Settings = Mapping[str, Mapping[str, Any]]
"""Table of the scenario file -> key -> value, or the table of a constant signal."""


@dataclass(frozen=True)
class Target:
    """A target of a sweep: a name that it may vary.

    table, key: where a scenario file gives it; type: that of FMI 2.0, an enumeration's items are texts
    permitted: its range; base_value: without a sweep; port: None for a setting of the experiment
    """

    name: str
    table: str
    key: str
    unit: str
    type: str
    permitted: tuple[float, float]
    base_value: FmiValue
    port: Port | None

    def checked(self, value: FmiValue) -> FmiValue:
        """Returns the value as the table of results holds it; SystemDefinitionError if it cannot be set."""
        if self.port is None:
            return self._setting(value)
        number = fmi_value(self.port, value)
        if self.type == "Real":
            return float(number)
        if self.port.variable.type == "Enumeration":
            return _items(self.port).get(int(number), str(number))
        return number

    def entry(self, value: FmiValue) -> Any:
        """Returns what a scenario file gives for the value."""
        return {"kind": "constant", "value": value} if self.table == "signals" else value

    def within(self, value: float) -> float:
        """Returns the value, moved into the range if rounding has carried it out."""
        return min(max(value, self.permitted[0]), self.permitted[1])

    def _setting(self, value: FmiValue) -> FmiValue:
        if self.type == "String":
            known = [str(algorithm) for algorithm in Algorithm]
            if value not in known:
                raise ScenarioError(f"{self.name} = {value!r}: {nearest(str(value), known)}")
            return value
        low, high = self.permitted
        if isinstance(value, (int, float)) and not isinstance(value, bool) and low < value < high:
            return float(value)
        raise ScenarioError(f"{self.name} = {value!r}: expected more than {low:g} s")


def target(name: str, checked: CheckedSystem, experiment: Experiment) -> Target:
    """Returns the target of that name; an unknown one offers the nearest."""
    if name in _EXPERIMENT_UNITS:
        key = name.partition(".")[2]
        kind = "Real" if _EXPERIMENT_UNITS[name] else "String"
        least = experiment.start_time if key == "stop_time" else 0.0
        base_value = getattr(experiment, key)
        return Target(
            name, "experiment", key, _EXPERIMENT_UNITS[name], kind, (least, math.inf), base_value, None
        )
    if name.startswith("experiment.") and "experiment" not in checked.components:
        raise ScenarioError(
            f"{_PURPOSE}: the experiment has no {name!r} to vary; {nearest(name, _EXPERIMENT_UNITS)}"
        )
    port = checked.port(name, _PURPOSE)
    causality = port.variable.causality
    if causality not in ("parameter", "input"):
        raise ScenarioError(f"{_PURPOSE}: {name}: expected a parameter or an input, got {causality}")
    signal = experiment.signals.get(name)
    if causality == "input" and name not in experiment.inputs and not isinstance(signal, Constant):
        raise ScenarioError(
            f"{_PURPOSE}: {name} is driven by a connection or signal: expected a constant input"
        )
    if isinstance(signal, Constant):
        table, base_value = "signals", signal.value
    else:
        table = f"{causality}s"
        base_value = getattr(experiment, table).get(name, start_value(port.variable))
    return Target(
        name=name,
        table=table,
        key=name,
        unit=port.variable.unit or "",
        type="String" if port.variable.type == "Enumeration" else port.variable.type,
        permitted=value_range(port),
        base_value=base_value,
        port=port,
    )


def with_settings(experiment: Experiment, settings: Settings) -> Experiment:
    """Returns the experiment with other values; what has none stays the same object."""
    changes: dict[str, Any] = dict(settings.get("experiment", {}))
    if "algorithm" in changes:
        changes["algorithm"] = Algorithm(changes["algorithm"])
    if "signals" in settings:
        constants = {name: Constant(entry["value"]) for name, entry in settings["signals"].items()}
        changes["signals"] = {**experiment.signals, **constants}
    for table in ("parameters", "inputs"):
        if table in settings:
            changes[table] = {**getattr(experiment, table), **settings[table]}
    return replace(experiment, **changes)


def _items(port: Port) -> dict[int, str]:
    declared = port.variable.declaredType
    return {int(str(i.value)): str(i.name) for i in (declared.items or [])} if declared else {}
