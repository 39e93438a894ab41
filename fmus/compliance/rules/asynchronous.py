"""Steps that are pending: their end and their status."""

from collections.abc import Iterator

from fmus.compliance.fmu_file import CO_SIMULATION
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.values import differing, if_not_claimed, is_utf_8, unless_claimed
from fmus.fmi.binding import OK, WARNING, status_name

_ASYNCHRONOUS = "canRunAsynchronuously"
_PENDING_STATUS = 1  # fmi2StatusKind


@behaviour_rule("4.2.2", condition=if_not_claimed(_ASYNCHRONOUS), interface=CO_SIMULATION)
def steps_are_not_pending(probe: Probe) -> Iterator[str]:
    """Without canRunAsynchronuously, fmi2DoStep does not return pending."""
    script = probe.script(logging=True).begin()
    pending = script.call("begin_step", probe.start_time, probe.step_size)
    script.play(keep_going=True)
    if pending.value:
        yield "fmi2DoStep returned pending: expected that only with canRunAsynchronuously"


@behaviour_rule("2.1.5", condition=unless_claimed(_ASYNCHRONOUS))
def step_finished_is_called(probe: Probe) -> Iterator[str]:
    """After a pending step, perhaps also after others, the callback stepFinished is called once; without it
    fmi2GetStatus tells the step's end.
    """
    count = 3
    script = probe.script(logging=True).begin().step(count)
    steps = script.call("finished_steps")
    script.play(keep_going=True)
    pending, calls = steps.value or (0, [])
    finished = len(calls)
    if script.failure:
        yield script.failure.problem
    elif not pending <= finished <= count:  # a step that is not pending is completed too
        yield (
            f"stepFinished was called {finished} times for {pending} pending steps of {count}: "
            "expected once for each"
        )
    if not all(right_environment for _, right_environment in calls):
        yield "stepFinished was called without the componentEnvironment of its instance"
    if not script.failure and any(status not in (OK, WARNING) for status, _ in calls):
        statuses = ", ".join(sorted({status_name(status) for status, _ in calls}))
        yield f"stepFinished was called with the status {statuses} for steps that succeed: expected theirs"
    fewest = probe.script(callbacks="fewest").begin().step(3)
    fewest.play(keep_going=True)
    if fewest.failure:
        yield f"without stepFinished: {fewest.failure.problem}"


@behaviour_rule("4.2.3", condition=unless_claimed(_ASYNCHRONOUS))
def status_of_a_pending_step_is_given(probe: Probe) -> Iterator[str]:
    """While a step is pending, fmi2GetStatus returns ok and gives pending, or the status of the step that has
    ended; a text of fmi2PendingStatus is UTF-8.
    """
    script = probe.script(logging=True).begin()
    pending = script.call("begin_step", probe.start_time, probe.step_size)
    text = script.call("status_of", "String", _PENDING_STATUS)
    polled = script.call("poll_step")
    time = script.read([v for v in probe.fmu.variables if v.causality == "independent"])
    outputs = script.read(probe.outputs)
    usual = probe.script().begin()
    expected = usual.run(1)
    usual.play()
    script.play(keep_going=True)
    if not pending.value:
        raise NotJudgedError("the step was not pending")
    if text.ok and (text.value is None or not is_utf_8(bytes.fromhex(text.value))):
        shown = "NULL" if text.value is None else bytes.fromhex(text.value)
        yield f"fmi2GetStringStatus of fmi2PendingStatus is {shown!r}: expected a text in UTF-8"
    if polled.status is None:
        return
    answer, step = polled.value[-1]
    if answer:
        yield f"fmi2GetStatus of a pending step returned {status_name(answer)}: expected ok and its status"
    elif step not in (OK, WARNING):
        yield f"fmi2GetStatus gives {status_name(step)} for a step that succeeds: expected ok"
    elif outputs.ok and time.ok:
        yield from differing(expected, [outputs], "after a step that has ended by fmi2GetStatus")
