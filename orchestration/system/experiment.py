"""Experiments with a system, with the checks that need no FMU.

Communication points are t_i = start + i h, never accumulated; a last shorter step lands on the stop
time. Times in s.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Any, Literal, TypedDict

import numpy as np

from fmus.errors import nearest
from fmus.fmi.description import describe
from orchestration.errors import SystemDefinitionError
from orchestration.system.faults import Fault
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.signals import Signal
from orchestration.system.system import System
from orchestration.system.time_grid import is_multiple, resolution, step_count, time_grid
from orchestration.system.values import Value

_MOST_STEPS = 1e9
_SUGGESTIONS = {"start_time": "startTime", "stop_time": "stopTime", "step_size": "stepSize"}
_ELEMENTS = {"events": "Event", "faults": "Fault", "record": "names"}


class Algorithm(StrEnum):
    """The master algorithm: the order in which components step and exchange."""

    JACOBI = "jacobi"
    GAUSS_SEIDEL = "gauss-seidel"


class Initialisation(StrEnum):
    """The method of initialisation for algebraic loops of initial values.

    automatic: by fixed-point iteration and, where that fails, by Newton's method; or by one of them alone
    """

    AUTOMATIC = "automatic"
    FIXED_POINT = "fixed-point"
    NEWTON = "newton"


AlgorithmName = Algorithm | Literal["jacobi", "gauss-seidel"]
OpenInputsName = OpenInputs | Literal["error", "start"]
InitialisationName = Initialisation | Literal["automatic", "fixed-point", "newton"]


@dataclass(frozen=True)
class Event:
    """An event: variables that are set at a time.

    Attributes
    ----------
    time : float
        Time [s]. If an FMU cannot step to it, its next communication point is taken.
    values : mapping
        "component.variable" -> value.

    Examples
    --------
    >>> Event(60.0, {"plant.current_velocity": 0.1}).time
    60.0
    """

    time: float
    values: Mapping[str, Value]


@dataclass(frozen=True)
class Experiment:
    """An experiment with a system.

    Parameters
    ----------
    stop_time, step_size, start_time : float
        End, communication step size and start [s].
    algorithm : {"jacobi", "gauss-seidel"}
        The order in which components step and exchange values.
    parameters, inputs : mapping
        "component.variable" -> value, set before the initialisation.
    signals : mapping
        "component.variable" -> function of time [s], set at every communication point.
    events : sequence of Event
        Variables that are set at a time.
    record : sequence of str
        Variables of any causality and type; empty for all signals and all outputs except Strings.
    extrapolation : {0, 1}
        Order of the input extrapolation between communication points.
    step_sizes : mapping
        Component -> its own step size [s], a multiple of `step_size`.
    tolerance : float, optional
        Of the error caused by exchanging at communication points only; the master then varies the step.
    fmu_tolerance : float, optional
        Relative tolerance of the FMUs' solvers; by default their own.
    initialisation : {"automatic", "fixed-point", "newton"}
        How algebraic loops of initial values are solved.
    faults : sequence of Fault
        On inputs that a connection or a signal drives; several faults on one input act in their order.
    open_inputs : {"error", "start"}
        Inputs that nothing drives are an error, or keep their FMU's start value.
    error_estimate : bool
        Whether a second run at twice the step follows, and estimates the error of this one.

    Raises
    ------
    SystemDefinitionError
        For values that do not fit together.

    Examples
    --------
    >>> off = Event(5.0, {"plant.external_force": 0.0})
    >>> experiment = Experiment(10.0, 0.02, inputs={"plant.external_force": 0.5}, events=[off])
    >>> experiment.step_count
    500
    """

    stop_time: float
    step_size: float
    start_time: float = 0.0
    algorithm: AlgorithmName = Algorithm.JACOBI
    parameters: Mapping[str, Value] = field(default_factory=dict)
    inputs: Mapping[str, Value] = field(default_factory=dict)
    signals: Mapping[str, Signal] = field(default_factory=dict)
    events: Sequence[Event] = ()
    record: Sequence[str] = ()
    extrapolation: int = 0
    step_sizes: Mapping[str, float] = field(default_factory=dict)
    tolerance: float | None = None
    fmu_tolerance: float | None = None
    initialisation: InitialisationName = Initialisation.AUTOMATIC
    faults: Sequence[Fault] = ()
    open_inputs: OpenInputsName = OpenInputs.ERROR
    error_estimate: bool = False

    def __post_init__(self) -> None:
        self._convert_types()
        _check_times(self)
        _check_options(self)

    def _convert_types(self) -> None:
        """Converts names to members of their enumerations, and lists to tuples."""
        kinds = {"algorithm": Algorithm, "initialisation": Initialisation, "open_inputs": OpenInputs}
        for name, kind in kinds.items():
            object.__setattr__(self, name, _member(kind, getattr(self, name), name))
        for name, kind in (("events", Event), ("faults", Fault), ("record", str)):
            object.__setattr__(self, name, _tuple_of(kind, getattr(self, name), name))

    @property
    def driven_inputs(self) -> tuple[str, ...]:
        """Names of the inputs that a constant value or a signal drives."""
        return (*self.inputs, *self.signals)

    def period(self, component: str) -> int:
        """Returns the number of communication steps in one step of a component.

        Parameters
        ----------
        component : str
            Name of the component.

        Returns
        -------
        int
        """
        return round(self.step_sizes.get(component, self.step_size) / self.step_size)

    def time_resolution(self) -> float:
        """Returns the largest difference [s] of equal times: a small part of a step, above rounding.

        Returns
        -------
        float
        """
        return resolution(self.step_size, self.start_time, self.stop_time)

    @property
    def step_count(self) -> int:
        """Count of communication steps, the length of the time grid less one."""
        return step_count(self.start_time, self.stop_time, self.step_size)

    def time_grid(self) -> np.ndarray:
        """Returns start time, stop time and the multiples of the step size between them [s].

        Returns
        -------
        array, shape (n,)
        """
        return time_grid(self.start_time, self.stop_time, self.step_size)


class ExperimentSettings(TypedDict, total=False):
    """The settings of an `Experiment` as keyword arguments."""

    stop_time: float | None
    step_size: float | None
    start_time: float | None
    algorithm: AlgorithmName
    parameters: Mapping[str, Value]
    inputs: Mapping[str, Value]
    signals: Mapping[str, Signal]
    events: Sequence[Event]
    record: Sequence[str]
    extrapolation: int
    step_sizes: Mapping[str, float]
    tolerance: float | None
    fmu_tolerance: float | None
    initialisation: InitialisationName
    faults: Sequence[Fault]
    open_inputs: OpenInputsName
    error_estimate: bool


def _member(kind: type[StrEnum], value: Any, name: str) -> StrEnum:
    try:
        return kind(value)
    except ValueError:
        known = [str(member) for member in kind]
        raise SystemDefinitionError(
            f"unknown {name} {value!r}; {nearest(str(value), known)}", ("experiment", name)
        ) from None


def _tuple_of(kind: type, values: Any, name: str) -> tuple[Any, ...]:
    fits = isinstance(values, (list, tuple)) and all(isinstance(value, kind) for value in values)
    _expect(fits, f"{name} = {values!r}: expected a list of {_ELEMENTS[name]}")
    return tuple(values)


def _expect(condition: bool, message: str, *about: str | int) -> None:
    """Raises SystemDefinitionError if a condition does not hold; about: keys of an entry of a scenario."""
    if not condition:
        raise SystemDefinitionError(message, *([about] if about else []))


def _expect_setting(condition: bool, message: str, name: str) -> None:
    _expect(condition, message, "experiment", name)


def _check_times(experiment: Experiment) -> None:
    start, stop, step = experiment.start_time, experiment.stop_time, experiment.step_size
    for name, value in (("stop_time", stop), ("step_size", step), ("start_time", start)):
        is_number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        _expect_setting(is_number, f"{name} = {value!r}: expected a number of seconds", name)
    size = f"communication step size {step!r} s"
    _expect_setting(0.0 < step < math.inf, f"{size}: expected more than 0", "step_size")
    _expect_setting(math.isfinite(start), f"start time {start!r} s: expected a finite number", "start_time")
    expected = f"expected more than the start time {start!r} s"
    _expect_setting(start < stop < math.inf, f"stop time {stop!r} s: {expected}", "stop_time")
    is_within = step <= stop - start + experiment.time_resolution()
    _expect_setting(is_within, f"{size}: expected at most the run, {stop - start:g} s", "step_size")
    count = (stop - start) / step
    expected = f"expected at most {_MOST_STEPS:.0e}"
    _expect_setting(count <= _MOST_STEPS, f"{count:.3g} communication steps: {expected}", "step_size")
    for i, event in enumerate(experiment.events):
        expected = f"expected a time within the run, {start:g}..{stop:g} s"
        _expect(start <= event.time <= stop, f"event at {event.time!r} s: {expected}", "events", i)


def _check_options(experiment: Experiment) -> None:
    order, tolerance = experiment.extrapolation, experiment.tolerance
    _expect_setting(order in (0, 1), f"extrapolation = {order!r}: expected order 0 or 1", "extrapolation")
    for name, value in (("tolerance", tolerance), ("fmu_tolerance", experiment.fmu_tolerance)):
        fits = value is None or 0.0 < value < 1.0
        _expect_setting(fits, f"{name} = {value!r}: expected more than 0, less than 1", name)
    is_one = tolerance is None or not experiment.step_sizes
    _expect_setting(is_one, "tolerance and step_sizes: expected one of them", "tolerance")
    expected = f"expected a multiple of the communication step size, {experiment.step_size!r} s"
    for name, size in experiment.step_sizes.items():
        is_fitting = is_multiple(size, experiment.step_size)
        _expect(is_fitting, f"step size of {name}, {size!r} s: {expected}", "step_sizes", name)


def suggested_times(
    system: System,
    stop_time: float | None = None,
    step_size: float | None = None,
    start_time: float | None = None,
) -> tuple[float, float, float]:
    """Returns (stop time, step size, start time) [s]; None is replaced by the FMUs' default experiments.

    The suggested start time belongs to the suggested stop time; with a given stop time it is 0.
    Raises SystemDefinitionError for a time that is not given and for which the FMUs suggest none, or several.
    """
    if start_time is None:
        start_time = _suggested(system, "start_time", 0.0) if stop_time is None else 0.0
    if stop_time is None:
        stop_time = _suggested(system, "stop_time")
    if step_size is None:
        step_size = _suggested(system, "step_size")
    return stop_time, step_size, start_time


def _suggested(system: System, name: str, default: float | None = None) -> float:
    times: dict[str, float] = {}
    for component, path in system.components.items():
        suggested = getattr(describe(path).defaultExperiment, _SUGGESTIONS[name], None)
        if suggested is not None:
            times[component] = float(suggested)
    listed = ", ".join(f"{component} {time:g} s" for component, time in times.items())
    problem = f"the FMUs suggest several: {listed}" if times else "no FMU suggests one"
    can_choose = len(set(times.values())) == 1 or not (times or default is None)
    _expect(can_choose, f"expected {name}: it is not given, and {problem}")
    return next(iter(times.values()), default or 0.0)


_LARGEST_TOLERANCE = 0.99  # an experiment takes less than 1


def double_step(experiment: Experiment) -> Experiment:
    """Returns the experiment with twice the step, to the last communication point of every component in both.

    A tolerance becomes as many times larger as the error: 2 to the power of the order of the exchange.
    Raises SystemDefinitionError for a run of less than two steps.
    """
    start, step = experiment.start_time, 2.0 * experiment.step_size
    step_sizes = {name: 2.0 * size for name, size in experiment.step_sizes.items()}
    longest = step * math.lcm(*(experiment.period(name) for name in step_sizes))
    count = math.floor((experiment.stop_time - start + experiment.time_resolution()) / longest)
    if not count:
        raise SystemDefinitionError(
            f"error estimate: expected a run of at least {longest:g} s, two steps of every component, got "
            f"{experiment.stop_time - start:g} s"
        )
    stop = start + count * longest
    tolerance = experiment.tolerance and 2.0 ** (1 + experiment.extrapolation) * experiment.tolerance
    return replace(
        experiment,
        stop_time=stop,
        step_size=step,
        step_sizes=step_sizes,
        tolerance=tolerance and min(tolerance, _LARGEST_TOLERANCE),
        events=tuple(event for event in experiment.events if event.time <= stop),
        faults=tuple(fault for fault in experiment.faults if fault.start < stop),
        error_estimate=False,
    )
