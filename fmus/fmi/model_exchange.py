"""An instance of an FMU for model exchange alone, with the calls of one for co-simulation.

A step handles an event, for the values that were set since the last step. Then it integrates by FMPy's CVode
from event to event up to the next communication point. There the instance is in event mode: every variable
can be read, and inputs, tunable parameters and saved states can be set.
"""

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from fmpy.fmi2 import fmi2EventInfo
from fmpy.sundials import CVodeSolver
from fmpy.sundials.cvode import CV_ROOT_RETURN, CVode
from fmpy.sundials.libraries import sundials_core, sundials_cvode
from fmpy.sundials.sundials_context import SUNContext_PushErrHandler

from fmus.fmi.binding import DISCARD, ERROR, MODEL_EXCHANGE, OK, WARNING, status_name
from fmus.fmi.instance import FmuInstance
from fmus.fmi.model_description import ModelDescription

# Relative tolerance of the solver if the run states none. The solver starts again where inputs change, so
# that errors add up.
_TOLERANCE = 1e-9
# In one step: more events have no end, as with a ball that comes to rest.
_MOST_EVENTS = 10_000
# of one event
_MOST_ITERATIONS = 100
# CV_ONE_STEP of cvode.h: CVode returns after each of its internal steps
_ONE_STEP = 2
# FMPy declares no types for this function
_set_stop_time = sundials_cvode.CVodeSetStopTime
_set_stop_time.argtypes, _set_stop_time.restype = [ctypes.c_void_p, ctypes.c_double], ctypes.c_int
# of fmi2DoStep, and of fmi2GetRealStatus and fmi2GetBooleanStatus
_Step = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int)
_Status = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_void_p, ctypes.c_int, ctypes.c_void_p)


class _StepEndsError(Exception):
    """The early end of a step, with its status."""

    def __init__(self, status: int, message: str) -> None:
        super().__init__(message)
        self.status = status


class ModelExchangeInstance(FmuInstance):
    """An instance of an FMI 2.0 FMU for model exchange; its fmi2DoStep integrates and handles events.

    It has the arguments and errors of `FmuInstance`.
    """

    interface = MODEL_EXCHANGE

    def __init__(self, name: str, path: Path, description: ModelDescription) -> None:
        super().__init__(name, path, description)
        self._tolerance, self._worst = _TOLERANCE, OK
        self._next_event, self._reached, self._terminates = math.inf, 0.0, False
        # The library has no other user: FMUs for model exchange alone do not share theirs.
        vars(self.library).update(
            fmi2DoStep=_Step(self._do_step),
            fmi2GetRealStatus=_Status(self._real_status),
            fmi2GetBooleanStatus=_Status(self._boolean_status),
        )

    def set_up_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        self._tolerance, self._reached = tolerance or _TOLERANCE, start_time
        super().set_up_experiment(start_time, stop_time, tolerance)

    def exit_initialization_mode(self) -> None:
        """Leaves initialization mode and handles the first event."""
        super().exit_initialization_mode()
        self._worst = OK
        try:
            self._handle_event()
            self._solver = _Solver(self._checked, self.description, self._reached, self._tolerance)
        except _StepEndsError as end:
            self._worst = end.status
            self.log.append((end.status, str(end)))
        self.check_status("fmi2NewDiscreteStates", self._worst)

    def check_status(self, function: str, status: int) -> None:
        """Checks a status as `FmuInstance` does; the FMU has no fmi2DoStep: the log names its function."""
        super().check_status("integration" if function == "fmi2DoStep" else function, status)

    def _do_step(self, _: int, start: float, size: float, no_going_back: int) -> int:
        """Implements fmi2DoStep."""
        # The caller is C: no exception may leave this function.
        self._worst = OK
        try:
            self._advance(start, start + size, no_going_back)
        except _StepEndsError as end:
            self.log.append((end.status, str(end)))
            return end.status
        except Exception as error:
            self.log.append((ERROR, repr(error)))
            return ERROR
        return self._worst

    def _real_status(self, _: int, kind: int, value: int) -> int:
        """Implements fmi2GetRealStatus, of the last successful time."""
        ctypes.c_double.from_address(value).value = self._reached
        return OK

    def _boolean_status(self, _: int, kind: int, value: int) -> int:
        """Implements fmi2GetBooleanStatus, of whether the FMU terminates the simulation."""
        ctypes.c_int.from_address(value).value = int(self._terminates)
        return OK

    def start_anew(self) -> None:
        self._solver.end = None

    def _checked(self, function: str, *arguments: Any) -> None:
        """Calls a function; a failure ends the step."""
        status = self.status(function, *arguments)
        self._remember(status)
        if status not in (OK, WARNING):
            raise _StepEndsError(status, f"{function} returned {status_name(status)}")
        self._worst = max(self._worst, status)

    def _advance(self, time: float, end: float, no_going_back: int) -> None:
        """Integrates from event to event, up to the end of a step."""
        self._reached, self._terminates = time, False
        self._handle_event()
        for _ in range(_MOST_EVENTS):
            self._checked("fmi2EnterContinuousTimeMode")
            self._integrate(min(end, self._next_event), no_going_back)
            self._checked("fmi2EnterEventMode")
            self._handle_event()
            if self._reached >= end:
                return
        raise _StepEndsError(ERROR, f"more than {_MOST_EVENTS} events in one step, at {self._reached:.9g} s")

    def _integrate(self, end: float, no_going_back: int) -> None:
        """Integrates up to the next event of a state or of a step, or to a time [s]."""
        self._solver.begin(self._reached)
        is_event = False
        while self._reached < end and not is_event:
            # CVode refuses such an end as too close
            if end - self._reached < 8 * math.ulp(end):
                self._checked("fmi2SetTime", end)
                self._reached, is_event = end, True
            else:
                self._reached, is_event = self._solver.advance(end)
            enters, terminates = ctypes.c_int(), ctypes.c_int()
            flags = ctypes.byref(enters), ctypes.byref(terminates)
            self._checked("fmi2CompletedIntegratorStep", no_going_back, *flags)
            self._end_if(terminates.value)
            is_event = is_event or bool(enters.value)
        if not is_event and self._reached < self._next_event:
            self._solver.end = self._reached, self._solver.values()

    def _handle_event(self) -> None:
        """Calls fmi2NewDiscreteStates until no new discrete states are needed."""
        info = fmi2EventInfo()
        for _ in range(_MOST_ITERATIONS):
            self._checked("fmi2NewDiscreteStates", ctypes.byref(info))
            self._end_if(info.terminateSimulation)
            if not info.newDiscreteStatesNeeded:
                self._next_event = info.nextEventTime if info.nextEventTimeDefined else math.inf
                return
        raise _StepEndsError(ERROR, f"an event needs more than {_MOST_ITERATIONS} fmi2NewDiscreteStates")

    def _end_if(self, terminates: int) -> None:
        if terminates:
            self._terminates = True
            raise _StepEndsError(DISCARD, f"the FMU terminates the simulation at {self._reached:.9g} s")


class _Solver(CVodeSolver):
    """CVode with the vectors of an instance, whose functions `call` calls."""

    def __init__(
        self, call: Callable[..., None], description: ModelDescription, start: float, tolerance: float
    ) -> None:
        def vector(function: str) -> Callable[[Any, int], None]:
            return lambda values, count: call(function, values, count)

        self._failure: _StepEndsError | None = None
        self.end: tuple[float, bytes] | None = None
        super().__init__(
            nx=description.numberOfContinuousStates,
            nz=description.numberOfEventIndicators,
            get_x=vector("fmi2GetContinuousStates"),
            set_x=vector("fmi2SetContinuousStates"),
            get_dx=vector("fmi2GetDerivatives"),
            get_z=vector("fmi2GetEventIndicators"),
            get_nominals=vector("fmi2GetNominalsOfContinuousStates"),
            set_time=lambda time: call("fmi2SetTime", time),
            # inputs are held in a step
            input=SimpleNamespace(apply=lambda time: None),
            startTime=start,
            relativeTolerance=tolerance,
        )
        # The default handlers print; here the error has the message.
        sundials_core.SUNContext_ClearErrHandlers(self.sunctx)
        SUNContext_PushErrHandler(self.sunctx, self.ehfun_, None)

    def f(self, *arguments: Any) -> int:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self._answer(super().f, arguments)

    def g(self, *arguments: Any) -> int:  # pyright: ignore[reportIncompatibleMethodOverride]
        return self._answer(super().g, arguments)

    def _answer(self, function: Callable[..., int], arguments: tuple[Any, ...]) -> int:
        """Returns 0, a number above 0 to try a smaller step after a discard, or one below 0 to fail."""
        try:
            return function(*arguments)
        except _StepEndsError as error:
            self._failure = error
            return 1 if error.status == DISCARD else -1

    def begin(self, time: float) -> None:
        """Starts again at a time [s], or goes on if `end` is there and has, bit for bit, the same values."""
        end, self.end = self.end, None
        if not end or end != (time, self.values()):
            self.reset(time)

    def values(self) -> bytes:
        """Returns states, derivatives and event indicators."""
        count = 0 if self.discrete else self.nx
        vectors = [(ctypes.c_double * n)() for n in (count, count, self.nz)]
        for get, vector in zip((self.get_x, self.get_dx, self.get_z), vectors, strict=True):
            if vector:
                get(vector, len(vector))
        return b"".join(map(bytes, vectors))

    def advance(self, end: float) -> tuple[float, bool]:
        """Takes one step, not beyond `end` [s]; returns its time, and whether it ends at a state event."""
        reached, self._failure = ctypes.c_double(), None
        _set_stop_time(self.cvode_mem, end)
        flag = CVode(self.cvode_mem, end, self.x, ctypes.byref(reached), _ONE_STEP)
        if flag < 0:
            reason = self.error_info and self.error_info[-1]
            raise self._failure or _StepEndsError(ERROR, f"CVode returned {flag}: {reason}")
        self.set_time(reached.value)
        if not self.discrete:
            self.set_x(self.px, self.nx)
        return reached.value, flag == CV_ROOT_RETURN
