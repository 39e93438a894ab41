"""What to do with a system: an experiment, and the checks that it fits the system.

Communication points are t_i = start + i h, never accumulated; a last shorter step lands on the stop
time. Times in s.
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from typing import Any

import numpy as np

from fmus.errors import nearest
from orchestration.errors import SystemDefinitionError
from orchestration.system.faults import Fault, Stuck
from orchestration.system.signals import Signal
from orchestration.system.system import CheckedSystem, Port
from orchestration.system.time_grid import GRID_TOLERANCE, within

_MOST_POINTS = 1e9
_INTEGERS = (-(2**31), 2**31 - 1)  # fmi2Integer
_MEMBERS = {"events": "Event", "faults": "Fault", "record": "names"}
# type of FMI 2.0 -> the functions that get and set it; others do not travel
TRAVELS_AS = {"Real": "Real", "Integer": "Integer", "Enumeration": "Integer", "Boolean": "Boolean"}


class Algorithm(StrEnum):
    """Order in which components step and exchange."""

    JACOBI = "jacobi"
    GAUSS_SEIDEL = "gauss-seidel"


class Initialisation(StrEnum):
    """How loops of initial values are solved: by Newton's method where fixed points fail, or by one alone."""

    AUTOMATIC = "automatic"
    FIXED_POINT = "fixed-point"
    NEWTON = "newton"


@dataclass(frozen=True)
class Event:
    """Variables to set at `time` [s]; where an FMU cannot step to it, at its next communication point."""

    time: float
    values: Mapping[str, Any]


@dataclass(frozen=True)
class Experiment:
    """What to do with a system.

    parameters, inputs: "component.variable" -> value, set before the initialisation
    signals: "component.variable" -> function of time, set at every communication point
    record: names of outputs and driven inputs; empty means all outputs and signals
    extrapolation: order, 0 or 1, in which inputs are carried on between communication points
    step_sizes: component -> its own step size [s], a multiple of `step_size`
    tolerance: of the error that exchanging at steps brings; steps are then as short as that needs
    initialisation: how loops of initial values are solved
    faults: on inputs that a connection or a signal drives; several on one act in their order
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
    extrapolation: int = 0
    step_sizes: Mapping[str, float] = field(default_factory=dict)
    tolerance: float | None = None
    initialisation: Initialisation = Initialisation.AUTOMATIC
    faults: tuple[Fault, ...] = ()

    def __post_init__(self) -> None:
        self._take_plain_types()
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
        if self.extrapolation not in (0, 1):
            raise SystemDefinitionError(f"extrapolation = {self.extrapolation!r}: expected order 0 or 1")
        if self.tolerance is not None and not 0.0 < self.tolerance < 1.0:
            raise SystemDefinitionError(f"tolerance = {self.tolerance!r}: expected more than 0, less than 1")
        if self.tolerance is not None and self.step_sizes:
            raise SystemDefinitionError("tolerance and step_sizes: expected one of them")
        for name, size in self.step_sizes.items():
            ratio = size / self.step_size
            if not (
                math.isfinite(ratio) and ratio >= 0.5 and abs(ratio - round(ratio)) <= GRID_TOLERANCE * ratio
            ):
                raise SystemDefinitionError(
                    f"step size of {name}, {size!r} s: expected a multiple of the communication step size, "
                    f"{self.step_size!r} s"
                )

    def _take_plain_types(self) -> None:
        """Choices by their names, lists for tuples."""
        for name, kind in (("algorithm", Algorithm), ("initialisation", Initialisation)):
            object.__setattr__(self, name, _member(kind, getattr(self, name), name))
        for name, kind in (("events", Event), ("faults", Fault), ("record", str)):
            object.__setattr__(self, name, _tuple_of(kind, getattr(self, name), name))
        for name in ("stop_time", "step_size", "start_time"):
            _check_is_number(getattr(self, name), name)

    def beyond_the_plain_loop(self) -> str:
        """What of it a mere exchange at communication points (Jacobi) does not do; empty if nothing."""
        special = {
            f"algorithm {self.algorithm}": self.algorithm is not Algorithm.JACOBI,
            "extrapolation": self.extrapolation,
            "step sizes of components": self.step_sizes,
            "a tolerance": self.tolerance,
            "events": self.events,
            "faults": self.faults,
        }
        return ", ".join(name for name, is_used in special.items() if is_used)

    def period(self, component: str) -> int:
        """Communication steps in one step of a component."""
        return round(self.step_sizes.get(component, self.step_size) / self.step_size)

    def nearness(self) -> float:
        """Times [s] closer than this are the same: a small part of a step, and more than rounding."""
        rounding = 4.0 * np.finfo(float).eps * max(abs(self.start_time), abs(self.stop_time))
        return max(GRID_TOLERANCE * self.step_size, float(rounding))

    def points(self) -> np.ndarray:
        """Communication points, first and last included."""
        duration = self.stop_time - self.start_time
        count = math.ceil(duration / self.step_size - GRID_TOLERANCE)
        points = self.start_time + np.arange(count + 1) * self.step_size
        points[-1] = self.stop_time
        return points


def _member(kind: type[StrEnum], value: Any, what: str) -> StrEnum:
    try:
        return kind(value)
    except ValueError:
        known = [str(each) for each in kind]
        raise SystemDefinitionError(f"unknown {what} {value!r}; {nearest(str(value), known)}") from None


def _tuple_of(kind: type, values: Any, what: str) -> tuple[Any, ...]:
    if not isinstance(values, (list, tuple)) or not all(isinstance(each, kind) for each in values):
        raise SystemDefinitionError(f"{what} = {values!r}: expected a list of {_MEMBERS[what]}")
    return tuple(values)


def _check_is_number(value: Any, what: str) -> None:
    if not isinstance(value, (int, float, np.integer, np.floating)) or isinstance(value, bool):
        raise SystemDefinitionError(f"{what} = {value!r}: expected a number of seconds")


def checked_settings(checked: CheckedSystem, experiment: Experiment) -> list[tuple[Port, Any]]:
    """Parameters and constant inputs as (port, value), each checked against its declaration."""
    recorded(checked, experiment)
    _check_events(checked, experiment)
    _check_faults(checked, experiment)
    _check_capabilities(checked, experiment)
    for name, signal in experiment.signals.items():
        if not callable(signal):
            raise SystemDefinitionError(
                f"signal {name} = {signal!r}: expected a function of time; a constant is given as an input"
            )
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


def communication_points(checked: CheckedSystem, experiment: Experiment) -> np.ndarray:
    """The points of the experiment, and the times of its events if every component can step to them."""
    points = experiment.points()
    can_vary = all(
        description.coSimulation.canHandleVariableCommunicationStepSize
        for description in checked.descriptions.values()
        if description.coSimulation
    )
    if experiment.step_sizes or not can_vary:
        return points
    near = experiment.nearness()
    times = sorted(event.time for event in experiment.events if np.abs(points - event.time).min() > near)
    between = [t for before, t in pairwise([-math.inf, *times]) if t - before > near]
    return np.unique([*points, *between]) if between else points


def recorded(checked: CheckedSystem, experiment: Experiment) -> tuple[str, ...]:
    """Names to record: those asked for, or signals and outputs, as far as their type travels."""
    outputs = [
        name
        for name, port in checked.ports.items()
        if port.variable.causality == "output" and port.variable.type in TRAVELS_AS
    ]
    driven = [*experiment.signals, *(target.name for _, target in checked.connections)]
    names = experiment.record or (*experiment.signals, *outputs)
    for name in names:
        if name not in outputs and name not in driven:
            checked.port(name, "record")
            raise SystemDefinitionError(
                f"record: {name}: expected an output, or an input that a connection or a signal drives"
            )
    return tuple(names)


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


def _check_faults(checked: CheckedSystem, experiment: Experiment) -> None:
    driven = {target.name for _, target in checked.connections} | set(experiment.signals)
    steps_begin = experiment.points()[:-1]
    for each in experiment.faults:
        purpose, kind = f"fault on {each.input}", type(each.effect).__name__
        port = checked.port(each.input, purpose)
        if each.input not in driven:
            raise SystemDefinitionError(
                f"{purpose}: expected what a connection or a signal drives; {nearest(each.input, driven)}"
            )
        if port.variable.type != "Real" and not each.effect.for_every_type:
            raise SystemDefinitionError(
                f"{purpose}: {kind}: expected an input of type Real, got {port.variable.type}"
            )
        if isinstance(each.effect, Stuck):
            checked_value(port, each.effect.value)
        if not len(within(steps_begin, each.start, each.end)):
            raise SystemDefinitionError(
                f"{purpose}: no communication step begins at {each.start:g}..{each.end:g} s: expected a part "
                f"of the run, {experiment.start_time:g}..{experiment.stop_time:g} s"
            )


def _check_capabilities(checked: CheckedSystem, experiment: Experiment) -> None:
    """What the FMUs say that they cannot do."""
    points = experiment.points()
    whole_steps = (experiment.stop_time - experiment.start_time) / experiment.step_size
    last_is_shorter = abs(whole_steps - round(whole_steps)) > GRID_TOLERANCE * whole_steps
    for name in experiment.step_sizes:
        if name not in checked.components:
            raise SystemDefinitionError(
                f"step size of {name!r}: no such component; {nearest(name, checked.components)}"
            )
    for name, description in checked.descriptions.items():
        interface: Any = description.coSimulation
        if experiment.tolerance and not (
            interface.canGetAndSetFMUstate and interface.canHandleVariableCommunicationStepSize
        ):
            raise SystemDefinitionError(
                f"tolerance: {name} cannot repeat a step in two halves: expected an FMU with "
                "canGetAndSetFMUstate and canHandleVariableCommunicationStepSize"
            )
        steps_left = (len(points) - 1) % experiment.period(name)
        if (last_is_shorter or steps_left) and not interface.canHandleVariableCommunicationStepSize:
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
    value = value.item() if isinstance(value, np.generic) else value
    if variable.type == "Enumeration" and isinstance(value, str):
        return _item(port, value)
    if variable.type == "String":
        return str(value)
    wanted = {"Real": (int, float), "Boolean": (bool,)}.get(variable.type, (int,))
    if not isinstance(value, wanted) or (variable.type != "Boolean" and isinstance(value, bool)):
        raise SystemDefinitionError(f"{name} = {value!r}: expected a value of type {variable.type}")
    if not abs(value) <= sys.float_info.max:
        raise SystemDefinitionError(f"{name} = {value!r}: expected a finite number")
    low, high = permitted(port)
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


def permitted(port: Port) -> tuple[float, float]:
    """The least and the largest value: as declared, and as the type can hold."""
    variable = port.variable
    widest = (-math.inf, math.inf) if variable.type == "Real" else _INTEGERS
    stated = (variable.min, variable.max)
    low, high = (limit if text is None else float(text) for text, limit in zip(stated, widest, strict=True))
    return low, high
