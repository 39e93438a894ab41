"""The recording that a run returns, and the errors and warnings of its loop as those of Python."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fmus.fmi.binding import DISCARD, OK, WARNING
from fmus.fmi.description import start_value
from orchestration.errors import FmuError, OrchestrationError
from orchestration.results.recording import Recording
from orchestration.run.loop_data import Call, Report, Wiring
from orchestration.run.wiring import WiredRun
from orchestration.system.prepared_run import PreparedRun

_FUNCTIONS: dict[int, str] = {
    Call.DO_STEP: "fmi2DoStep",
    Call.GET_STATE: "fmi2GetFMUstate",
    Call.SET_STATE: "fmi2SetFMUstate",
}


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
    more: further entries of the provenance; is_final: all rows become those of the recording, without a copy
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
