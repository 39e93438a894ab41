"""Values that are read: of their variables, in their ranges, finite, and final."""

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any

from fmus.compliance.comparison import differing, same, texts
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.script import Reading
from fmus.compliance.session import session
from fmus.compliance.values import is_utf_8
from fmus.compliance.variable import Variable

_PLATFORM = "2.1.2 Platform Dependent Definitions (fmi2TypesPlatform.h)"
_INITIALIZATION = "2.1.6 Initialization, Termination, and Resetting an FMU"
_VALUES = "2.1.7 Getting and Setting Variable Values"
_MOST_VARIABLES = 50  # of one kind, each of which costs an instance
_AT = (1, 2, 5, 15)  # steps of a run after which all variables are read
_ROUNDED = 1e-6


@behaviour_rule(_VALUES)
def variables_can_be_read(probe: Probe) -> Iterator[str]:
    """After initialisation and after a step every variable can be read by its value reference and type."""
    script = probe.script(logging=True).begin()
    first = script.read(probe.fmu.variables)
    reading = script.step().read(probe.fmu.variables)
    script.play()
    for values, when in ((first.values, "initialisation"), (reading.values, "the first step")):
        for name in [name for name, value in values.items() if value is None]:
            yield f"{name} is NULL after {when}: expected a string"
            return


@behaviour_rule("advice: other models expect numbers", needs="variables-can-be-read")
def outputs_are_finite(probe: Probe) -> Iterator[str]:
    """The Real outputs are finite, in initialization mode and after steps."""
    named = set()
    for number, reading in enumerate(_run(probe)):
        for name, value in reading.values.items():
            if isinstance(value, float) and not math.isfinite(value) and name not in named:
                named.add(name)
                when = f"after step {_AT[number - 1]}" if number else "in initialization mode"
                yield f"{name} is {value} {when}: expected a finite number"


def _run(probe: Probe) -> list[Reading]:
    """Returns readings of a run: the outputs in initialization mode, and all variables after some steps."""

    def read() -> list[Reading]:
        script = probe.script(logging=True).initialise()
        readings = [script.read(probe.outputs)]
        script.exit_initialization_mode()
        for before, after in itertools.pairwise([0, *_AT]):
            readings.append(script.step(after - before).read(probe.fmu.variables))
        script.play(keep_going=True)
        return [reading for reading in readings if reading.ok]

    return probe.once("values of a run", read)


@behaviour_rule(_PLATFORM, needs="variables-can-be-read questions-change-nothing")
def values_belong_to_references(probe: Probe) -> Iterator[str]:
    """A value does not depend on the order in which variables are read; aliases are equal; Booleans are
    0 or 1.
    """
    script = probe.script().begin().step(2)
    variables = probe.fmu.variables
    forward, backward = script.read(variables), script.read(tuple(reversed(variables)))
    alone = [script.read([v, v]) for v in variables[:_MOST_VARIABLES]]
    pairs = [script.read([b, a]) for a, b in itertools.pairwise(variables[:_MOST_VARIABLES])]
    twice = [reply for reading in alone for reply in reading.replies.values()]
    script.play()
    values = forward.values
    yield from differing([forward], [backward], "read in another order")
    if all(same(x, backward.values[name]) for name, x in values.items()):
        messages = _read_otherwise(values, pairs, "read with the variable before it")
        yield from itertools.islice(messages, 1)
    for v, reply in zip(variables, twice, strict=False):
        if len(reply.value) == 2 and not same(*reply.value):
            shown = texts(*reply.value)
            yield f"{v.name} is {shown[0]} and {shown[1]} where one call reads it twice: expected one value"
    yield from _read_otherwise(values, alone, "read alone")
    yield from _impossible(values, variables)


def _impossible(values: dict[str, Any], variables: Sequence[Variable]) -> Iterator[str]:
    """Yields messages of aliases that differ, and of Booleans that are neither 0 nor 1."""
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


def _read_otherwise(values: dict[str, Any], readings: list[Reading], how: str) -> Iterator[str]:
    for name, value in (item for reading in readings for item in reading.values.items()):
        if not same(value, values[name]):
            shown = texts(value, values[name])
            yield f"{name} is {shown[0]} {how}: expected {shown[1]}"


@behaviour_rule(_PLATFORM)
def strings_are_utf_8(probe: Probe) -> Iterator[str]:
    """Strings that are read are UTF-8."""
    named = set()
    for reading in session(probe).readings:
        if reading.ok:
            for name, value in reading.values.items():
                if isinstance(value, bytes) and name not in named and not is_utf_8(value):
                    named.add(name)
                    yield f"{name} is {value[:40]!r}: expected UTF-8"


@behaviour_rule("2.2.3 Definition of Types (TypeDefinitions)")
def enumerations_are_items(probe: Probe) -> Iterator[str]:
    """An Enumeration that is read is the value of one of its items."""
    chosen = {v.name: v for v in probe.fmu.variables if v.items}
    named = set()
    for reading in _run(probe):
        for name in (chosen.keys() & reading.values.keys()) - named:
            value, items = reading.values[name], chosen[name].items
            if value not in items:
                named.add(name)
                yield f"{name} is {value}: expected one of {', '.join(map(str, sorted(items)))}"


@behaviour_rule("2.2.3 Definition of Types (TypeDefinitions)")
def values_are_in_range(probe: Probe) -> Iterator[str]:
    """Integers and Enumerations that are read lie between min and max, and Reals up to rounding."""
    named = set()
    for v, reading in itertools.product(probe.fmu.variables, _run(probe)):
        value, low, high = reading.values.get(v.name), v.number("min"), v.number("max")
        if (
            v.name in named
            or not isinstance(value, (int, float))
            or v.base_kind == "Boolean"
            or math.isnan(value)
        ):
            continue
        margin = _ROUNDED * max(abs(low or 0.0), abs(high or 0.0), 1.0) if v.base_kind == "Real" else 0.0
        if (low is not None and value < low - margin) or (high is not None and value > high + margin):
            named.add(v.name)
            low, high = -math.inf if low is None else low, math.inf if high is None else high
            yield f"{v.name} is {value:.9g}: expected {low}..{high}"


@behaviour_rule(_INITIALIZATION, needs="allowed-calls-succeed statuses-are-legal questions-change-nothing")
def final_values_after_terminate(probe: Probe) -> Iterator[str]:
    """After fmi2Terminate the final values can be read: those of the last step."""
    script = probe.script(logging=True).begin().step(2)
    before = script.read(probe.fmu.variables)
    script.terminate()
    after = script.read(probe.fmu.variables)
    script.play()
    yield from differing([before], [after], "after fmi2Terminate")
