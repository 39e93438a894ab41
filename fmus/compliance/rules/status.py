"""Rules of the statuses that functions return, and of what fmi2GetXXXStatus gives."""

from collections.abc import Iterable, Iterator

from fmus.compliance.fmu_file import CO_SIMULATION
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.rules.session import session
from fmus.compliance.script import Reply
from fmus.fmi.binding import DISCARD, LAST_SUCCESSFUL_TIME, OK, PENDING, TERMINATED, status_name

_STATUS = "2.1.3 Status Returned by Functions"
_STATUS_KINDS = ("fmi2DoStepStatus", "fmi2PendingStatus", "fmi2LastSuccessfulTime", "fmi2Terminated")
_NO_STATUS = {
    "": (1, 2, 3),
    "Real": (0, 1, 3),
    "Integer": (0, 1, 2, 3),
    "Boolean": (0, 1, 2),
    "String": (0, 2, 3),
}


_SETTERS = ("fmi2SetReal", "fmi2SetInteger", "fmi2SetBoolean", "fmi2SetString")
_OF_STATES = ("fmi2SetContinuousStates", "fmi2GetDerivatives", "fmi2GetEventIndicators", "fmi2GetReal")


def _may_discard(probe: Probe, function: str) -> bool:
    if probe.fmu.is_model_exchange and function in _OF_STATES:
        return True
    return function in (*_SETTERS, "fmi2DoStep") or function.endswith("Status")


def _illegal(probe: Probe, replies: Iterable[Reply]) -> Iterator[str]:
    for reply in replies:
        if reply.status is None or reply.reason:
            continue
        if not 0 <= reply.status <= PENDING:
            yield f"{reply.function} returned {reply.status}: expected an fmi2Status, 0 to {PENDING}"
        elif (reply.status == DISCARD and not _may_discard(probe, reply.function)) or (
            reply.status == PENDING and reply.function not in ("fmi2DoStep", "fmi2GetStatus")
        ):
            yield f"{reply.function} returned {status_name(reply.status)}, which it may not: {reply.logged}"


@behaviour_rule(_STATUS)
def statuses_are_legal(probe: Probe) -> Iterator[str]:
    """Discard and pending come only from functions that may return them; every status is one of
    fmi2Status.
    """
    yield from _illegal(probe, session(probe).script.replies)


@behaviour_rule(
    _STATUS,
    needs="statuses-are-legal wrong-references-are-refused discarded-steps-can-be-left "
    "free-of-null-state-is-ignored",
    last=True,
)
def refusals_have_legal_statuses(probe: Probe) -> Iterator[str]:
    """A refused call of another rule, which FMI allows and which does not end that rule, returns no status
    that its function may not return.
    """
    yield from _illegal(probe, probe.refusals)


def _refused(probe: Probe) -> list[Reply]:
    """Replies with logging that are warning, discard or error, without discarded steps: these have a rule."""
    replies = [*probe.refusals, *session(probe).script.replies]
    refused = [reply for reply in replies if reply.status not in (None, OK, PENDING)]
    return [r for r in refused if not r.reason and (not r.is_step or r.status != DISCARD)]


@behaviour_rule(_STATUS, last=True)
def refusals_are_logged(probe: Probe) -> Iterator[str]:
    """Whatever returns warning, discard or error has called the logger, if logging is on."""
    named = set()
    for reply in _refused(probe):
        may_be_off = reply.function == "fmi2SetDebugLogging"
        if not reply.messages and not may_be_off and reply.function not in named:
            named.add(reply.function)
            yield f"{reply.function} {reply.status_name} and logged nothing: expected the reason"


@behaviour_rule(_STATUS, last=True)
def messages_of_refusals_are_no_information(probe: Probe) -> Iterator[str]:
    """The messages of what returns warning, discard or error do not have the status ok alone, which is that
    of pure information.
    """
    for reply in _refused(probe):
        if reply.messages and all(m.status == OK for m in reply.messages):
            yield (
                f"{reply.function} {reply.status_name} and logged {reply.logged[:60]!r} with the status ok: "
                f"expected {status_name(reply.status or 0)}"
            )
            return


@behaviour_rule(
    "4.2.3 Retrieving Status Information from the Slave",
    needs="discarded-steps-have-a-last-time",
    interface=CO_SIMULATION,
)
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


@behaviour_rule("4.2.3 Retrieving Status Information from the Slave", interface=CO_SIMULATION)
def last_successful_time_is_right(probe: Probe) -> Iterator[str]:
    """fmi2LastSuccessfulTime, where it is given, is the end of the last step; fmi2Terminated is then
    false.
    """
    if not probe.states_step_size:
        raise NotJudgedError("no step size is stated, and an internal step may be longer than others")
    script = probe.script().begin().step(3)
    time = script.call("status_of", "Real", LAST_SUCCESSFUL_TIME)
    other = probe.script().begin().step(3)
    terminated = other.call("status_of", "Boolean", TERMINATED)
    probe.play_each([script, other])
    expected, h = probe.point(3), probe.step_size
    if time.ok and not abs(time.value - expected) <= 1e-3 * h + 1e-9 * abs(expected):
        yield (
            f"fmi2LastSuccessfulTime is {time.value:.9g} s after a step to {expected:.9g} s: expected its end"
        )
    if terminated.ok and terminated.value:
        yield "fmi2Terminated is true after steps that succeeded: expected false"


@behaviour_rule("4.2.3 Retrieving Status Information from the Slave", interface=CO_SIMULATION)
def statuses_have_their_types(probe: Probe) -> Iterator[str]:
    """A status is given by the function of its type alone: another function returns discard."""
    pairs = []
    for kind, numbers in _NO_STATUS.items():
        for number in numbers:
            script = probe.script(logging=True).begin().step()
            pairs.append((number, script, script.call("status_of", kind, number)))
    probe.play_each([script for _, script, _ in pairs])
    for number, _, reply in pairs:
        if reply.ok:
            kind = _STATUS_KINDS[number]
            yield f"{reply.function} of {kind}, which has another type, returned ok: expected discard"
