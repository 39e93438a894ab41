"""Native FMUs as model exchange, led through FMPy, and a small block with every kind of event."""

from collections.abc import Callable, Sequence
from ctypes import POINTER, c_double
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.fmi2 import FMU2Model, fmi2CallbackFunctions, fmi2CallbackLoggerTYPE

from fmus.block import Block, NoValues, variable
from fmus.numerics import Clock, at_events, logical_and, sampled, where

Slope = Callable[[float, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Parameters:
    internal_step: float = variable(0.01, "Longest internal step", unit="s", min=1e-6, max=1.0)
    gravity: float = variable(8.0, "Gravity", unit="m/s2", min=0.1)
    restitution: float = variable(0.5, "Part of the velocity that is left", min=0.1, max=1.0)


@dataclass(frozen=True)
class Inputs:
    lift: float = variable(0.0, "Acceleration upwards", unit="m/s2")
    level: int = variable(0, "Added to the height that is read")


@dataclass(frozen=True)
class Continuous:
    height: float = variable(1.0, "Height", unit="m", nominal=2.0)
    velocity: float = variable(0.0, "Velocity upwards", unit="m/s")


@dataclass(frozen=True)
class Reading:
    value: float = 0.0
    clock: Clock = Clock()


@dataclass(frozen=True)
class State(Continuous):
    lift: float = 0.0
    bounces: float = 0.0
    reading: Reading = Reading()


@dataclass(frozen=True)
class Outputs:
    height: float = variable(0.0, "Height", unit="m")
    lifted: float = variable(0.0, "The input, at once", unit="m/s2")
    bounces: float = variable(0.0, "Number of bounces")
    reading: float = variable(0.0, "Height at the last multiple of 0.25 s", unit="m")
    is_low: bool = variable(False, "Below 0.5 m")


def initial_state(t: float, u: Inputs, p: Parameters, c: NoValues) -> State:
    return State(reading=Reading(clock=Clock(t, 1)))


def derivative(t: float, state: State, u: Inputs, p: Parameters, c: NoValues) -> Continuous:
    return Continuous(state.velocity, state.lift - p.gravity)


def step(t: float, h: float, state: State, u: Inputs, p: Parameters, c: NoValues) -> State:
    hits = logical_and(state.height <= 0.0, state.velocity < 0.0)
    return replace(
        state,
        velocity=at_events(state.velocity, where(hits, -p.restitution * state.velocity, state.velocity)),
        bounces=at_events(state.bounces, where(hits, state.bounces + 1.0, state.bounces)),
        lift=u.lift,
        reading=sampled(t + h, 0.25, state.reading, Reading(state.height + u.level)),
    )


def output(t: float, state: State, p: Parameters, c: NoValues) -> Outputs:
    return Outputs(state.height, state.lift, state.bounces, state.reading.value, state.height < 0.5)


def crossings(t: float, state: State, u: Inputs, p: Parameters, c: NoValues) -> tuple:
    return (state.height, state.lift - 2.0)


BALL = Block.of_module(__name__, "Ball", "A ball that bounces, and its height at times", step_size=0.01)


@dataclass(frozen=True)
class Steps:
    internal_step: float = variable(0.1, "Longest internal step", unit="s", min=1e-6, max=1.0)


@dataclass(frozen=True)
class Factor:
    factor: float = variable(1.0, "Factor of each step")


@dataclass(frozen=True)
class Grown:
    value: float = 1.0


@dataclass(frozen=True)
class Seen:
    value: float = variable(0.0, "The product")
    time: float = variable(0.0, "Time", unit="s")


GROWTH = Block(
    "Growth", "A number that is multiplied in each step, and the time",
    parameters=Steps, inputs=Factor, state=Grown, outputs=Seen, step_size=0.1,
    step=lambda t, h, state, u, p, c: Grown(state.value * u.factor),
    output=lambda t, state, p, c: Seen(state.value, t),
)  # fmt: skip


@dataclass(frozen=True)
class Valve:
    inflow: float = variable(0.0, "Rate of the level")
    opening: float = variable(0.0, "Part of the level that flows out", variability="discrete")


@dataclass(frozen=True)
class Level:
    level: float = variable(1.0, "Level")


@dataclass(frozen=True)
class Tank(Level):
    inflow: float = 0.0
    opening: float = 0.0


@dataclass(frozen=True)
class Gauge:
    level: float = variable(0.0, "Level")
    shown: float = variable(0.0, "Level and opening at the last event", variability="discrete")


TANK = Block(
    "Tank", "A tank with a Real input and a Real output that are discrete",
    parameters=Steps, inputs=Valve, continuous=Level, state=Tank, outputs=Gauge, step_size=0.1,
    derivative=lambda t, state, u, p, c: Level(state.inflow - state.opening * state.level),
    step=lambda t, h, state, u, p, c: replace(state, inflow=u.inflow, opening=u.opening),
    output=lambda t, state, p, c: Gauge(state.level, state.level + state.opening),
)  # fmt: skip


class Exchanged:
    """An instance of FMI 2.0 for model exchange, its variables by name."""

    def __init__(self, path: Path, folder: Path) -> None:
        self.description: Any = fmpy.read_model_description(str(path))
        fmpy.extract(str(path), folder)
        self.references = {v.name: v.valueReference for v in self.description.modelVariables}
        self.log: list[str] = []
        self._callbacks = fmi2CallbackFunctions()
        self._callbacks.logger = fmi2CallbackLoggerTYPE(
            lambda _, name, status, kind, text: self.log.append(text.decode())
        )
        self.model: Any = FMU2Model(
            guid=self.description.guid,
            unzipDirectory=str(folder),
            modelIdentifier=self.description.modelExchange.modelIdentifier,
            instanceName="exchanged",
        )
        self.model.instantiate(callbacks=self._callbacks, loggingOn=True)
        self.count = self.description.numberOfContinuousStates

    # modes

    def initialize(self, t: float = 0.0, stop_time: float | None = None, **values: float) -> "Exchanged":
        """Leads to initialization mode."""
        self.model.setupExperiment(startTime=t, stopTime=stop_time)
        self.model.enterInitializationMode()
        for name, value in values.items():
            self[name] = value
        return self

    def begin(self, t: float = 0.0, stop_time: float | None = None, **values: float) -> "Exchanged":
        """Leads to event mode; the first event is not handled yet."""
        self.initialize(t, stop_time, **values).model.exitInitializationMode()
        return self

    def solving(self, t: float = 0.0, stop_time: float | None = None, **values: float) -> "Exchanged":
        """Leads to continuous-time mode."""
        self.begin(t, stop_time, **values).event()
        self.model.enterContinuousTimeMode()
        return self

    def event(self, t: float | None = None) -> tuple[Any, ...]:
        """Handles an event, from continuous-time mode if a time is given; returns what fmi2EventInfo has."""
        if t is not None:
            self.model.setTime(t)
            self.model.enterEventMode()
        return self.model.newDiscreteStates()

    # values

    def __getitem__(self, name: str) -> float:
        return self.model.getReal([self.references[name]])[0]

    def __setitem__(self, name: str, value: float) -> None:
        self.model.setReal([self.references[name]], [value])

    @property
    def states(self) -> np.ndarray:
        return self._numbers(self.model.getContinuousStates, self.count)

    @property
    def rates(self) -> np.ndarray:
        return self._numbers(self.model.getDerivatives, self.count)

    @property
    def nominals(self) -> np.ndarray:
        return self._numbers(self.model.getNominalsOfContinuousStates, self.count)

    @property
    def indicators(self) -> np.ndarray:
        return self._numbers(self.model.getEventIndicators, self.description.numberOfEventIndicators)

    def _numbers(self, method: Any, count: int) -> np.ndarray:
        values = np.full(count, np.nan)
        method(values.ctypes.data_as(POINTER(c_double)), count)
        return values

    def at(self, t: float, x: Sequence[float] | np.ndarray) -> "Exchanged":
        """Sets time and continuous states."""
        values = np.array(x, float)
        self.model.setTime(t)
        self.model.setContinuousStates(values.ctypes.data_as(POINTER(c_double)), len(values))
        return self

    # statuses

    def status(self, call: Any, *arguments: Any) -> str:
        """Returns what a method of FMPy's model, by its name, gives: ok, or the status that FMPy raises."""
        try:
            getattr(self.model, call)(*arguments)
        except FMICallException as error:
            return ("ok", "warning", "discard", "error", "fatal")[error.status]
        return "ok"

    def refused(self, call: Any, *arguments: Any, status: str = "error") -> str:
        """Returns the message of a call that has this status."""
        assert self.status(call, *arguments) == status
        return self.log[-1]

    def vector(self, name: str, count: int | None = None, array: Any = None) -> tuple[Any, ...]:
        """Returns a call of a function with an array of doubles and its length, as arguments of `status`."""
        values = (c_double * 8)() if array is None else array
        return f"fmi2{name}", self.model.component, values, self.count if count is None else count

    # the solver

    def run(self, end: float, h: float, begin: float = 0.0) -> "Exchanged":
        """Integrates from event mode with the classical Runge-Kutta method, and with all time events."""
        t = begin
        while True:
            *_, is_defined, at = self.event()
            self.model.enterContinuousTimeMode()
            until = min(end, at) if is_defined else end
            if until <= t:
                return self
            steps = max(1, round((until - t) / h))
            for i in range(steps):
                x = rk4(self.slope, t + i * (until - t) / steps, self.states, (until - t) / steps)
                self.at(t + (i + 1) * (until - t) / steps, x)
            t = until
            self.model.setTime(t)
            self.model.enterEventMode()

    def slope(self, t: float, x: np.ndarray) -> np.ndarray:
        return self.at(t, x).rates


def euler(slope: Slope, t: float, x: np.ndarray, h: float) -> np.ndarray:
    return x + h * slope(t, x)


def heun(slope: Slope, t: float, x: np.ndarray, h: float) -> np.ndarray:
    first = slope(t, x)
    return x + h / 2 * (first + slope(t + h, x + h * first))


def rk4(slope: Slope, t: float, x: np.ndarray, h: float) -> np.ndarray:
    k1 = slope(t, x)
    k2 = slope(t + h / 2, x + h / 2 * k1)
    k3 = slope(t + h / 2, x + h / 2 * k2)
    k4 = slope(t + h, x + h * k3)
    return x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
