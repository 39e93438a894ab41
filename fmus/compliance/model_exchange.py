"""One instance for model exchange with the methods of a slave: a step integrates and handles events.

At communication points the instance is in event mode, in which every variable can be read, and inputs,
tunable parameters and saved states can be set.

`fmus/fmi/model_exchange.py` runs FMUs by CVode. Here an explicit scheme steps: a rule reads every call of a
step and what each event changes, which CVode hides, and the process of the FMU loads no other library.
"""

import ctypes
import math
from collections.abc import Callable, Sequence
from typing import Any

from fmus.compliance.called_instance import CalledInstance
from fmus.compliance.texts import UNWRITTEN
from fmus.fmi.binding import DISCARD, MODEL_EXCHANGE, OK, WARNING

_MOST_SUBSTEPS, _MOST_EVENTS, _MOST_ITERATIONS = 500, 100, 100
_LEAST = 1e-6  # smallest part of a step that is tried
_HALVINGS, _MOST_OF_A_JUMP, _LEAST_JUMP = 20, 0.8, 0.01  # of a substep; of a change; relative
_TOLERANCE = 1e-3
_TOO_MANY = "the explicit scheme of this checker needs more than"
_STATES, _DERIVATIVES = "fmi2GetContinuousStates", "fmi2GetDerivatives"
_INDICATORS = "fmi2GetEventIndicators"
_NO_BOOLEAN = -1234567  # a flag that the FMU has not written


_INFOS = (
    "newDiscreteStatesNeeded", "terminateSimulation", "nominalsOfContinuousStatesChanged",
    "valuesOfContinuousStatesChanged", "nextEventTimeDefined", "nextEventTime",
)  # fmt: skip


_Trial = tuple[list[float], list[float], float]  # states, indicators, error over its tolerance
_Point = tuple[float, list[float], list[float]]  # time, states, derivatives


class EventInfo(ctypes.Structure):
    """Structure fmi2EventInfo of fmi2FunctionTypes.h."""

    _fields_ = [(name, ctypes.c_double if name == _INFOS[-1] else ctypes.c_int) for name in _INFOS]


class _StepEndsError(Exception):
    """A step that cannot go on; the message is the reason, or empty after a call that failed."""


class CalledModelExchange(CalledInstance):
    """An instance for model exchange.

    further options: states and indicators, the numbers of both
      needs_completed: whether fmi2CompletedIntegratorStep must be called
      again: whether fmi2NewDiscreteStates is called once more at the end of each event
      observed: type -> value references of variables that `observed_events` has with the events
    """

    interface = MODEL_EXCHANGE

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._time = self._next_event = math.nan
        self._ends: dict[str, float] = {}
        self._events: list[dict[str, Any]] = []
        self._counts = self._options["states"], self._options["indicators"]

    # single functions

    def vector(self, function: str) -> list[float]:
        """Returns the states, their derivatives or nominals, or the event indicators."""
        count = self._counts[function == _INDICATORS]
        return self.results(ctypes.c_double, count, lambda array: self.call(function, array, count))

    def count(self, function: str) -> int:
        """Returns a number that FMI 3.0 has a function for."""
        size = ctypes.c_size_t()
        self.call(function, ctypes.byref(size))
        return size.value

    def new_discrete_states(self) -> dict[str, Any]:
        """Returns the elements of fmi2EventInfo by name."""
        info = EventInfo(*[_NO_BOOLEAN] * 5)
        self.call("fmi2NewDiscreteStates", ctypes.byref(info))
        flags = self._booleans([getattr(info, name) for name in _INFOS[:-1]])
        return dict(zip(_INFOS, [*flags, info.nextEventTime], strict=True))

    def _booleans(self, flags: list[int]) -> list[int]:
        """Returns flags that the FMU was to write, 0 for each that is no Boolean, and notes that."""
        self.note(UNWRITTEN, self.last_status == OK and not {*flags} <= {0, 1})
        return [flag if flag in (0, 1) else 0 for flag in flags]

    def completed_integrator_step(self, no_going_back: bool = True) -> list[int]:
        """Returns enterEventMode and terminateSimulation."""
        flags = [ctypes.c_int(_NO_BOOLEAN), ctypes.c_int(_NO_BOOLEAN)]
        self.call("fmi2CompletedIntegratorStep", int(no_going_back), *map(ctypes.byref, flags))
        return self._booleans([flag.value for flag in flags])

    def complete_step(self) -> str:
        """Completes a step in which there is no event; returns the reason why it is discarded otherwise."""
        if any(self.completed_integrator_step(no_going_back=False)):
            self.last_status = DISCARD
            return "a step event comes first"
        return ""

    # steps

    def exit_initialization_mode(self) -> str:
        """Leaves initialization mode and handles the first event; returns as `do_step`."""

        def start() -> None:
            self._checked(self.call, "fmi2ExitInitializationMode")
            self._handle_event("start")

        self._time, self._ends = math.nan, {}
        return self._lead(start)

    def do_step(self, t: float, h: float, no_going_back: bool = False, roughness: float = 1.0) -> str:
        """Integrates from t to t + h seconds, with the events meanwhile; roughness: times the tolerances.

        Returns the reason why a step is discarded although no call failed, or nothing.
        """
        self._roughness = roughness
        t = self._own_time(t)
        self._ends[f"{t + h:.9g}"] = t + h
        return self._lead(lambda: self._advance(t, t + h, no_going_back))

    def set_time(self, t: float) -> None:
        """Sets the time, at a communication point to the exact time of the instance."""
        self.call("fmi2SetTime", self._own_time(t))

    def _own_time(self, t: float) -> float:
        """Returns the time of the instance that equals the given time but for rounding, also after a state
        was set back.
        """
        return self._ends.get(f"{t:.9g}", t)

    def observed_events(self) -> list[dict[str, Any]]:
        return self._events

    def _lead(self, action: Callable[[], None]) -> str:
        try:
            action()
        except _StepEndsError as reason:
            if str(reason):
                self.last_status = DISCARD
            return str(reason)
        return ""

    def _checked(self, method: Callable[..., Any], *arguments: Any) -> Any:
        """Returns the result of a method; raises _StepEndsError if its function fails."""
        warned, result = self.last_status, method(*arguments)
        if self.last_status or warned:
            if not 0 <= self.last_status <= WARNING:
                raise _StepEndsError
            self.last_status = max(warned, self.last_status)
        return result

    def _advance(self, t: float, end: float, no_going_back: bool) -> None:
        self._time = t
        # inputs may have been set since the last step
        self._handle_event("communication point")
        self._substeps = 0
        for _ in range(_MOST_EVENTS):
            self._checked(self.call, "fmi2EnterContinuousTimeMode")
            until = min(end, max(t, self._next_event))
            t, cause = self._integrate(t, until, (end - t) * _LEAST * self._roughness, no_going_back)
            self._time = t
            self._note("left")
            self._checked(self.call, "fmi2EnterEventMode")
            self._handle_event(cause)
            if t >= end:
                return
        raise _StepEndsError(f"the FMU has more than {_MOST_EVENTS} events in one step")

    def _handle_event(self, cause: str) -> None:
        """Calls fmi2NewDiscreteStates until no new discrete states are needed."""
        observed = "observed" in self._options
        vectors = [self._state_vectors()] if observed else []
        infos: list[dict[str, Any]] = []
        if observed:
            self._events.append({"cause": cause, "time": self._time, "infos": infos, "vectors": vectors})
        while not infos or infos[-1]["newDiscreteStatesNeeded"]:
            if len(infos) == _MOST_ITERATIONS:
                raise _StepEndsError(f"an event needs more than {_MOST_ITERATIONS} iterations")
            infos.append(self._checked(self.new_discrete_states))
            self._terminate_if(infos[-1]["terminateSimulation"])
            vectors += [self._state_vectors()] if observed else []
        self._note("values")
        last = infos[-1]
        if self._options.get("again"):
            last = self._checked(self.new_discrete_states)  # which has nothing to do
            self._note("again")
        self._next_event = last["nextEventTime"] if last["nextEventTimeDefined"] else math.inf

    def _note(self, when: str) -> None:
        """Notes the observed variables in the latest event, with states and derivatives as vectors: their
        values after it, or where it is left.
        """
        if self._events:
            references = self._options["observed"].items()
            values = {kind: self._checked(self.read, kind, some) for kind, some in references}
            self._events[-1][when] = values | {name: self._read(name) for name in (_STATES, _DERIVATIVES)}

    def _state_vectors(self) -> list[list[float]]:
        return [self._read(_STATES), self._read("fmi2GetNominalsOfContinuousStates")]

    def _read(self, function: str) -> list[float]:
        """Returns a vector; an empty one without a call."""
        return self._checked(self.vector, function) if self._counts[function == _INDICATORS] else []

    def _terminate_if(self, terminates: int) -> None:
        if terminates:
            raise _StepEndsError("the FMU asks to terminate the simulation")

    def _integrate(self, t: float, end: float, least: float, no_going_back: bool) -> tuple[float, str]:
        """Integrates by Heun's scheme up to an event, or the end; returns its time and its cause.

        least: size of substeps that neither the error nor an event indicator makes smaller [s]
        """
        x, z, slopes = (self._read(function) for function in (_STATES, _INDICATORS, _DERIVATIVES))
        if self._events:
            self._events[-1] |= {"begin": x, "indicators": z}
        size = end - t
        while t < end:
            self._substeps += 1
            if self._substeps > _MOST_SUBSTEPS:
                raise _StepEndsError(f"{_TOO_MANY} {_MOST_SUBSTEPS} substeps in a step")
            is_last = size >= end - t
            new_t = end if is_last else t + size
            trial = self._trial(x, slopes, t, new_t, size <= least)
            is_crossing = trial is not None and _signs(z) != _signs(trial[1])
            if trial is None or (is_crossing and size > least):
                if size <= least:
                    raise _StepEndsError("the FMU discards states, or gives no numbers, in smallest substeps")
                size = min(size, end - t) / 2
                continue
            if self._events:
                end_of_it = new_t, trial[0], self._read(_DERIVATIVES)
                self._events[-1].setdefault("jumps", []).extend(self._jumps((t, x, slopes), end_of_it))
            before, t, (x, z, error) = z, new_t, trial
            size *= 2 if error < 0.2 else 1
            enter = 0
            if self._options["needs_completed"]:
                states = [x, self._read(_STATES)] if self._events else []
                enter, terminates = self._checked(self.completed_integrator_step, no_going_back)
                self._terminate_if(terminates)
                if self._events:
                    self._events[-1].setdefault("completed", []).append([*states, self._read(_STATES)])
            if is_crossing and self._events:
                self._events[-1]["crossing"] = [before, z, self._read(_INDICATORS)]
            if enter or is_crossing:
                return t, "step event" if enter else "state event"
            if t < end:
                slopes = self._read(_DERIVATIVES)
        return t, "time event" if t == self._next_event else "communication point"

    def _trial(
        self, x: list[float], slopes: list[float], t: float, end: float, is_smallest: bool
    ) -> _Trial | None:
        """Returns states, indicators and the error over its tolerance at the end of a substep.

        None if the error is too large, unless the substep is as small as any, if the FMU discards something,
        or what it gives is not finite.
        """
        h, tolerance = end - t, _TOLERANCE * self._roughness
        try:
            _, euler, others = self._at(end, _sum(x, h, slopes))
            new = _sum(_sum(x, h / 2, slopes), h / 2, others)
            sizes = (abs(a - b) / (tolerance * max(abs(a), 1e-3)) for a, b in zip(euler, new, strict=True))
            error = max(sizes, default=0.0)
            if error > 1 and not is_smallest:
                return None
            z = self._vector_at(new, _INDICATORS)
        except _StepEndsError:
            if self.last_status != DISCARD:
                raise
            self.last_status = 0
            return None
        if not all(map(math.isfinite, [*new, *z])):
            return None
        return new, z, error

    def _jumps(self, first: _Point, end: _Point) -> list[list[Any]]:
        """Returns time, and derivatives before and after it, if one jumps between two points: half of the way
        has most of its change, again and again.
        """
        if _difference(first, end) < _LEAST_JUMP:
            return []
        last, jumps = end, list[list[Any]]()
        for _ in range(_HALVINGS):
            x = _sum([a / 2 for a in first[1]], 0.5, last[1])
            middle = self._at((first[0] + last[0]) / 2, x)
            half = max((first, middle), (middle, last), key=lambda pair: _difference(*pair))
            if _difference(*half) < _MOST_OF_A_JUMP * _difference(first, last):
                break
            first, last = half
        else:
            jumps = [[last[0], first[2], last[2]]]
        self._at(*end[:2])
        return jumps

    def _at(self, t: float, x: list[float]) -> _Point:
        """Sets time and states; returns them with the derivatives there."""
        self._checked(self.call, "fmi2SetTime", t)
        return t, x, self._vector_at(x, _DERIVATIVES)

    def _vector_at(self, x: list[float], function: str) -> list[float]:
        """Sets states, if there are any, and returns a vector there."""
        if x:
            states = (ctypes.c_double * len(x))(*x)
            self._checked(self.call, "fmi2SetContinuousStates", states, len(x))
        return self._read(function)


def _sum(x: Sequence[float], factor: float, others: Sequence[float]) -> list[float]:
    """Returns x + factor others."""
    return [a + factor * b for a, b in zip(x, others, strict=True)]


def _difference(one: _Point, other: _Point) -> float:
    """Returns the largest change of a derivative, relative or absolute, whichever is less."""
    pairs = zip(one[2], other[2], strict=True)
    return max((abs(a - b) / max(1.0, abs(a), abs(b)) for a, b in pairs), default=0.0)


def _signs(indicators: Sequence[float]) -> list[bool]:
    """Returns the domain of each event indicator, as 3.1 has it."""
    return [z > 0 for z in indicators]
