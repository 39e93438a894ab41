"""What to do with a system: an experiment, and the checks that it fits the system.

Communication points are t_i = start + i h, never accumulated; a last shorter step lands on the stop
time. Times in s.
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

import numpy as np

from orchestration.errors import SystemDefinitionError
from orchestration.reference import Signal
from orchestration.system import CheckedSystem, Port

_MOST_POINTS = 1e9
GRID_TOLERANCE = 1e-9  # of a step: a time this close to a communication point is on it


class Algorithm(StrEnum):
    """Order in which components step and exchange."""

    JACOBI = "jacobi"
    GAUSS_SEIDEL = "gauss-seidel"


@dataclass(frozen=True)
class Event:
    """Variables to set at the first communication point at or after `time` [s]."""

    time: float
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Experiment:
    """What to do with a system.

    parameters, inputs: "component.variable" -> value, set before the initialisation
    signals: "component.variable" -> function of time, set at every communication point
    record: names of outputs and signals; empty means all of them
    """

    stop_time: float
    step_size: float
    start_time: float = 0.0
    algorithm: Algorithm = Algorithm.JACOBI
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    signals: Mapping[str, Signal] = field(default_factory=dict)
    events: tuple[Event, ...] = ()
    record: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not (math.isfinite(self.step_size) and self.step_size > 0.0):
            raise SystemDefinitionError(f"communication step size {self.step_size!r} s: expected more than 0")
        if not math.isfinite(self.start_time):
            raise SystemDefinitionError(f"start time {self.start_time!r} s: expected a finite number")
        if not (math.isfinite(self.stop_time) and self.stop_time > self.start_time):
            raise SystemDefinitionError(
                f"stop time {self.stop_time!r} s: expected more than the start time {self.start_time!r} s"
            )
        count = (self.stop_time - self.start_time) / self.step_size
        if count > _MOST_POINTS:
            raise SystemDefinitionError(
                f"{count:.3g} communication steps: expected at most {_MOST_POINTS:.0e}"
            )
        for event in self.events:
            if not self.start_time <= event.time <= self.stop_time:
                raise SystemDefinitionError(
                    f"event at {event.time!r} s: expected a time within the run, "
                    f"{self.start_time:g}..{self.stop_time:g} s"
                )

    def points(self) -> np.ndarray:
        """Communication points, first and last included."""
        duration = self.stop_time - self.start_time
        count = math.ceil(duration / self.step_size - GRID_TOLERANCE)
        points = self.start_time + np.arange(count + 1) * self.step_size
        points[-1] = self.stop_time
        return points


def checked_settings(checked: CheckedSystem, experiment: Experiment) -> list[tuple[Port, Any]]:
    """Parameters and constant inputs as (port, value), each checked against its declaration."""
    _check_events(checked, experiment)
    _check_capabilities(checked, experiment)
    for name in experiment.signals:
        kind = checked.ports[name].variable.type
        if kind != "Real":
            raise SystemDefinitionError(f"signal {name}: expected an input of type Real, got {kind}")
    given = [("parameter", experiment.parameters), ("input", experiment.inputs)]
    found = []
    for causality, values in given:
        for name, value in values.items():
            port = checked.port(name, causality)
            if port.variable.causality != causality:
                raise SystemDefinitionError(
                    f"{name}: expected a variable with causality {causality}, got {port.variable.causality}"
                )
            found.append((port, checked_value(port, value)))
    return found


def _check_events(checked: CheckedSystem, experiment: Experiment) -> None:
    driven = {target.name for _, target in checked.connections} | set(experiment.signals)
    for event in experiment.events:
        purpose = f"event at {event.time} s"
        for name, value in event.values.items():
            port = checked.port(name, purpose)
            checked_value(port, value)
            if port.variable.causality not in ("parameter", "input"):
                raise SystemDefinitionError(
                    f"{purpose}: {name}: expected a parameter or an input, got {port.variable.causality}"
                )
            if port.variable.variability == "fixed":
                raise SystemDefinitionError(f"{purpose}: {name} is fixed: only tunable parameters may change")
            if name in driven:
                raise SystemDefinitionError(f"{purpose}: {name} is driven already, by a connection or signal")


def _check_capabilities(checked: CheckedSystem, experiment: Experiment) -> None:
    """What the FMUs say that they cannot do."""
    points = experiment.points()
    last_is_shorter = points[-1] - points[-2] < experiment.step_size * (1.0 - GRID_TOLERANCE)
    for name, description in checked.descriptions.items():
        interface: Any = description.coSimulation
        if last_is_shorter and not interface.canHandleVariableCommunicationStepSize:
            raise SystemDefinitionError(
                f"{name} cannot vary its step size: expected a stop time that is a multiple of the step size"
            )
        copies = [other for other, path in checked.components.items() if path == checked.components[name]]
        if len(copies) > 1 and interface.canBeInstantiatedOnlyOncePerProcess:
            raise SystemDefinitionError(
                f"{', '.join(copies)}: expected one instance, the FMU can be instantiated only once"
            )


def checked_value(port: Port, value: Any) -> Any:
    """The value as the FMU wants it: enumeration items by name or number, numbers within min..max."""
    variable, name = port.variable, port.name
    if variable.type == "Enumeration" and isinstance(value, str):
        return _item(port, value)
    if variable.type == "String":
        return str(value)
    wanted = {"Real": (int, float), "Boolean": (bool,)}.get(variable.type, (int,))
    if not isinstance(value, wanted) or (variable.type != "Boolean" and isinstance(value, bool)):
        raise SystemDefinitionError(f"{name} = {value!r}: expected a value of type {variable.type}")
    if not abs(value) <= sys.float_info.max:
        raise SystemDefinitionError(f"{name} = {value!r}: expected a finite number")
    low, high = _limit(variable.min, -math.inf), _limit(variable.max, math.inf)
    if not low <= value <= high:
        unit = f" {variable.unit}" if variable.unit not in (None, "1") else ""
        raise SystemDefinitionError(f"{name} = {value!r}: expected {low:g}..{high:g}{unit}")
    return value


def _item(port: Port, name: str) -> int:
    """The number of an enumeration item."""
    declared = port.variable.declaredType
    items = {str(item.name): int(str(item.value)) for item in (declared.items or [])} if declared else {}
    if name not in items:
        raise SystemDefinitionError(f"{port.name} = {name!r}: expected one of {', '.join(items)}")
    return items[name]


def _limit(text: str | None, default: float) -> float:
    return default if text is None else float(text)
