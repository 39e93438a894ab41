"""One run of a system: everything that follows from system and experiment, computed and checked once."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from fmus.fmi.description import has_start_value, start_value
from fmus.fmi.model_description import ModelDescription
from fmus.fmi.variable_types import NUMBERS, FmiValue
from orchestration.errors import SystemDefinitionError
from orchestration.system.experiment import Experiment, double_step
from orchestration.system.experiment_checks import (
    Setting,
    check_capabilities,
    check_faults,
    check_memory,
    check_signals,
    checked_events,
)
from orchestration.system.faults import Fault, Pattern, compose
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.signals import Constant, Cosine, Ramps, Signal, Table, values_at
from orchestration.system.system import CheckedSystem, System, check
from orchestration.system.values import (
    fmi_value,
    is_discrete,
    items,
    possible_values,
    value_of_open_input,
    value_range,
)


@dataclass(frozen=True, eq=False)
class PreparedRun:
    """A prepared run: a system and an experiment that fit each other.

    points: communication points [s], shape (n,); with the times of events if every FMU can step to them
    recorded: names of the recorded variables
    settings: parameters, constant inputs and open ones, with their values as the FMUs take them
    changes: index of a communication point -> what is set there
    periods: component -> communication steps in one step of the component
    input_ranges: driven input -> its smallest and largest value
    retry_obstacle: why a discarded step cannot be repeated in shorter steps; empty if it can
    external: input that the caller sets between the steps -> its first value
    """

    system: CheckedSystem
    experiment: Experiment
    points: np.ndarray
    recorded: tuple[str, ...]
    settings: tuple[Setting, ...]
    changes: Mapping[int, Sequence[Setting]]
    periods: Mapping[str, int]
    input_ranges: Mapping[str, tuple[float, float]]
    retry_obstacle: str
    external: Mapping[str, float] = field(default_factory=dict)

    @property
    def shape(self) -> tuple[int, int]:
        """(communication points, recorded variables): the shape of the recorded values."""
        return len(self.points), len(self.recorded)

    @cached_property
    def signal_values(self) -> np.ndarray:
        """The signals at every communication point, shape (signals, n).

        Raises SystemDefinitionError for a signal that fails, or whose input cannot have its value.
        """
        table = np.empty((len(self.experiment.signals), len(self.points)))
        for row, (name, signal) in zip(table, self.experiment.signals.items(), strict=True):
            row[:] = self.values_of_signal(name, signal)
        return table

    def values_of_signal(self, name: str, signal: Signal) -> np.ndarray:
        """Returns a signal of an input at every communication point, shape (n,).

        Raises SystemDefinitionError for one that fails, or whose input cannot have its value.
        """
        values = np.empty(len(self.points))
        if isinstance(signal, Table) and is_discrete(self.system.ports[name]):
            signal = replace(signal, hold=True)
        try:
            values[:] = values_at(signal, self.points)
        except Exception as error:
            # a user's function may raise anything
            raise SystemDefinitionError(f"signal {name}: {error!r}", ("signals", name)) from error
        expected, is_possible = possible_values(self.system.ports[name], values)
        for i in np.flatnonzero(~is_possible)[:1]:
            value, t = values[i], self.points[i]
            raise SystemDefinitionError(
                f"signal {name} is {value:.9g} at t = {t:.9g} s: expected {expected}", ("signals", name)
            )
        low, high = value_range(self.system.ports[name])
        # a computed curve that misses a limit by rounding is on it: an FMU refuses what is beyond
        values[values < low] = low
        values[values > high] = high
        return values

    @property
    def initial_settings(self) -> tuple[Setting, ...]:
        """`settings`, and what the signals set at the start time."""
        values = zip(self.experiment.signals, self.signal_values, strict=True)
        first = ((self.system.ports[name], self.typed(name, row[:1])[0]) for name, row in values)
        return (*self.settings, *first)

    def typed(self, name: str, values: np.ndarray) -> list[FmiValue]:
        """Returns values of a signal as its input takes them."""
        return values.astype(float if self.system.ports[name].variable.type == "Real" else int).tolist()

    def copy(self, **changes: Any) -> "PreparedRun":
        """Returns this run with other members; times and signals are its own, and a run may change them."""
        again = replace(self, points=self.points.copy(), **changes)
        # fills the cached property: signals are functions of users, and are not called again
        vars(again)["signal_values"] = self.signal_values.copy()
        return again

    def with_values(self, experiment: Experiment) -> "PreparedRun":
        """Returns a copy with the parameters and constant inputs of an experiment that is equal otherwise."""
        return self.copy(experiment=experiment, settings=_settings(self.system, experiment))

    @cached_property
    def fault_patterns(self) -> dict[str, Pattern]:
        """Faulted input -> (source, addition) of all its faults at every communication point."""
        faults: dict[str, list[Fault]] = {}
        for fault in self.experiment.faults:
            faults.setdefault(fault.input, []).append(fault)
        return {name: compose(on_input, self.points) for name, on_input in faults.items()}


def prepare(system: System, experiment: Experiment) -> PreparedRun:
    """Reads the model descriptions and checks the system and the experiment.

    Raises FmuLoadError for a file that is no FMU, SystemDefinitionError for what does not fit.
    """
    return prepare_checked(check_for(system, experiment), experiment)


def check_for(
    system: System,
    experiment: Experiment,
    external: Sequence[str] = (),
    descriptions: Mapping[str, ModelDescription] | None = None,
) -> CheckedSystem:
    """Returns the checked system, with the inputs that the experiment drives.

    external: inputs that the caller sets between the steps
    descriptions: of the components, if they have been read already
    """
    driven = (*experiment.driven_inputs, *(name for name in external if name not in experiment.inputs))
    return check(system, driven, descriptions, OpenInputs(experiment.open_inputs))


def prepare_checked(
    system: CheckedSystem, experiment: Experiment, external: Sequence[str] = ()
) -> PreparedRun:
    """Checks an experiment against a system that was checked with the inputs that it drives.

    external: inputs that the caller sets between the steps
    """
    driven = {*experiment.signals, *external, *(target.name for _, target in system.connections)}
    check_memory(system, experiment)
    check_signals(system, experiment)
    events = checked_events(system, experiment, driven)
    check_faults(system, experiment, driven)
    check_capabilities(system, experiment)
    if experiment.error_estimate:
        double_step(experiment)
    periods = {name: experiment.period(name) for name in system.components}
    points = _communication_points(system, experiment)
    return PreparedRun(
        system=system,
        experiment=experiment,
        points=points,
        external=_external(system, experiment, external),
        settings=_settings(system, experiment),
        input_ranges={name: value_range(system.ports[name]) for name in driven},
        recorded=_recorded(system, experiment, external),
        changes=_changes(events, periods, points, experiment.time_resolution()),
        periods=periods,
        retry_obstacle=_retry_obstacle(system, experiment),
    )


def _external(system: CheckedSystem, experiment: Experiment, names: Sequence[str]) -> dict[str, float]:
    """Returns external inputs and their first values: of `experiment.inputs`, else the FMU's start values."""
    values = {}
    for name in names:
        port = system.port(name, "external input")
        if port.variable.type not in NUMBERS:
            raise SystemDefinitionError(f"external input {name}: expected a number, got {port.variable.type}")
        is_given = name in experiment.inputs
        values[name] = float(
            fmi_value(port, experiment.inputs[name]) if is_given else value_of_open_input(port)
        )
    return values


def _recorded(system: CheckedSystem, experiment: Experiment, external: Iterable[str]) -> tuple[str, ...]:
    """Returns the names asked for, of any kind; or signals, external inputs, and outputs but Strings."""
    outputs = [
        name
        for name, port in system.ports.items()
        if port.variable.causality == "output" and port.variable.type in NUMBERS
    ]
    for name in experiment.record:
        system.port(name, "record")
    return tuple(dict.fromkeys(experiment.record) or (*experiment.signals, *external, *outputs))


def _communication_points(system: CheckedSystem, experiment: Experiment) -> np.ndarray:
    """Returns the time grid, and the times of the events if every component can step to them."""
    grid = experiment.time_grid()
    if experiment.step_sizes or system.components_without("canHandleVariableCommunicationStepSize"):
        return grid
    resolution = experiment.time_resolution()
    times = np.array(sorted(event.time for event in experiment.events))
    after = np.searchsorted(grid, times).clip(1, len(grid) - 1)
    times = times[np.minimum(np.abs(grid[after - 1] - times), np.abs(grid[after] - times)) > resolution]
    different = [t for before, t in pairwise([-math.inf, *times]) if t - before > resolution]
    return np.unique([*grid, *different]) if different else grid


def _settings(system: CheckedSystem, experiment: Experiment) -> tuple[Setting, ...]:
    settings = []
    for name, value in experiment.parameters.items():
        port = system.port(name, "parameter")
        if not has_start_value(port.variable):
            kind = f"{port.variable.causality} with initial = {port.variable.initial or 'calculated'}"
            if port.variable.variability == "constant":
                kind = "a constant"
            raise SystemDefinitionError(
                f'{name}: expected a parameter, or a variable with initial = "exact" or "approx", got {kind}',
                name,
            )
        settings.append((port, fmi_value(port, value)))
    inputs = experiment.inputs.items()
    settings += [(port, fmi_value(port, value)) for name, value in inputs if (port := system.ports[name])]
    starts = ((port, value_of_open_input(port)) for port in system.open_inputs)
    return (*settings, *starts)


def _changes(
    events: Sequence[tuple[float, Sequence[Setting]]],
    periods: Mapping[str, int],
    points: np.ndarray,
    resolution: float,
) -> dict[int, list[Setting]]:
    """Returns the changes; a component takes one at its first communication point at or after the event."""
    changes: dict[int, list[Setting]] = {}
    for time, settings in events:
        first = int(np.searchsorted(points, time - resolution))
        for port, value in settings:
            period = periods[port.component]
            index = min(-(-first // period) * period, len(points) - 1)
            changes.setdefault(index, []).append((port, value))
    return changes


def _retry_obstacle(system: CheckedSystem, experiment: Experiment) -> str:
    if experiment.step_sizes:
        return "components have step sizes of their own"
    for capability, action in (
        ("canGetAndSetFMUstate", "go back"),
        ("canHandleVariableCommunicationStepSize", "vary the step"),
    ):
        incapable = system.components_without(capability)
        if incapable:
            return f"{', '.join(incapable)} cannot {action} ({capability})"
    return ""


def values_of(prepared: PreparedRun, component: str) -> dict[str, Any]:
    """Returns the values of a component's parameters and constant inputs; of an Enumeration, the item."""
    given = {port.name: value for port, value in prepared.settings}
    values = {}
    for name, port in prepared.system.ports.items():
        variable = port.variable
        if port.component == component and variable.causality in ("parameter", "input"):
            value = given.get(name, start_value(variable))
            names: dict[Any, str] = {number: item for item, number in items(port).items()}
            values[variable.name] = names.get(value, value)
    return values


# Longer runs are prepared anew each time: their times and signals would stay in memory.
_MOST_STEPS = 100_000
# Signals whose members cannot change: equal ones give equal values. A table has arrays.
_IMMUTABLE = (Constant, Cosine, Ramps)
_VALUES = ("parameters", "inputs")


class PreparedRuns:
    """Prepared runs, one after another, each as `prepare_checked` makes it.

    Runs that differ in parameters and constant inputs alone, as samples of a sweep, are prepared once.

    only_values_differ: whether the last one is as the one before but for values of parameters and constant
    inputs
    """

    only_values_differ = False

    def __init__(self) -> None:
        self._first: PreparedRun | None = None
        self._key: str | None = None

    def prepare(
        self, system: CheckedSystem, experiment: Experiment, external: tuple[str, ...] = ()
    ) -> PreparedRun:
        """Returns the prepared run; its arrays are its own, and a run may change them."""
        key = _key(system, experiment) if not external else None
        self.only_values_differ = key is not None and key == self._key
        if not (self.only_values_differ and self._first):
            # forgotten first: if the run is refused, the next one is compared with nothing
            self._key, self._first = None, None
            first = prepare_checked(system, experiment, external)
            if key is None:
                return first
            self._key, self._first = key, first
        return self._first.with_values(experiment)


def _key(system: CheckedSystem, experiment: Experiment) -> str | None:
    """Returns what runs that differ in values alone share; None where equal things may have changed."""
    signals = experiment.signals.values()
    can_change = experiment.events or experiment.faults or any(type(s) not in _IMMUTABLE for s in signals)
    if can_change or experiment.step_count > _MOST_STEPS:
        return None
    rest = (value for name, value in vars(experiment).items() if name not in _VALUES)
    copies = (tuple(value.items()) if isinstance(value, Mapping) else value for value in rest)
    # a system was checked with the inputs that an experiment drives: the same one has the same inputs;
    # as text, 0 and -0 differ
    return repr((id(system), *copies))
