"""Failures and warnings of the loop as errors and warnings of Python."""

from fmus.fmi.binding import DISCARD, OK, WARNING
from orchestration.errors import FmuError, OrchestrationError
from orchestration.run.loop_data import Call, LoopFunctions, Report, Wiring
from orchestration.run.wiring import WiredRun


def is_discarded_step(wiring: Wiring) -> bool:
    """Whether the reported failure is a step that a component discarded."""
    return wiring.report[Report.FAILURE] == Call.DO_STEP and wiring.report[Report.STATUS] == DISCARD


def step_unless_discarded(run: WiredRun, loop: LoopFunctions, point: int, start: float, end: float) -> bool:
    """Step from `start` to `end` [s]; False if a component discards the step.

    point: the communication point at or before `start`
    Raises `failure_error` for any other failure.
    """
    if loop.step(point, start, end):
        return True
    if not is_discarded_step(run.wiring):
        raise failure_error(run, start)
    return False


def failure_error(run: WiredRun, time: float | None = None) -> OrchestrationError:
    """The error for the reported failure.

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
    function = run.functions[int(report[Report.FAILURE])][index]
    try:
        instance.check_status(function, int(report[Report.STATUS]))
    except FmuError as error:
        return error
    return FmuError(instance.name, time, function, "an error, and its log was cleared", [])


def emit_warnings(run: WiredRun, failed: bool) -> None:
    """Warn of the calls in the loop that returned warnings or logged messages.

    failed: whether the loop ended with a failure; the log of that component is left for `failure_error`
    """
    wiring = run.wiring
    for c, instance in enumerate(run.instances.values()):
        if failed and c == wiring.report[Report.COMPONENT]:
            continue
        kind = int(wiring.warning[c])
        if kind != Call.NO_FAILURE or instance.log:
            instance.time = float(wiring.warning_time[c] if kind else wiring.step_start[c])
            function = run.functions[kind][0] if kind else "fmi2DoStep"
            instance.check_status(function, WARNING if kind else OK)
            wiring.warning[c] = Call.NO_FAILURE


def reason_of(error: BaseException) -> str:
    """Why a run ended, in one line."""
    if isinstance(error, KeyboardInterrupt):
        return "interrupted"
    return str(error) if isinstance(error, OrchestrationError) else repr(error)
