"""Rules of the statuses that functions return."""

from collections.abc import Iterable, Iterator

from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.rules.call_table import tour
from fmus.compliance.script import Reply
from fmus.fmi.binding import DISCARD, OK, PENDING, status_name

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


@behaviour_rule("2.1.3")
def statuses_are_legal(probe: Probe) -> Iterator[str]:
    """Discard and pending come only from functions that may return them; every status is one of
    fmi2Status.
    """
    for reply in tour(probe).script.replies:
        for message in _illegal(probe, [reply]):
            probe.note_failure(reply, "statuses-are-legal")
            yield message


@behaviour_rule("2.1.3", last=True)
def refusals_have_legal_statuses(probe: Probe) -> Iterator[str]:
    """A refused call of another rule, which FMI allows and which does not end that rule, returns no status
    that its function may not return.
    """
    yield from _illegal(probe, probe.refusals)


def _refused(probe: Probe) -> list[Reply]:
    """Replies with logging that are warning, discard or error, without discarded steps: these have a rule."""
    replies = [*probe.refusals, *tour(probe).script.replies, *tour(probe).failed]
    refused = [reply for reply in replies if reply.status not in (None, OK, PENDING)]
    return [r for r in refused if not r.reason and (not r.is_step or r.status != DISCARD)]


@behaviour_rule("2.1.3", last=True)
def refusals_are_logged(probe: Probe) -> Iterator[str]:
    """Whatever returns warning, discard or error has called the logger, if logging is on."""
    named = set()
    for reply in _refused(probe):
        may_be_off = reply.function == "fmi2SetDebugLogging"
        if not reply.messages and not may_be_off and reply.function not in named:
            named.add(reply.function)
            yield f"{reply.function} {reply.status_name} and logged nothing: expected the reason"


@behaviour_rule("2.1.3", last=True)
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
