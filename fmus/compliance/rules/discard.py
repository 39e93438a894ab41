"""Steps that the FMU discards: how far they came, and which calls the state after them allows."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from fmus.compliance.fmu_file import CO_SIMULATION
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.script import Reply, Script
from fmus.compliance.values import unless_claimed
from fmus.fmi.binding import DISCARD, LAST_SUCCESSFUL_TIME, TERMINATED

_MANY_STEPS = 16


@dataclass(frozen=True)
class _DiscardedStep:
    """step: its reply; number: how many steps succeed before it; time, terminated: what is said of it."""

    step: Reply
    number: int
    time: Reply
    terminated: Reply


def _discarded(probe: Probe) -> _DiscardedStep:
    """Returns the first of equal steps that the FMU discards, or raises NotApplicableError."""
    discarded = probe.once("discarded step of a run", lambda: _first_discarded(probe))
    if discarded is None:
        raise NotApplicableError("no step is discarded")
    return discarded


def _first_discarded(probe: Probe) -> _DiscardedStep | None:
    script = probe.script(logging=True).begin().step(_MANY_STEPS)
    time = script.call("status_of", "Real", LAST_SUCCESSFUL_TIME)
    terminated = script.call("status_of", "Boolean", TERMINATED)
    with suppress(NotJudgedError):  # that a step is discarded
        script.play(keep_going=True)
    steps = [reply for reply in script.replies if reply.function == "fmi2DoStep" and reply.status is not None]
    if not steps or steps[-1].status != DISCARD:
        return None
    return _DiscardedStep(steps[-1], len(steps) - 1, time, terminated)


@behaviour_rule("4.2.2 Computation (fmi2DoStep)", interface=CO_SIMULATION)
def discarded_steps_have_a_last_time(probe: Probe) -> Iterator[str]:
    """After a discarded step, fmi2LastSuccessfulTime, if given, lies in that step, before its end, and
    fmi2Terminated is a Boolean.
    """
    discarded = _discarded(probe)
    time, terminated = discarded.time, discarded.terminated
    start, end = probe.point(discarded.number), probe.point(discarded.number + 1)
    rounding = 1e-9 * max(abs(start), abs(end), probe.step_size)
    step = f"a step from {start:g} to {end:g} s"
    for reply in (time, terminated):
        if reply.status is not None and not reply.ok and reply.status != DISCARD:
            yield f"after a discarded step {reply.function} {reply.status_name}: expected ok or discard"
    if time.ok and not start - rounding <= time.value < end - rounding:
        yield f"{step} is discarded, and fmi2LastSuccessfulTime is {time.value:g} s"
    if terminated.ok and terminated.value not in (0, 1):
        yield f"after a discarded step fmi2Terminated is {terminated.value}: expected 0 or 1, a Boolean"
    if not discarded.step.messages:
        yield f"{step} was discarded and nothing was logged: expected the reason"


@behaviour_rule(
    "4.2.4 State Machine of Calling Sequence from Master to Slave",
    needs="reset-in-every-state variables-can-be-read",
    interface=CO_SIMULATION,
)
def discarded_steps_can_be_left(probe: Probe) -> Iterator[str]:
    """After a step was discarded variables can be read, and fmi2Terminate, fmi2Reset and, if it is
    supported, fmi2SetFMUstate succeed.
    """
    count = _discarded(probe).number + 1
    terminated, reset, restored = (probe.script(logging=True).begin() for _ in range(3))
    terminated.step(count).read(probe.fmu.variables)
    terminated.call("end")
    reset.step(count).reset()
    scripts = [terminated, reset.begin()]
    if not unless_claimed("canGetAndSetFMUstate")(probe.fmu):
        restored.call("get_fmu_state", 0)
        restored.step(count).call("set_fmu_state", 0)
        scripts.append(restored)
    with suppress(NotJudgedError):  # that a step is discarded
        probe.play_each(scripts)
    for script in scripts:
        if failure := _failure_after_the_discard(script):
            yield f"after a discarded step: {failure.problem}"


def _failure_after_the_discard(script: Script) -> Reply | None:
    """Returns the first reply after the discarded step that is not ok, if there is one."""
    replies = [reply for reply in script.replies if reply.status is not None]
    ends = [i for i, r in enumerate(replies) if r.function == "fmi2DoStep" and r.status == DISCARD]
    return next((r for r in replies[ends[0] + 1 :] if not r.ok), None) if ends else None
