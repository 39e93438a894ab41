"""What can be set and read, when, and what stays as it is."""

import math
from collections.abc import Iterator, Sequence

from fmus.binding import ERROR
from fmus.compliance.lifecycle_rules import unknown_reference
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Level, NotJudgedError, Stage, rule
from fmus.compliance.script import KINDS, Reply, Script
from fmus.compliance.session import session
from fmus.compliance.values import (
    RESTARTED,
    differing,
    other_value,
    readable_in_initialization,
    same,
    settable_before,
    settable_in_initialization,
    settable_while_stepping,
    start_value,
    texts,
)  # fmt: skip
from fmus.compliance.variable import Variable

_PLATFORM = "2.1.2 Platform Dependent Definitions (fmi2TypesPlatform.h)"
_INITIALIZATION = "2.1.6 Initialization, Termination, and Resetting an FMU"
_VALUES = "2.1.7 Getting and Setting Variable Values"
_VARIABLES = "2.2.7 Definition of Model Variables (ModelVariables)"
_MOST_VARIABLES = 50  # of one kind, each of which costs an instance
_ROUNDED = 1e-6


@rule(_VALUES, Stage.BEHAVIOUR)
def variables_can_be_read(probe: Probe) -> Iterator[str]:
    """After a step every variable can be read by its value reference and type."""
    script = probe.script(logging=True).begin().step()
    reading = script.read(probe.fmu.variables)
    script.play()
    for name, value in reading.values.items():
        if value is None:
            yield f"{name} is NULL after the first step: expected a string"


@rule("advice: other models expect numbers", Stage.BEHAVIOUR, Level.WARNING, needs=["variables-can-be-read"])
def outputs_are_finite(probe: Probe) -> Iterator[str]:
    """After a step the Real outputs are finite."""
    script = probe.script(logging=True).begin().step()
    reading = script.read(probe.outputs)
    script.play()
    for name, value in reading.values.items():
        if isinstance(value, float) and not math.isfinite(value):
            yield f"{name} is {value} after the first step: expected a finite number"


def _set_all(script: Script, variables: Sequence[Variable]) -> list[tuple[Variable, Reply]]:
    pairs = [(v, start_value(v)) for v in variables]
    return [(v, script.set(v, value)) for v, value in pairs if value is not None]


@rule(_INITIALIZATION, Stage.BEHAVIOUR, needs=["start-values-are-as-declared"])
def values_that_are_set_are_read(probe: Probe) -> Iterator[str]:
    """What is set when instantiated or in initialization mode is read afterwards."""
    before = [v for v in settable_before(probe.fmu) if v.initial == "exact"]
    yield from _not_as_set(probe, before, "when instantiated")
    yield from _not_as_set(probe, settable_in_initialization(probe.fmu), "in initialization mode")


def _not_as_set(probe: Probe, variables: Sequence[Variable], when: str) -> Iterator[str]:
    tried = [(v, value) for v in variables[:_MOST_VARIABLES] if (value := other_value(v)) is not None]
    scripts, readings = [], []
    for v, value in tried:
        script = probe.script()
        if when == "when instantiated":
            script.set(v, value)
            script.initialise()
        else:
            script.initialise().set(v, value)
        if v.causality in {"output", "local"}:
            readings.append(script.read([v]))
            script.exit_initialization_mode()
        else:
            script.exit_initialization_mode()
            readings.append(script.read([v]))
        scripts.append(script)
    probe.play_each(scripts)
    for (v, value), script, reading in zip(tried, scripts, readings, strict=True):
        if script.succeeded and not same(float(reading.values[v.name]), float(value), 1e-12):
            shown = texts(reading.values[v.name], value)
            yield f"{v.name} is {shown[0]} after it was set to {shown[1]} {when}: expected that"


@rule(_PLATFORM, Stage.BEHAVIOUR)
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


@rule(_PLATFORM, Stage.BEHAVIOUR)
def constants_cannot_be_set(probe: Probe) -> Iterator[str]:
    """Setting a constant is an error."""
    for v in [v for v in probe.fmu.variables if v.variability == "constant"][:_MOST_VARIABLES]:
        if (value := start_value(v)) is not None:
            script = probe.script(logging=True).initialise()
            reply = script.set(v, value)
            script.play(keep_going=True)
            if reply.status != ERROR:
                yield f"{reply.function} of the constant {v.name}: {reply.status_name}: expected error"


@rule("advice: 4.2.4 allows to set no other variables", Stage.BEHAVIOUR, Level.WARNING)
def calculated_values_cannot_be_set(probe: Probe) -> Iterator[str]:
    """Setting a variable that is calculated is refused."""
    chosen = [v for v in probe.fmu.variables if v.initial == "calculated" or v.causality == "independent"]
    for v in chosen[:_MOST_VARIABLES]:
        if v.base_kind in ("Real", "Integer", "Boolean"):
            script = probe.script(logging=True).initialise()
            reply = script.set(v, 0 if v.base_kind != "Real" else 0.0)
            script.play(keep_going=True)
            if reply.ok:
                yield f"{reply.function} of {v.name}, which is calculated, returned ok: expected error"
                return


@rule(_VARIABLES, Stage.BEHAVIOUR)
def constants_have_their_value(probe: Probe) -> Iterator[str]:
    """Constants have their start value, in initialization mode and after steps."""
    constants = [v for v in probe.fmu.variables if v.variability == "constant" and start_value(v) is not None]
    script = probe.script().begin().step(2)
    reading = script.read(constants)
    script.play()
    for v in constants:
        value, expected = reading.values[v.name], start_value(v)
        value = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        if not same(value, expected, _ROUNDED):
            shown = texts(value, expected)
            yield f"{v.name} is {shown[0]}, a constant: expected {shown[1]}"


@rule(_VARIABLES, Stage.BEHAVIOUR)
def fixed_values_stay(probe: Probe) -> Iterator[str]:
    """What is fixed or tunable, and inputs, change by steps only if the importer sets them."""
    chosen = [
        v for v in probe.fmu.variables if v.variability in ("fixed", "tunable") or v.causality == "input"
    ]
    script = probe.script().begin()
    readings = [script.read(chosen), script.step().read(chosen), script.step(4).read(chosen)]
    script.play()
    named = set()
    for reading in readings[1:]:
        for name, value in reading.values.items():
            first = readings[0].values[name]
            if not same(value, first) and name not in named:
                named.add(name)
                new, old = texts(value, first)
                yield f"{name} is {new} after steps: expected {old} as before"


@rule(_PLATFORM, Stage.BEHAVIOUR)
def values_belong_to_references(probe: Probe) -> Iterator[str]:
    """A value does not depend on the order in which variables are read; aliases are equal; Booleans are
    0 or 1.
    """
    script = probe.script().begin().step(2)
    variables = probe.fmu.variables
    forward, backward = script.read(variables), script.read(tuple(reversed(variables)))
    alone = [script.read([v]) for v in variables[:_MOST_VARIABLES]]
    script.play()
    values = forward.values
    yield from differing([forward], [backward], "read in another order")
    for reading in alone:
        for name, value in reading.values.items():
            if not same(value, values[name]):
                yield (
                    f"{name} is {texts(value, values[name])[0]} read alone: expected "
                    f"{texts(value, values[name])[1]}"
                )
    first: dict[tuple[str, int | None], str] = {}
    for v in variables:
        other = first.setdefault((v.base_kind, v.reference), v.name)
        if v.name in values and not same(values[v.name], values[other]):
            yield (
                f"{v.name} is {values[v.name]!r} and its alias {other} {values[other]!r}: expected "
                "the same value"
            )
        if v.base_kind == "Boolean" and values.get(v.name) not in (0, 1):
            yield f"{v.name} is {values.get(v.name)}: expected 0 or 1, a Boolean"


@rule(_PLATFORM, Stage.BEHAVIOUR)
def strings_are_utf_8(probe: Probe) -> Iterator[str]:
    """Strings that are read are UTF-8."""
    named = set()
    for reading in session(probe).readings:
        if reading.ok:
            for name, value in reading.values.items():
                if isinstance(value, bytes) and name not in named and not _is_utf_8(value):
                    named.add(name)
                    yield f"{name} is {value[:40]!r}: expected UTF-8"


def _is_utf_8(content: bytes) -> bool:
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return False
    return True


@rule("2.2.3 Definition of Types (TypeDefinitions)", Stage.BEHAVIOUR)
def enumerations_are_items(probe: Probe) -> Iterator[str]:
    """An Enumeration that is read is the value of one of its items."""
    script = probe.script().begin().step(2)
    chosen = [v for v in probe.fmu.variables if v.items]
    reading = script.read(chosen)
    script.play()
    for v in chosen:
        if reading.values[v.name] not in v.items:
            yield (
                f"{v.name} is {reading.values[v.name]}: expected one of "
                f"{', '.join(map(str, sorted(v.items)))}"
            )


@rule("2.2.3 Definition of Types (TypeDefinitions)", Stage.BEHAVIOUR, Level.WARNING)
def values_are_in_range(probe: Probe) -> Iterator[str]:
    """Integers and Enumerations that are read lie between min and max, and Reals up to rounding."""
    script = probe.script().begin().step(3)
    reading = script.read(probe.fmu.variables)
    script.play()
    for v in probe.fmu.variables:
        value, low, high = reading.values.get(v.name), v.number("min"), v.number("max")
        if not isinstance(value, (int, float)) or v.base_kind == "Boolean" or math.isnan(value):
            continue
        margin = _ROUNDED * max(abs(low or 0.0), abs(high or 0.0), 1.0) if v.base_kind == "Real" else 0.0
        if (low is not None and value < low - margin) or (high is not None and value > high + margin):
            yield (
                f"{v.name} is {value:.9g}: expected "
                f"{low if low is not None else ''}..{high if high is not None else ''}"
            )


@rule(_PLATFORM, Stage.BEHAVIOUR)
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


@rule(_VALUES, Stage.BEHAVIOUR)
def initial_values_follow_what_is_set(probe: Probe) -> Iterator[str]:
    """In initialization mode, values follow what is set, also if they had been read before that."""
    readable, tried = readable_in_initialization(probe.fmu), []
    for v in settable_in_initialization(probe.fmu)[:_MOST_VARIABLES]:
        if (value := other_value(v)) is not None:
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


@rule(
    "4.1.2 Mathematical Model",
    Stage.BEHAVIOUR,
    needs=["allowed-calls-succeed", "start-values-are-as-declared"],
)
def setting_the_same_changes_nothing(probe: Probe) -> Iterator[str]:
    """Inputs and tunable parameters can be set at communication points; set to what they are, no state
    is lost.
    """
    chosen = settable_while_stepping(probe.fmu)
    if not chosen:
        raise NotJudgedError("there is neither an input nor a tunable parameter")
    held, again = probe.script().begin(), probe.script(logging=True).begin()
    expected, got = held.run(4), []
    for _ in range(4):
        _set_all(again, chosen)
        got += again.run(1)
    held.play()
    again.play(keep_going=True)
    if again.failure:
        yield f"in the state {again.failure.state!r}: {again.failure.problem}"
    else:
        yield from differing(
            expected, got, "where inputs and tunable parameters were set to what they are", RESTARTED
        )


@rule("4.1.2 Mathematical Model", Stage.BEHAVIOUR, needs=["fixed-values-stay"])
def inputs_that_are_set_are_read(probe: Probe) -> Iterator[str]:
    """An input or tunable parameter that is set at a communication point has that value after the step."""
    tried = []
    for v in settable_while_stepping(probe.fmu)[:_MOST_VARIABLES]:
        if (value := other_value(v)) is not None:
            script = probe.script().begin().step()
            script.set(v, value)
            tried.append((v, value, script, script.step().read([v])))
    probe.play_each([script for _, _, script, _ in tried])
    for v, value, script, reading in tried:
        if script.succeeded and not same(float(reading.values[v.name]), float(value), 1e-12):
            shown = texts(reading.values[v.name], value)
            when = "at a communication point: expected that"
            yield f"{v.name} is {shown[0]} after it was set to {shown[1]} {when}"


@rule(_INITIALIZATION, Stage.BEHAVIOUR, needs=["allowed-calls-succeed", "statuses-are-legal"])
def final_values_after_terminate(probe: Probe) -> Iterator[str]:
    """After fmi2Terminate the final values can be read: those of the last step."""
    script = probe.script(logging=True).begin().step(2)
    before = script.read(probe.fmu.variables)
    script.terminate()
    after = script.read(probe.fmu.variables)
    script.play()
    yield from differing([before], [after], "after fmi2Terminate")
