"""Behaviour of saved states: FMI 2.0.5, 2.1.8, as far as the FMU claims it."""

from collections.abc import Iterator

from fmus.compliance.accepted import accepted_together
from fmus.compliance.comparison import differing, failing_or_differing
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.rules.instance import unknown_reference
from fmus.compliance.script import Reading
from fmus.compliance.values import (
    other_values,
    readable_in_initialization,
    settable_in_initialization,
    settable_while_stepping,
    unless_claimed,
)
from fmus.fmi.binding import ERROR

_CLAUSE = "2.1.8 Getting and Setting the Complete FMU State"
_SAVES, _SERIALISES = "canGetAndSetFMUstate", "canSerializeFMUstate"
_STEPS = 5
_ROUNDING = 1e-9  # relative; what is lost by writing a state as text is less
_MOST_CHANGED = 50

_saves = unless_claimed(_SAVES)


def _restored(probe: Probe) -> tuple[list[Reading], list[Reading]]:
    """Outputs at a saved state and after it, before and after it is set back."""
    script = probe.script(logging=True).begin().step(2)
    script.call("get_fmu_state", 0)
    before = [script.read(probe.outputs), *script.run(_STEPS)]
    script.call("set_fmu_state", 0)
    script.go_to(2)
    after = [script.read(probe.outputs), *script.run(_STEPS)]
    script.play()
    return before, after


@behaviour_rule(_CLAUSE, condition=_saves, needs="communication-points-may-be-rounded allowed-calls-succeed")
def state_restores(probe: Probe) -> Iterator[str]:
    """A state that is set back gives the same outputs at once and in the steps that follow, up to
    rounding.
    """
    before, after = probe.once("saved state", lambda: _restored(probe))
    yield from differing(before[:1], after[:1], "in the state that was set back", _ROUNDING)
    yield from differing(before[1:], after[1:], "from the state that was set back", _ROUNDING)


@behaviour_rule(_CLAUSE, condition=_saves, needs="state-restores")
def state_restores_exactly(probe: Probe) -> Iterator[str]:
    """A state that is set back gives exactly the same outputs."""
    before, after = probe.once("saved state", lambda: _restored(probe))
    yield from differing(before, after, "from the state that was set back")


@behaviour_rule(_CLAUSE, condition=_saves, needs="state-restores")
def state_holds_inputs_and_parameters(probe: Probe) -> Iterator[str]:
    """A state holds inputs and tunable parameters too: changed after it was saved, they are back when
    it is set.
    """
    usual = probe.script().begin().step(2)
    expected = usual.run(_STEPS)
    chosen = settable_while_stepping(probe.fmu)
    pairs = other_values(chosen[:_MOST_CHANGED])
    pairs = accepted_together(probe, pairs, lambda: probe.script().begin().step(2))
    script = probe.script().begin().step(2)
    script.call("get_fmu_state", 0)
    for v, x in pairs:
        script.set(v, x)
    script.step()
    script.call("set_fmu_state", 0)
    values = script.read(chosen)
    script.go_to(2)
    got = script.run(_STEPS)
    reference = probe.script().begin().step(2)
    values_before = reference.read(chosen)
    probe.play_each([usual, script, reference])
    if not pairs:
        raise NotJudgedError("no input or tunable parameter takes another value")
    if script.failure:
        raise NotJudgedError(f"a run with other values fails: {script.failure.problem}")
    yield from differing([values_before], [values], "in the state that was set back", _ROUNDING)
    yield from differing(expected, got, "from a state that was set back after inputs changed", _ROUNDING)


@behaviour_rule(
    _CLAUSE, condition=_saves, needs="state-can-be-saved-often allowed-calls-succeed questions-change-nothing"
)
def state_in_initialization_mode(probe: Probe) -> Iterator[str]:
    """A state can be saved and set back when instantiated and in initialization mode, with what was set
    there.
    """
    chosen = other_values(settable_in_initialization(probe.fmu))[:1]
    readable = readable_in_initialization(probe.fmu)
    script = probe.script(logging=True)
    script.call("get_fmu_state", 0)
    script.call("set_fmu_state", 0)
    script.initialise()
    before = script.read(readable)
    script.call("get_fmu_state", 1)
    changes = [script.set(v, value) for v, value in chosen]
    script.call("set_fmu_state", 1)
    after = script.read(readable)
    got = script.exit_initialization_mode().run(2)
    usual = probe.script().begin()
    expected = usual.run(2)
    usual.play()
    script.play(keep_going=True)
    if script.failure and script.failure not in changes:
        yield f"in the state {script.failure.state!r}: {script.failure.problem}"
    elif not script.failure:
        state = "the state of initialization mode that was set back"
        yield from differing([before], [after], f"in {state}", _ROUNDING)
        yield from differing(expected, got, f"from {state}", _ROUNDING)


@behaviour_rule(_CLAUSE, condition=_saves, needs="state-restores allowed-calls-succeed")
def state_holds_the_mode(probe: Probe) -> Iterator[str]:
    """A state holds internal status information: set back while stepping, one of initialization mode is
    in that mode.
    """
    script = probe.script(logging=True).initialise()
    script.call("get_fmu_state", 0)
    first = script.exit_initialization_mode().run(3)
    script.call("set_fmu_state", 0)
    script.state = "initialization mode"
    again = script.exit_initialization_mode().go_to(0).run(3)
    script.play(keep_going=True)
    when, failing = "from a state of initialization mode", "after a state of initialization mode was set back"
    yield from failing_or_differing(script, first, again, when, _ROUNDING, failing)


@behaviour_rule(
    _CLAUSE,
    condition=_saves,
    needs="state-restores allowed-calls-succeed state-holds-the-mode step-beyond-the-stop-time-is-an-error",
)
def state_restores_after_the_end(probe: Probe) -> Iterator[str]:
    """A state can be set back after fmi2Terminate and after an error, and steps go on from it, up to the stop
    time.
    """
    ends = ("fmi2Terminate", "an error of fmi2GetReal", "a step beyond the stop time")
    for end in ends:
        script = probe.script(logging=True).set_up(stop=probe.point(4))
        script.enter_initialization_mode().exit_initialization_mode().step(2)
        script.call("get_fmu_state", 0)
        expected = script.run(2)
        last = (
            script.terminate() if end == ends[0]
            else script.call("get", "Real", [unknown_reference(probe)]) if end == ends[1]
            else script.call("do_step", probe.point(4), probe.step_size)
        )  # fmt: skip
        script.call("set_fmu_state", 0)
        script.go_to(2)
        got = script.run(2)
        calls = list(script.replies)
        beyond = script.call("do_step", probe.point(4), probe.step_size)
        script.play(keep_going=True)
        if last.status != ERROR and end != ends[0]:
            continue
        replies = [reply for reply in calls if reply.status is not None and reply is not last]
        failure = next((reply for reply in replies if not reply.ok), None)
        if failure:
            yield f"after {end}: {failure.problem}"
            return
        yield from differing(expected, got, f"from a state set back after {end}", _ROUNDING)
        if beyond.status != ERROR:
            yield (
                f"from a state set back after {end}: fmi2DoStep to {probe.point(5):g} s "
                f"{beyond.status_name}: expected error beyond the stop time {probe.point(4):g} s"
            )
            return


@behaviour_rule(_CLAUSE, condition=_saves, needs="state-restores")
def state_can_be_saved_often(probe: Probe) -> Iterator[str]:
    """Several states are kept at a time, each its own; one that is given again is written over."""
    script = probe.script(logging=True).begin()

    def from_state(slot: int) -> list[Reading]:
        script.call("set_fmu_state", slot)
        return script.go_to(0).run(3)

    script.call("get_fmu_state", 0)
    first = script.run(3)
    script.call("get_fmu_state", 1)
    older = from_state(0)
    script.call("set_fmu_state", 0)
    script.call("get_fmu_state", 1)
    again = script.go_to(0).run(3)
    over = from_state(1)
    script.call("free_fmu_state", 0)
    left = from_state(1)
    script.call("free_fmu_state", 1)
    script.play()
    yield from differing(first, older, "from the older of two states", _ROUNDING)
    yield from differing(first, again, "after a state was written over", _ROUNDING)
    yield from differing(first, over, "from the state that was written over", _ROUNDING)
    yield from differing(first, left, "after another state was freed", _ROUNDING)


@behaviour_rule(_CLAUSE, condition=_saves, needs="state-restores")
def freed_state_is_null(probe: Probe) -> Iterator[str]:
    """fmi2FreeFMUstate returns NULL in its argument."""
    script = probe.script(logging=True).begin().step()
    script.call("get_fmu_state", 0)
    forgotten = script.call("free_fmu_state", 0)
    script.play()
    if not forgotten.value:
        yield "fmi2FreeFMUstate left the state's address: expected NULL"


@behaviour_rule(_CLAUSE, condition=_saves, needs="state-restores")
def free_of_null_state_is_ignored(probe: Probe) -> Iterator[str]:
    """fmi2FreeFMUstate of a NULL state does nothing."""
    script = probe.script(logging=True).begin().step()
    script.call("free_fmu_state", 7)
    script.step()
    script.play(keep_going=True)
    if script.failure:
        yield f"with a state that is NULL: {script.failure.problem}"


@behaviour_rule(_CLAUSE, condition=unless_claimed(_SERIALISES), needs="state-restores allowed-calls-succeed")
def serialised_state_restores(probe: Probe) -> Iterator[str]:
    """A state as bytes gives the same outputs in an instance of its own."""
    script = probe.script(logging=True).begin().step(2)
    script.call("get_fmu_state", 0)
    size, again = script.call("serialized_fmu_state_size", 0), script.call("serialized_fmu_state_size", 0)
    content = script.call("serialize_fmu_state", 0)
    expected = script.run(_STEPS)
    script.play()
    if size.value != again.value:
        yield f"fmi2SerializedFMUstateSize is {size.value} and then {again.value}: expected the same size"
    if not content.value[1]:
        yield f"fmi2SerializeFMUstate writes more than the {size.value} bytes of its size"
    other = probe.script(logging=True).begin().step()
    other.call("deserialize_fmu_state", 0, content.value[0])
    other.call("set_fmu_state", 0)
    other.go_to(2)
    got = other.run(_STEPS)
    other.call("free_fmu_state", 0)
    other.play()
    yield from differing(expected, got, "from a state read from bytes", _ROUNDING)
