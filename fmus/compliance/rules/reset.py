"""Start values, and fmi2Reset, which gives them back."""

import math
from collections.abc import Callable, Iterator
from functools import partial

from fmus.compliance.comparison import differing, texts
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.script import CallError, Reading, Script
from fmus.compliance.values import (
    keeps_its_value,
    other_values,
    readable_in_initialization,
    set_input_derivatives,
    settable_before,
    settable_while_stepping,
    start_value,
)
from fmus.compliance.variable import Variable

_INITIALIZATION = "2.1.6 Initialization, Termination, and Resetting an FMU"
_ROUNDED = 1e-6  # relative: tools write start values with as few as seven digits
_STEPS = 5
_MOST_CHANGED = 50  # variables


@behaviour_rule("2.1.7 Getting and Setting Variable Values")
def start_values_are_as_declared(probe: Probe) -> Iterator[str]:
    """Variables with initial exact and inputs have their start values: in initialization mode, or after it
    where only then they can be read.
    """
    yield from _not_at_start(probe, lambda: probe.script().initialise(), "at first")


def _with_start(probe: Probe) -> list[Variable]:
    chosen = (
        v
        for v in probe.fmu.variables
        if v.variability != "constant" and (v.initial == "exact" or v.causality == "input")
    )
    return [v for v in chosen if start_value(v) is not None]


def _not_at_start(
    probe: Probe, initialise: Callable[[], Script], when: str, keep_going: bool = False
) -> Iterator[str]:
    """Yields messages of values that are not the start values.

    initialise: a new script, up to initialization mode; keep_going: whether its calls may fail
    """
    script = initialise()
    at_first = script.read(v for v in _with_start(probe) if v in readable_in_initialization(probe.fmu))
    script.play(keep_going=True)
    script = initialise().exit_initialization_mode()
    later = script.read(v for v in _with_start(probe) if keeps_its_value(v))
    script.play(keep_going=keep_going)
    for reading in (at_first, later):
        if reading.ok:
            yield from _other_values(probe, reading, when)


def _other_values(probe: Probe, reading: Reading, when: str) -> Iterator[str]:
    variables = {v.name: v for v in probe.fmu.variables}
    for name, got in reading.values.items():
        expected = start_value(variables[name])
        if isinstance(got, bytes):
            if got.decode("utf-8", "replace") != expected:
                yield (
                    f"{name} is {got.decode('utf-8', 'replace')!r} {when}: expected its start "
                    f"value {expected!r}"
                )
        elif got is None or not math.isclose(got, expected, rel_tol=_ROUNDED, abs_tol=1e-300):
            shown = texts(got, expected)
            yield f"{name} is {shown[0]} {when}: expected its start value {shown[1]}"


@behaviour_rule("4.2.4 State Machine of Calling Sequence from Master to Slave")
def reset_in_every_state(probe: Probe) -> Iterator[str]:
    """fmi2Reset is allowed when instantiated, in initialization mode, while stepping and after
    fmi2Terminate.
    """
    for state in range(4):
        script = probe.script(logging=True)
        if state == 1:
            script.initialise()
        elif state > 1:
            script.begin().step()
        if state == 3:
            script.terminate()
        name = script.state
        script.reset()
        script.begin().step()
        try:
            script.play()
        except CallError as error:
            if script.failure is None:  # no instance
                raise
            yield f"after fmi2Reset in the state {name!r}: {error}"


@behaviour_rule(_INITIALIZATION, needs="start-values-are-as-declared reset-in-every-state")
def reset_gives_the_start_values(probe: Probe) -> Iterator[str]:
    """After other values, steps and fmi2Reset, start values are back and the same steps give the same
    outputs.
    """
    script = probe.script(logging=True).begin()
    first = script.run(_STEPS)
    script.reset()
    script.begin()
    again = script.run(_STEPS)
    script.play()
    yield from differing(first, again, "after fmi2Reset", probe.tolerance)
    initialise = partial(_reset_after_other_values, probe)
    yield from _not_at_start(probe, initialise, "after other values and fmi2Reset", keep_going=True)


def _reset_after_other_values(probe: Probe) -> Script:
    """Returns a script that sets other values, resets and enters initialization mode."""
    script = probe.script(logging=True)
    _set_others(script, settable_before(probe.fmu))
    script.reset()
    return script.initialise()


@behaviour_rule(_INITIALIZATION, needs="reset-gives-the-start-values")
def reset_ends_all_that_was_set(probe: Probe) -> Iterator[str]:
    """After other values, a stop time, changed inputs and fmi2Reset, every variable is in the same steps as
    in a new instance.
    """
    one, other, used = probe.script().begin(), probe.script().begin(), probe.script(logging=True)
    expected, again = _every_value(one), _every_value(other)
    _set_others(used, settable_before(probe.fmu))
    used.set_up(stop=probe.point(2)).enter_initialization_mode().exit_initialization_mode()
    _set_others(used, settable_while_stepping(probe.fmu))
    used.step()
    set_input_derivatives(probe, used)
    end = used.reset()
    got = _every_value(used.begin())
    probe.play_each([one, other, used])
    later = used.replies[used.replies.index(end) + 1 :]
    failure = next((reply for reply in later if reply.status is not None and not reply.ok), None)
    if not one.succeeded or not other.succeeded:
        raise NotJudgedError("a run of a new instance fails")
    if failure:
        yield f"after other values, a stop time and fmi2Reset: {failure.problem}"
    elif end.ok:
        names = {m.split(" is ", 1)[0] for m in differing(expected, again, "")}
        messages = differing(expected, got, "after other values and fmi2Reset", probe.tolerance)
        yield from (m for m in messages if m.split(" is ", 1)[0] not in names)


def _every_value(script: Script) -> list[Reading]:
    return [script.step().read(script.variables) for _ in range(_STEPS)]


def _set_others(script: Script, variables: list[Variable]) -> None:
    for v, x in other_values(variables[:_MOST_CHANGED]):
        script.set(v, x)
