"""The table of calls that are allowed in each state, and what FMI says of statuses."""

from collections.abc import Iterator

from fmus.binding import DISCARD, PENDING, status_name
from fmus.compliance.lifecycle_rules import unknown_reference
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Level, NotJudgedError, Stage, rule
from fmus.compliance.script import Reply, Script
from fmus.compliance.session import session
from fmus.compliance.values import start_value
from fmus.compliance.variable import Variable

_STATUS = "2.1.3 Status Returned by Functions"
_STATES = "4.2.4 State Machine of Calling Sequence from Master to Slave"
_LAST_SUCCESSFUL_TIME = 2


def _may_discard(reply: Reply) -> bool:
    setter = reply.function in ("fmi2SetReal", "fmi2SetInteger", "fmi2SetBoolean", "fmi2SetString")
    return setter or reply.function == "fmi2DoStep" or reply.function.endswith("Status")


@rule(_STATES, Stage.BEHAVIOUR, needs=["reset-in-every-state"])
def allowed_calls_succeed(probe: Probe) -> Iterator[str]:
    """The functions that the FMU supports succeed in the states, instantiated to terminated, that allow
    them.
    """
    named = set()
    played = session(probe)
    for reply in played.script.replies:
        discarded = reply.status == DISCARD  # if it may not, `statuses_are_legal` tells
        if reply.status is None or reply.ok or discarded or (reply.function, reply.state) in named:
            continue
        named.add((reply.function, reply.state))
        yield f"in the state {reply.state!r}: {reply.problem}"
        return  # what follows in this instance has the same cause


@rule(_STATUS, Stage.BEHAVIOUR)
def statuses_are_legal(probe: Probe) -> Iterator[str]:
    """Discard and pending come only from functions that may return them; every status is one of
    fmi2Status.
    """
    for reply in session(probe).script.replies:
        if reply.status is None:
            continue
        if not 0 <= reply.status <= PENDING:
            yield f"{reply.function} returned {reply.status}: expected an fmi2Status, 0 to {PENDING}"
        elif (reply.status == DISCARD and not _may_discard(reply)) or (
            reply.status == PENDING and reply.function not in ("fmi2DoStep", "fmi2GetStatus")
        ):
            yield f"{reply.function} returned {status_name(reply.status)}, which it may not: {reply.logged}"


@rule(_STATUS, Stage.BEHAVIOUR, Level.WARNING)
def refusals_are_logged(probe: Probe) -> Iterator[str]:
    """Whatever returns warning, discard or error has called the logger, if logging is on."""
    script = probe.script(logging=True).begin().step()
    script.call("get", "Real", [unknown_reference(probe)])
    replies = script.play(keep_going=True).replies + session(probe).script.replies
    named = set()
    for reply in replies:
        quiet = (
            not reply.messages and reply.function != "fmi2SetDebugLogging"
        )  # it may have turned logging off
        if reply.status and quiet and reply.function not in named:
            named.add(reply.function)
            yield f"{reply.function} {reply.status_name} and logged nothing: expected the reason"


@rule("4.2.3 Retrieving Status Information from the Slave", Stage.BEHAVIOUR, Level.WARNING)
def unknown_statuses_are_discarded(probe: Probe) -> Iterator[str]:
    """fmi2GetXXXStatus returns ok, or discard for what it cannot retrieve; no other status."""
    pairs = []
    for kind, number in (("", 0), ("String", 1), ("Real", 2), ("Boolean", 3), ("Integer", 0)):
        for terminated in (False, True):
            script = probe.script(logging=True).begin().step()
            if terminated:
                script.terminate()
            pairs.append((script, script.call("status_of", kind, number)))
    probe.play_each([script for script, _ in pairs])
    for _, reply in pairs:
        if reply.status is not None and not reply.ok and reply.status != DISCARD:
            yield f"in the state {reply.state!r} {reply.function} {reply.status_name}: expected ok or discard"


@rule("4.2.3 Retrieving Status Information from the Slave", Stage.BEHAVIOUR, Level.WARNING)
def last_successful_time_is_right(probe: Probe) -> Iterator[str]:
    """fmi2LastSuccessfulTime, where it is given, is the end of the last step; fmi2Terminated is then
    false.
    """
    if not probe.states_step_size:
        raise NotJudgedError("no step size is stated, and an internal step may be longer than others")
    script = probe.script().begin().step(3)
    time = script.call("status_of", "Real", _LAST_SUCCESSFUL_TIME)
    other = probe.script().begin().step(3)
    terminated = other.call("status_of", "Boolean", 3)
    probe.play_each([script, other])
    expected, h = probe.point(3), probe.step_size
    if time.ok and not abs(time.value - expected) <= 1e-3 * h + 1e-9 * abs(expected):
        yield (
            f"fmi2LastSuccessfulTime is {time.value:.9g} s after a step to {expected:.9g} s: expected its end"
        )
    if terminated.ok and terminated.value:
        yield "fmi2Terminated is true after steps that succeeded: expected false"


# calls that FMI forbids to the importer: it does not say what the FMU does then


def _setting(probe: Probe, causality: str, variability: str) -> tuple[Variable, float | str] | None:
    chosen = (v for v in probe.fmu.variables if (v.causality, v.variability) == (causality, variability))
    for v in chosen:
        if (value := start_value(v)) is not None and v.base_kind != "String":
            return v, value
    return None


def _forbidden(probe: Probe) -> Iterator[tuple[Script, Reply]]:
    """Scripts, each with a call that is not allowed where it stands."""
    t, h = probe.start_time, probe.step_size

    def new() -> Script:
        return probe.script(logging=True)

    for script in (new(), new().initialise()):
        yield script, script.call("do_step", t, h)
    for script in (new(), new().begin()):
        yield script, script.plain("fmi2ExitInitializationMode")
    script = new().begin()
    yield script, script.plain("fmi2EnterInitializationMode")
    for script in (new(), new().initialise()):
        yield script, script.plain("fmi2Terminate")
    for script in (new().initialise(), new().begin().step()):
        yield script, script.call("set_up_experiment", t)
    terminated = new().begin().step()
    terminated.terminate()
    yield terminated, terminated.call("do_step", probe.point(1), h)
    script = new().begin()
    yield script, script.plain("fmi2CancelStep")
    if fixed := _setting(probe, "parameter", "fixed"):
        script = new().begin().step()
        yield script, script.set(*fixed)
    for step in (0.0, -h):
        script = new().begin().step()
        yield script, script.call("do_step", probe.point(1), step)


@rule("advice: calls that 4.2.4 and 4.2.2 forbid to importers", Stage.BEHAVIOUR, Level.WARNING)
def forbidden_calls_are_refused(probe: Probe) -> Iterator[str]:
    """A call that its state forbids, a fixed parameter set while stepping, or a step that is not above
    0 is refused.
    """
    for script, reply in _forbidden(probe):
        script.play(keep_going=True)
        if reply.ok:
            yield f"in the state {reply.state!r} {_named(reply, script)} returned ok: expected error"


def _named(reply: Reply, script: Script) -> str:
    arguments = script.calls[script.replies.index(reply)][1:]
    if reply.function == "fmi2DoStep" and reply.state == "step complete":
        return f"fmi2DoStep with the communication step size {arguments[1]:g} s"
    if reply.function.startswith("fmi2Set") and reply.state == "step complete":
        return (
            f"{reply.function} of a fixed parameter" if "Experiment" not in reply.function else reply.function
        )
    return reply.function


@rule("advice: an empty call has nothing to refuse", Stage.BEHAVIOUR, Level.WARNING)
def empty_calls_succeed(probe: Probe) -> Iterator[str]:
    """Getting or setting no variables, with NULL for both arrays, succeeds."""
    script = probe.script(logging=True).begin()
    kinds = ("Real", "Integer", "Boolean", "String")
    replies = [script.call("transfer_nothing", f"fmi2Set{kind}") for kind in kinds]
    script.step()
    replies += [script.call("transfer_nothing", f"fmi2Get{kind}") for kind in kinds]
    script.play(keep_going=True)
    failed = next((reply for reply in replies if not reply.ok), None)
    if failed:
        yield f"{failed.function} of no variables: {failed.status_name}: expected ok"
