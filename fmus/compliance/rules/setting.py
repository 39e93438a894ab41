"""Rules of setting variables: which, when, and what is read then."""

from collections.abc import Iterator, Sequence
from typing import Any

from fmus.compliance.comparison import RESTARTED, differing, failing_or_differing, same, texts, unlike
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.rules.instance import unknown_reference
from fmus.compliance.script import KINDS, Reading, Script
from fmus.compliance.values import (
    far_values,
    keeps_its_value,
    other_values,
    readable_in_initialization,
    settable_before,
    settable_in_initialization,
    settable_while_stepping,
    start_value,
    values_out_of_range,
)
from fmus.compliance.variable import Variable
from fmus.fmi.binding import ERROR, OK

_PLATFORM = "2.1.2 Platform Dependent Definitions (fmi2TypesPlatform.h)"
_INITIALIZATION = "2.1.6 Initialization, Termination, and Resetting an FMU"
_VALUES = "2.1.7 Getting and Setting Variable Values"
_MOST_VARIABLES = 50  # of one kind, each of which costs an instance
_ROUNDED = 1e-6
_EXACT = 1e-12
_Setting = tuple[Variable, Any, Script, Reading]  # a variable, its value, the script that sets it, a reading


@behaviour_rule(_INITIALIZATION, needs="start-values-are-as-declared strings-are-copied")
def values_that_are_set_are_read(probe: Probe) -> Iterator[str]:
    """Values that are set when instantiated or in initialization mode are read afterwards."""
    before = [v for v in settable_before(probe.fmu) if v.initial == "exact"]
    yield from _not_as_set(probe, before, "when instantiated")
    yield from _not_as_set(probe, settable_in_initialization(probe.fmu), "in initialization mode")


def _not_as_set(probe: Probe, variables: Sequence[Variable], when: str) -> Iterator[str]:
    settings, readable = list[_Setting](), readable_in_initialization(probe.fmu)
    for v, value in other_values(variables[:_MOST_VARIABLES]):
        script = probe.script()
        if when == "when instantiated":
            script.set(v, value)
            script.initialise()
        else:
            script.initialise().set(v, value)
        if v in readable:
            reading = script.read([v])
            script.exit_initialization_mode()
        elif keeps_its_value(v):
            reading = script.exit_initialization_mode().read([v])
        else:
            continue
        settings.append((v, value, script, reading))
    for v, got, given in _read_otherwise(probe, settings):
        yield f"{v.name} is {got} after it was set to {given} {when}: expected that"


def _read_otherwise(probe: Probe, settings: Sequence[_Setting]) -> Iterator[tuple[Variable, str, str]]:
    """Variables that are not read as they were set, where the script succeeded, with both values as texts."""
    probe.play_each([script for _, _, script, _ in settings])
    return unlike(((v, x, reading) for v, x, script, reading in settings if script.succeeded), _EXACT)


@behaviour_rule(_PLATFORM)
def wrong_references_are_refused(probe: Probe) -> Iterator[str]:
    """A value reference that no variable has is an error to read and to set, and so is a constant to set."""
    reference = unknown_reference(probe)
    values = {"Real": 0.0, "Integer": 0, "Boolean": 0, "String": ""}
    for kind in KINDS:
        getter = probe.script(logging=True).begin().step()
        setter = probe.script(logging=True).initialise()
        for script, reply in (
            (getter, getter.call("get", kind, [reference])),
            (setter, setter.call("set", kind, [reference], [values[kind]])),
        ):
            script.play(keep_going=True)
            if reply.status != ERROR:
                yield (
                    f"{reply.function} of the value reference {reference}, which is none: "
                    f"{reply.status_name}: expected error"
                )


@behaviour_rule(_PLATFORM)
def constants_cannot_be_set(probe: Probe) -> Iterator[str]:
    """Setting a constant is an error."""
    for v in [v for v in probe.fmu.variables if v.variability == "constant"][:_MOST_VARIABLES]:
        if (value := start_value(v)) is not None:
            script = probe.script(logging=True).initialise()
            reply = script.set(v, value)
            script.play(keep_going=True)
            if reply.status != ERROR:
                yield f"{reply.function} of the constant {v.name}: {reply.status_name}: expected error"


@behaviour_rule("advice: 4.2.4 allows to set no other variables")
def calculated_values_cannot_be_set(probe: Probe) -> Iterator[str]:
    """Setting a variable that is calculated is refused, unless it is the alias of one that can be set."""
    settable = {(v.base_kind, v.reference) for v in probe.fmu.variables if v.is_settable}
    calculated = [v for v in probe.fmu.variables if v.initial == "calculated" or v.causality == "independent"]
    chosen = [v for v in calculated if (v.base_kind, v.reference) not in settable]
    for v in chosen[:_MOST_VARIABLES]:
        if v.base_kind in ("Real", "Integer", "Boolean"):
            script = probe.script(logging=True).initialise()
            reply = script.set(v, 0 if v.base_kind != "Real" else 0.0)
            script.play(keep_going=True)
            if reply.ok:
                yield f"{reply.function} of {v.name}, which is calculated, returned ok: expected error"
                return


@behaviour_rule(_PLATFORM, needs="allowed-calls-succeed")
def strings_are_copied(probe: Probe) -> Iterator[str]:
    """A String that is set is copied: it is read as it was although its memory was overwritten."""
    chosen = [
        v
        for v in settable_in_initialization(probe.fmu)
        if v.base_kind == "String" and v.start and v.causality in ("parameter", "input")
    ]
    for v in chosen[:_MOST_VARIABLES]:
        script = probe.script().initialise()
        script.set(v, v.start)
        reading = script.exit_initialization_mode().read([v])
        script.play()
        if reading.values[v.name] != (v.start or "").encode():
            yield (
                f"{v.name} is {reading.values[v.name]!r} after {v.start!r} was set and its memory "
                "overwritten: expected a copy"
            )


@behaviour_rule(_VALUES, needs="questions-change-nothing")
def initial_values_follow_what_is_set(probe: Probe) -> Iterator[str]:
    """In initialization mode, values follow what is set, also if they had been read before that."""
    readable, tried = readable_in_initialization(probe.fmu), []
    for v, value in other_values(settable_in_initialization(probe.fmu)[:_MOST_VARIABLES]):
        plain, again = probe.script().initialise(), probe.script().initialise()
        plain.set(v, value)
        again.read(readable)
        again.set(v, value)
        tried.append((v, plain, again, plain.read(readable), again.read(readable)))
    probe.play_each([script for _, plain, again, *_ in tried for script in (plain, again)])
    for v, plain, again, first, second in tried:
        if plain.succeeded and again.succeeded:
            when = f"where it had been read before {v.name} was set"
            yield from differing([first], [second], when, _ROUNDED)


@behaviour_rule(
    "4.1.2 Mathematical Model",
    needs="allowed-calls-succeed start-values-are-as-declared strings-are-copied statuses-are-legal",
)
def setting_the_same_changes_nothing(probe: Probe) -> Iterator[str]:
    """Inputs and tunable parameters can be set at communication points; set to what they are, no state
    is lost.
    """
    chosen = settable_while_stepping(probe.fmu)
    if not chosen:
        raise NotApplicableError("there is neither an input nor a tunable parameter")
    held, again = probe.script().begin(), probe.script(logging=True).begin()
    expected, got = held.run(4), []
    for _ in range(4):
        for v in chosen:
            if (value := start_value(v)) is not None:
                again.set(v, value)
        got += again.run(1)
    held.play()
    again.play(keep_going=True)
    when = "where inputs and tunable parameters were set to what they are"
    failing = f"in the state {again.failure.state!r}" if again.failure else ""
    yield from failing_or_differing(again, expected, got, when, RESTARTED, failing)


@behaviour_rule("4.1.2 Mathematical Model", needs="fixed-values-stay strings-are-copied")
def inputs_that_are_set_are_read(probe: Probe) -> Iterator[str]:
    """An input or tunable parameter that is set at a communication point has that value after the step."""
    chosen = settable_while_stepping(probe.fmu)[:_MOST_VARIABLES]
    settings = [_set_after_a_step(probe, *pair) for pair in other_values(chosen)]
    for v, got, given in _read_otherwise(probe, settings):
        yield f"{v.name} is {got} after it was set to {given} at a communication point: expected that"


def _set_after_a_step(probe: Probe, v: Variable, value: Any) -> _Setting:
    """Returns a script that sets the value after a step and reads it after another."""
    script = probe.script().begin().step()
    script.set(v, value)
    return v, value, script, script.step().read([v])


@behaviour_rule(_VALUES, needs="inputs-that-are-set-are-read")
def far_values_are_read(probe: Probe) -> Iterator[str]:
    """An input or tunable parameter that is set far from its start value, within its range, or a String that
    is long or empty, is read as it was set, unless the FMU refuses it.
    """
    chosen = settable_while_stepping(probe.fmu)[:_MOST_VARIABLES]
    settings = [_set_after_a_step(probe, v, x) for v in chosen for x in far_values(v)]
    for v, got, given in _read_otherwise(probe, settings):
        yield f"{v.name} is {got[:60]} after it was set to {given[:60]}: expected that"


@behaviour_rule(
    "advice: 2.2.3, what to do with a value beyond its range",
    needs="values-that-are-set-are-read",
    last=True,
)
def values_out_of_range_are_not_dropped(probe: Probe) -> Iterator[str]:
    """A parameter that is set below its min or above its max in initialization mode has that value, unless
    fmi2SetXXX refuses it, warns or logs a message.
    """
    settings = []
    for v in [v for v in settable_in_initialization(probe.fmu) if v.causality == "parameter"]:
        for x in values_out_of_range(v):
            script = probe.script(logging=True).initialise()
            reply = script.set(v, x)
            reading = script.exit_initialization_mode().read([v])
            settings.append((reply, (v, x, script, reading)))
    settings = settings[:_MOST_VARIABLES]
    probe.play_each([script for _, (_, _, script, _) in settings])
    silent = [setting for reply, setting in settings if reply.status == OK and not reply.messages]
    for v, x, got in ((v, x, reading.values[v.name]) for v, x, script, reading in silent if script.succeeded):
        if not same(got, x, _EXACT):
            shown = texts(got, x)
            yield (
                f"{v.name} is {shown[0]} after fmi2Set{v.base_kind} of {shown[1]}, beyond its range, "
                "returned ok: expected discard, a message, or that value"
            )
            return
