"""The master algorithm: connects FMI 2.0 co-simulation FMUs and steps them together.

Communication points are t_i = start + i h, never accumulated; a last shorter step lands on the stop
time. At each point: outputs are read, exchanged and recorded, scheduled changes are made.

    Jacobi         every component steps from t_i to t_{i+1} with the outputs of t_i
    Gauss-Seidel   in the order of the components, each with the newest outputs there are

Both hold inputs over a step: first order in h. The loop delays are given in docs/architecture.md.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np

from orchestration.component import Component, Values
from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.recording import Recording
from orchestration.reference import Signal
from orchestration.system import CheckedSystem, Port, System, check

_GRID_TOLERANCE = 1e-9  # of a step: a stop time this close to a communication point is on it
_LOOP_PASSES = 100
_LOOP_TOLERANCE = 1e-12


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
        if not (math.isfinite(self.stop_time) and self.stop_time > self.start_time):
            raise SystemDefinitionError(
                f"stop time {self.stop_time!r} s: expected more than the start time {self.start_time!r} s"
            )

    def points(self) -> np.ndarray:
        """Communication points, first and last included."""
        duration = self.stop_time - self.start_time
        count = math.ceil(duration / self.step_size - _GRID_TOLERANCE)
        points = self.start_time + np.arange(count + 1) * self.step_size
        points[-1] = self.stop_time
        return points


def simulate(
    system: System,
    experiment: Experiment,
    progress: Callable[[int, int], None] | None = None,
) -> Recording:
    """Run an experiment on a system and return what was recorded.

    progress: called with (communication points done, in all).
    Raises SystemDefinitionError or FmuLoadError before anything runs, SimulationError after: its
    `recording` is what there is until then. Every FMU is freed either way.
    """
    checked = check(system, [*experiment.inputs, *experiment.signals])
    settings = _settings(checked, experiment)
    with ExitStack() as stack:
        components = {
            name: stack.enter_context(Component(name, Path(path), checked.descriptions[name]))
            for name, path in checked.components.items()
        }
        run = _Run(checked, experiment, components)
        try:
            run.initialise(settings)
            run.loop(progress)
        except (OrchestrationError, KeyboardInterrupt) as error:
            cause = error if isinstance(error, Exception) else OrchestrationError("interrupted")
            raise SimulationError(cause, run.recorder.recording()) from error
        return run.recorder.recording()


def _settings(checked: CheckedSystem, experiment: Experiment) -> list[tuple[Port, Any]]:
    """Parameters and constant inputs as (port, value), each checked against its declaration."""
    _check_events(checked, experiment)
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
    if not math.isfinite(value):
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


class _Recorder:
    """Rows of signals, allocated once for the whole run."""

    def __init__(self, names: list[str], units: list[str], points: np.ndarray, provenance: dict) -> None:
        self._names, self._units, self._points = names, units, points
        self._rows = np.empty((len(points), len(names)))
        self._done = 0
        self._provenance = provenance
        self.copies: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def take(self, i: int) -> None:
        row = self._rows[i]
        for columns, array, places in self.copies:
            row[columns] = array[places]
        self._done = i + 1

    def recording(self) -> Recording:
        return Recording(
            names=tuple(self._names),
            units=tuple(self._units),
            time=self._points[: self._done].copy(),
            values=self._rows[: self._done].copy(),
            provenance=self._provenance,
        )


class _Run:
    """A checked system with live components, its arrays bound."""

    def __init__(
        self, checked: CheckedSystem, experiment: Experiment, components: dict[str, Component]
    ) -> None:
        self._checked, self._experiment, self._components = checked, experiment, components
        self._points = experiment.points()
        self._places: dict[str, tuple[np.ndarray, int]] = {}
        driven = {target.name for _, target in checked.connections} | set(experiment.signals)
        self._inputs = {name: self._bind(name, "input", driven) for name in components}
        self._outputs = {name: self._bind(name, "output", None) for name in components}
        self._links: dict[str, list[tuple[np.ndarray, int, np.ndarray, int]]] = {n: [] for n in components}
        for source, target in checked.connections:
            self._links[target.component].append((*self._places[source.name], *self._places[target.name]))
        self._signals = [(*self._places[name], signal) for name, signal in experiment.signals.items()]
        self._events = sorted(experiment.events, key=lambda event: event.time)
        self.recorder = self._make_recorder()

    def _bind(self, component: str, causality: str, only: set[str] | None) -> list[Values]:
        wanted = [
            v
            for v in self._checked.descriptions[component].modelVariables
            if v.causality == causality and (only is None or f"{component}.{v.name}" in only)
        ]
        groups = self._components[component].values(wanted)
        for group in groups:
            for i, variable in enumerate(group.variables):
                self._places[f"{component}.{variable.name}"] = (group.array, i)
        return groups

    def _make_recorder(self) -> _Recorder:
        recordable = [*self._experiment.signals] + [
            f"{name}.{v.name}"
            for name in self._components
            for group in self._outputs[name]
            for v in group.variables
        ]
        names = list(self._experiment.record) or recordable
        for name in names:
            if name not in recordable:
                self._checked.port(name, "record")
                raise SystemDefinitionError(f"record: {name} is neither an output nor driven by a signal")
        units = [self._checked.ports[name].variable.unit or "" for name in names]
        recorder = _Recorder(names, units, self._points, self._provenance())
        by_array: dict[int, tuple[np.ndarray, list[int], list[int]]] = {}
        for column, name in enumerate(names):
            array, place = self._places[name]
            _, columns, places = by_array.setdefault(id(array), (array, [], []))
            columns.append(column)
            places.append(place)
        recorder.copies = [(np.array(c), array, np.array(p)) for array, c, p in by_array.values()]
        return recorder

    def _provenance(self) -> dict[str, Any]:
        return {
            "fmus": {
                name: {"guid": d.guid, "model": d.modelName, "tool": d.generationTool}
                for name, d in self._checked.descriptions.items()
            },
            "algorithm": str(self._experiment.algorithm),
            "communication_step_size_s": self._experiment.step_size,
        }

    def initialise(self, settings: list[tuple[Port, Any]]) -> None:
        """Set values, enter initialisation mode, exchange in dependency order, leave it."""
        experiment = self._experiment
        for port, value in settings:
            self._components[port.component].set(port.variable, value)
        for component in self._components.values():
            component.initialise(experiment.start_time, experiment.stop_time)
        for name, signal in experiment.signals.items():
            port = self._checked.ports[name]
            self._components[port.component].set(port.variable, signal(experiment.start_time))
        self._exchange_initial_values()
        for component in self._components.values():
            component.begin_stepping()

    def _exchange_initial_values(self) -> None:
        order, loop = self._checked.initial_order()
        known: dict[str, float] = {}
        for _ in range(_LOOP_PASSES):
            settled = True
            for source, target in order:
                value = self._components[source.component].get(source.variable)
                before = known.get(target.name)
                settled &= before is not None and abs(value - before) <= _LOOP_TOLERANCE * max(
                    1.0, abs(value)
                )
                self._components[target.component].set(target.variable, value)
                known[target.name] = value
            if settled or not loop:
                return
        names = ", ".join(target.name for _, target in order)
        raise OrchestrationError(
            f"initial values of {names} did not settle in {_LOOP_PASSES} passes: the loop has no "
            "fixed point that repeated exchange finds; break it or give start values"
        )

    def loop(self, progress: Callable[[int, int], None] | None) -> None:
        """From the first communication point to the last."""
        step = {Algorithm.JACOBI: self._jacobi, Algorithm.GAUSS_SEIDEL: self._gauss_seidel}[
            self._experiment.algorithm
        ]
        last = len(self._points) - 1
        for name in self._components:
            self._read(name)
        due = self._due_events()
        for i, t in enumerate(self._points.tolist()):
            for array, place, signal in self._signals:
                array[place] = signal(t)
            for component in self._components.values():
                component.time = t
            for name, value in due(t):
                port = self._checked.ports[name]
                self._components[port.component].set(port.variable, checked_value(port, value))
            self.recorder.take(i)
            if progress:
                progress(i, last)
            if i < last:
                step(t, float(self._points[i + 1]) - t)

    def _due_events(self) -> Callable[[float], Iterator[tuple[str, Any]]]:
        waiting = list(self._events)
        tolerance = _GRID_TOLERANCE * self._experiment.step_size

        def due(t: float) -> Iterator[tuple[str, Any]]:
            while waiting and waiting[0].time <= t + tolerance:
                yield from waiting.pop(0).values.items()

        return due

    def _jacobi(self, t: float, h: float) -> None:
        for name in self._components:
            self._write(name)
        for component in self._components.values():
            component.do_step(t, h)
        for name in self._components:
            self._read(name)

    def _gauss_seidel(self, t: float, h: float) -> None:
        for name, component in self._components.items():
            self._write(name)
            component.do_step(t, h)
            self._read(name)

    def _write(self, component: str) -> None:
        for source, i, target, j in self._links[component]:
            target[j] = source[i]
        for group in self._inputs[component]:
            group.write()

    def _read(self, component: str) -> None:
        for group in self._outputs[component]:
            group.read()
