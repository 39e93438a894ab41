"""Rules of the values that a saved state holds, and of what asking an FMU for values may not change."""

from collections.abc import Iterator
from typing import Any

from fmus.compliance.accepted import accepted_together
from fmus.compliance.comparison import differing, failing_or_differing, steadily
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotJudgedError, behaviour_rule
from fmus.compliance.script import Reading, Script
from fmus.compliance.values import (
    continuous_reals,
    other_values,
    references_of,
    set_input_derivatives,
    settable_before,
    settable_while_stepping,
    start_value,
    unless_claimed,
)
from fmus.compliance.variable import Variable

_CLAUSE = "2.1.8 Getting and Setting the Complete FMU State"
_SAVES, _SERIALISES = "canGetAndSetFMUstate", "canSerializeFMUstate"
_ROUNDING = 1e-9  # relative; what is lost by writing a state as text is less
_MOST_CHANGED = 50
_STEPS = 3


def _every(script: Script, steps: int = _STEPS) -> list[Reading]:
    return [script.step().read(script.variables) for _ in range(steps)]


@behaviour_rule(
    _CLAUSE,
    condition=unless_claimed(_SAVES),
    needs="state-restores input-derivatives questions-change-nothing state-holds-inputs-and-parameters",
)
def state_holds_every_value(probe: Probe) -> Iterator[str]:
    """Set back after inputs, tunable parameters and derivatives of inputs went back to their start values, a
    state gives all variables again, at once and in the steps that follow, as if it had not been saved.
    """
    pairs = other_values(settable_while_stepping(probe.fmu)[:_MOST_CHANGED])
    pairs = accepted_together(probe, pairs, lambda: probe.script().begin().step())
    usual = _moving(probe, pairs)
    expected = _every(usual)
    script, before, after, got = _set_back(probe, pairs)
    usual.play(keep_going=True)
    if failure := script.failure or usual.failure:
        raise NotJudgedError(f"a run with other values fails: {failure.problem}")
    yield from steadily(probe, differing(before, after, "in the state that was set back", _ROUNDING))
    yield from steadily(probe, differing(expected, got, "from a state that was set back", _ROUNDING))


def _set_back(
    probe: Probe, pairs: list[tuple[Variable, Any]]
) -> tuple[Script, list[Reading], list[Reading], list[Reading]]:
    script = _moving(probe, pairs)
    before, slopes = script.read(script.variables), _slopes(probe, script)
    script.call("get_fmu_state", 0)
    set_input_derivatives(probe, script, 0.0)
    for v, _ in pairs:
        script.set(v, start_value(v))
    script.step(2)
    script.call("set_fmu_state", 0)
    after, same_slopes = script.read(script.variables), _slopes(probe, script)
    script.go_to(2)
    got = _every(script)
    script.play(keep_going=True)
    return script, [before, *slopes], [after, *same_slopes], got


def _moving(probe: Probe, pairs: list[tuple[Variable, Any]]) -> Script:
    """Returns a run of two steps with values set before the second one, and derivatives of inputs before
    that and before the next.
    """
    script = probe.script().begin().step()
    for v, x in pairs:
        script.set(v, x)
    set_input_derivatives(probe, script)
    script.step()
    set_input_derivatives(probe, script)
    return script


def _slopes(probe: Probe, script: Script) -> list[Reading]:
    """Returns the first derivatives of continuous outputs, as a reading, if they are claimed."""
    chosen = continuous_reals(probe, "output") if probe.fmu.output_derivative_order else []
    return [script.read_output_derivatives(chosen)] if chosen else []


@behaviour_rule(
    _CLAUSE,
    condition=unless_claimed(_SERIALISES),
    needs="state-holds-every-value serialised-state-restores strings-are-copied inputs-that-are-set-are-read",
)
def bytes_hold_every_value(probe: Probe) -> Iterator[str]:
    """Bytes of a state with other values, that was freed, give all variables again in an instance with start
    values; reading them changes nothing until the state is set.
    """
    content, expected = _serialised_with_other_values(probe)
    if not content:
        yield "a serialised state has no bytes"
        return
    other = probe.script().begin().step()
    untouched = other.read(other.variables)
    preparation = len(other.replies)
    other.call("deserialize_fmu_state", 0, content)
    still = other.read(other.variables)
    other.call("set_fmu_state", 0)
    got = [other.read(other.variables), *_every(other.go_to(2))]
    other.call("free_fmu_state", 0)
    other.play(keep_going=True)
    if other.failure in other.replies[:preparation]:
        raise NotJudgedError(f"a run with other values fails: {other.failure.problem}")
    if other.failure:
        yield f"from bytes in another instance: {other.failure.problem}"
    else:
        yield from differing([untouched], [still], "after fmi2DeSerializeFMUstate, before fmi2SetFMUstate")
        yield from steadily(probe, differing(expected, got, "from bytes in another instance", _ROUNDING))


def _serialised_with_other_values(probe: Probe) -> tuple[Any, list[Reading]]:
    """Returns the bytes of a state, and all variables in it and in the steps that follow."""
    script = probe.script()
    pairs = other_values(settable_before(probe.fmu)[:_MOST_CHANGED])
    for v, x in accepted_together(probe, pairs, probe.script):
        script.set(v, x)
    script.begin().step(2)
    script.call("get_fmu_state", 0)
    readings = [script.read(script.variables), *_every(script)]
    reply = script.call("serialize_fmu_state", 0)
    script.call("free_fmu_state", 0)
    script.call("get_fmu_state", 1)
    script.step()
    script.play(keep_going=True)
    if not script.succeeded:
        raise NotJudgedError("a state cannot be serialised after steps")
    return reply.value[0], readings


@behaviour_rule(
    _CLAUSE,
    condition=unless_claimed(_SAVES),
    needs="state-restores state-holds-the-mode reset-in-every-state",
)
def state_can_be_set_after_reset(probe: Probe) -> Iterator[str]:
    """A state that was saved before fmi2Reset can be set after it, and the steps that follow are the same."""
    script = probe.script(logging=True).begin().step(2)
    script.call("get_fmu_state", 0)
    expected = script.run(_STEPS)
    script.reset()
    script.call("set_fmu_state", 0)
    got = script.go_to(2).run(_STEPS)
    script.play(keep_going=True)
    when, failing = "from a state from before fmi2Reset", "with a state from before fmi2Reset"
    yield from failing_or_differing(script, expected, got, when, _ROUNDING, failing)


@behaviour_rule(
    "4.2.2 Computation (fmi2DoStep)",
    condition=unless_claimed(_SAVES),
    needs="state-restores no-set-state-flag-changes-nothing",
)
def flag_keeps_the_states_of_the_present(probe: Probe) -> Iterator[str]:
    """After a step with noSetFMUStatePriorToCurrentPoint, a state of its beginning can be set."""
    script = probe.script(logging=True).begin().step(2)
    script.call("get_fmu_state", 0)
    script.step(no_going_back=True)
    script.call("set_fmu_state", 0)
    script.go_to(2).step()
    script.play(keep_going=True)
    if script.failure:
        yield f"after noSetFMUStatePriorToCurrentPoint: {script.failure.problem}"


@behaviour_rule("2.1.7 Getting and Setting Variable Values", needs="allowed-calls-succeed")
def questions_change_nothing(probe: Probe) -> Iterator[str]:
    """Reading values and derivatives, or saving a state, changes nothing in the steps that follow."""
    usual, asked = probe.script().begin(), probe.script().begin()
    expected: list[Reading] = []
    got: list[Reading] = []
    for _ in range(4):
        set_input_derivatives(probe, usual)
        set_input_derivatives(probe, asked)
        _save(probe, asked)
        asked.step()
        asked.read(asked.variables)
        _ask(probe, asked)
        got.append(asked.read(asked.variables))
        expected += _every(usual, 1)
    probe.play_each([usual, asked])
    if usual.succeeded and asked.succeeded:
        when = "where values and derivatives are read more often"
        yield from steadily(probe, differing(expected, got, when, _ROUNDING))


def _ask(probe: Probe, script: Script) -> None:
    """Questions that the FMU answers."""
    outputs, inputs = (references_of(continuous_reals(probe, c)) for c in ("output", "input"))
    if outputs and probe.fmu.output_derivative_order:
        script.call("output_derivatives", outputs, 1)
    if outputs and inputs and probe.fmu.claims("providesDirectionalDerivative"):
        script.call("directional_derivatives", outputs, inputs, [1.0] * len(inputs))
    _save(probe, script)


def _save(probe: Probe, script: Script) -> None:
    if probe.fmu.claims(_SAVES):
        script.call("get_fmu_state", 0)
        script.call("free_fmu_state", 0)
