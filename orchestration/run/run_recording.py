"""Everything that a run returns: its recording with its times, and its errors and warnings as Python's."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fmus.fmi.binding import DISCARD, OK, WARNING
from fmus.fmi.description import start_value
from orchestration.errors import FmuError, OrchestrationError, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run.loop_data import Call, Report, Wiring
from orchestration.run.wiring import WiredRun
from orchestration.system.prepared_run import PreparedRun

_FUNCTIONS: dict[int, str] = {
    Call.DO_STEP: "fmi2DoStep",
    Call.GET_STATE: "fmi2GetFMUstate",
    Call.SET_STATE: "fmi2SetFMUstate",
}
# Between two checks for an interrupt, which would otherwise wait for the whole pause.
_LONGEST_SLEEP_S = 0.1
_UNMEASURED = nullcontext()


def make_recording(
    prepared: PreparedRun,
    rows: np.ndarray,
    count: int,
    strings: Sequence[str] = (),
    more: Mapping[str, Any] = {},
    is_final: bool = False,
) -> Recording:
    """Returns the recorded values at the first `count` communication points.

    rows: shape `prepared.shape`, of many runs with a first axis of runs
    strings: of Strings, by their numbers; without them Strings are empty
    more: further entries of the provenance; is_final: the recording takes the rows without a copy
    """
    variables = [prepared.system.ports[name].variable for name in prepared.recorded]
    values, time = rows[..., :count, :], prepared.points[:count]
    if not (is_final and count == rows.shape[-2]):
        values, time = values.copy(), time.copy()
    is_string = np.array([variable.type == "String" for variable in variables], bool)
    if not strings and is_string.any():
        values[..., is_string] = 0.0
    return Recording(
        names=prepared.recorded,
        units=tuple(variable.unit or "" for variable in variables),
        time=time,
        values=values,
        provenance=_provenance(prepared) | dict(more),
        strings={prepared.recorded[i]: tuple(strings or ("",)) for i in np.flatnonzero(is_string)},
    )


def _provenance(prepared: PreparedRun) -> dict[str, Any]:
    """Returns the FMUs and the settings of the run, as plain data."""
    experiment = prepared.experiment
    starts = ((port.name, start_value(port.variable)) for port in prepared.system.open_inputs)
    # JSON has no INF
    open_inputs = {n: x if isinstance(x, str) or math.isfinite(x) else str(x) for n, x in starts}
    return {
        "fmus": {
            name: {"guid": d.guid, "model": d.modelName, "tool": d.generationTool}
            for name, d in prepared.system.descriptions.items()
        },
        "algorithm": str(experiment.algorithm),
        "communication_step_size_s": experiment.step_size,
        "extrapolation": experiment.extrapolation,
        **({"tolerance": experiment.tolerance} if experiment.tolerance else {}),
        **({"fmu_tolerance": experiment.fmu_tolerance} if experiment.fmu_tolerance else {}),
        **({"step_sizes_s": dict(experiment.step_sizes)} if experiment.step_sizes else {}),
        **({"open_inputs": open_inputs} if open_inputs else {}),
        **({"faults": [repr(fault) for fault in experiment.faults]} if experiment.faults else {}),
    }


def is_discarded_step(wiring: Wiring) -> bool:
    """Whether the reported failure is a step that a component discarded."""
    return wiring.report[Report.FAILURE] == Call.DO_STEP and wiring.report[Report.STATUS] == DISCARD


def step_unless_discarded(run: WiredRun, point: int, start: float, end: float) -> bool:
    """Steps from `start` to `end` [s]; False if a component discards the step.

    point: the communication point at or before `start`
    Raises `failure_error` for any other failure.
    """
    if run.loop.step(point, start, end):
        return True
    if not is_discarded_step(run.wiring):
        raise failure_error(run, start)
    return False


def failure_error(run: WiredRun, time: float | None = None) -> OrchestrationError:
    """Returns the error for the reported failure.

    time: start of the present step [s], by default the present communication point
    """
    report = run.wiring.report
    time = float(run.wiring.points[report[Report.POSITION]]) if time is None else time
    index = int(report[Report.INDEX])
    if report[Report.FAILURE] == Call.NOT_FINITE:
        source, target = run.bus.connections[index]
        value = run.wiring.connections.value[index]
        return OrchestrationError(
            f"{source} is {value:g} at t = {time:.9g} s: expected a finite number, as it goes to {target}"
        )
    instance = list(run.instances.values())[report[Report.COMPONENT]]
    instance.time = time
    function = _function(run, int(report[Report.FAILURE]), index)
    try:
        instance.check_status(function, int(report[Report.STATUS]))
    except FmuError as error:
        return error
    return FmuError(instance.name, time, function, "an error, and its log was cleared", [])


def _function(run: WiredRun, kind: int, index: int = 0) -> str:
    """Returns the FMI function of a kind of call; index: of its group."""
    return _FUNCTIONS.get(kind) or run.bus.calls[kind][index].function


def emit_warnings(run: WiredRun, failed: bool) -> None:
    """Issues warnings of calls in the loop that returned warnings or logged messages.

    failed: whether the loop ended with a failure; the log of that component is left for `failure_error`
    """
    wiring = run.wiring
    for c, instance in enumerate(run.instances.values()):
        if failed and c == wiring.report[Report.COMPONENT]:
            continue
        kind = int(wiring.warning[c])
        if kind != Call.NO_FAILURE or instance.log:
            instance.time = float(wiring.warning_time[c] if kind else wiring.step_start[c])
            function = _function(run, kind or Call.DO_STEP)
            instance.check_status(function, WARNING if kind else OK)
            wiring.warning[c] = Call.NO_FAILURE


def reason_of(error: BaseException) -> str:
    """Returns why a run ended, in one line."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return str(error) if isinstance(error, OrchestrationError) else repr(error)


class RunStatistics:
    """Statistics of one run: the wall time [s] of each phase, and the steps of each FMU.

    is_asked_for: whether there is a report; without one the loop counts and measures no steps
    steps: shape (3, FMUs), the steps of each, their wall and CPU time [s], to which the loop adds; else 0
    start_time: simulated time [s] from which the run stepped
    """

    def __init__(self, components: Iterable[str], is_asked_for: bool = True) -> None:
        self._components, self._is_asked_for = tuple(components), is_asked_for
        self.steps: Any = np.zeros((3, len(self._components))) if is_asked_for else 0
        self.start_time = 0.0
        self._phases: dict[str, float] = {}

    def phase(self, name: str) -> AbstractContextManager[None]:
        """Returns a context that adds the time of what happens in it, which may fail."""
        return self._measured(name) if self._is_asked_for else _UNMEASURED

    @contextmanager
    def _measured(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self._phases[name] = self._phases.get(name, 0.0) + time.perf_counter() - start

    def report(self, end_time: float, is_sequential: bool) -> dict[str, Any]:
        """Returns phases and FMUs as an entry of a recording's provenance, without a step the phases alone.

        end_time: simulated time [s] that was reached
        is_sequential: whether FMUs stepped one after another; the rest of the loop is the time between them
        """
        if not self._is_asked_for:
            return {}
        if "stepping" not in self._phases:
            return {"statistics": {"phases_s": self._phases}}
        stepping, simulated = self._phases["stepping"], end_time - self.start_time
        counts, times, used = self.steps.tolist()
        rest = {"rest_of_loop_s": stepping - sum(times)} if is_sequential else {}
        statistics = {
            "phases_s": self._phases,
            "simulated_s": simulated,
            "real_time_factor": simulated / stepping,
            "fmus": {
                name: {"steps": int(count), "wall_s": wall, "cpu_s": cpu}
                for name, count, wall, cpu in zip(self._components, counts, times, used, strict=True)
            },
            **rest,
        }
        return {"statistics": statistics}


@dataclass
class Pacing:
    """Simulated time passes at `factor` times the wall clock, from the first `wait` on.

    Raises SystemDefinitionError for a factor that is not more than 0.

    missed: number of points reached too late
    worst: largest lateness [s of the wall clock]; worst_at: simulated time of that point [s]
    """

    factor: float = 1.0
    missed: int = 0
    worst: float = 0.0
    worst_at: float = 0.0
    _zero: float | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.factor) and self.factor > 0.0):
            raise SystemDefinitionError(f"real time factor {self.factor!r}: expected more than 0")

    def wait(self, t: float, check_interrupt: Callable[[], None]) -> None:
        """Waits until it is time for the communication point t [s]."""
        now = time.perf_counter()
        if self._zero is None:
            self._zero = now - t / self.factor
        late = now - (self._zero + t / self.factor)
        if late < 0.0:
            while (left := self._zero + t / self.factor - time.perf_counter()) > 0.0:
                time.sleep(min(left, _LONGEST_SLEEP_S))
                check_interrupt()
        elif late > 0.0:
            self.missed += 1
            self.worst, self.worst_at = max((self.worst, self.worst_at), (late, t), key=lambda late: late[0])

    def report(self) -> dict[str, float | int]:
        """Returns the factor and the missed deadlines, for the provenance of a recording."""
        return {
            "factor": self.factor,
            "missed_deadlines": self.missed,
            "worst_lateness_s": self.worst,
            "worst_at_s": self.worst_at,
        }
