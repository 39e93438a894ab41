"""Values that are read: of their variables, in their ranges, finite, final, and constant if declared so."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance.actions import MOST_VARIABLES
from fmus.compliance.differential import ROUNDING, Row, differences, differential
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.script import Reading
from fmus.compliance.values import (
    is_utf_8,
    other_values,
    same,
    settable_while_stepping,
    start_values,
    texts,
)
from fmus.compliance.variable import Variable

_PLATFORM = "2.1.2 Platform Dependent Definitions (fmi2TypesPlatform.h)"
_INITIALIZATION = "2.1.6 Initialization, Termination, and Resetting an FMU"
_VALUES = "2.1.7 Getting and Setting Variable Values"
_TYPES = "2.2.3 Definition of Types (TypeDefinitions)"
_VARIABLES = "2.2.7 Definition of Model Variables (ModelVariables)"
_ROUNDED = 1e-6
_STEPS = (1, 1, 4, 10)  # between the readings of a run


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


def _read_in_runs(probe: Probe) -> list[tuple[str, Reading]]:
    """Returns readings, each with when: of the outputs in initialization mode, and of all variables after
    some steps, and in a run over the default experiment.
    """
    ends = zip(_STEPS, itertools.accumulate(_STEPS), strict=True)
    few = [(do.step(count), do.read_all(f"after {end} steps")) for count, end in ends]
    start = do.initialise, do.read(probe.outputs, "in initialization mode"), do.exit_initialization_mode
    runs = [do.played(probe, [*start, *itertools.chain(*few)], logging=True)]
    with suppress(NotApplicableError, NotJudgedError):
        runs.append(do.over_the_experiment(probe))
    return [(when + where, reading) for play in runs for when, where, reading in play.observed if reading.ok]


def _first_wrong(probe: Probe, expected: Callable[[Variable, Any], str]) -> Iterator[str]:
    """Yields the first wrong value of each variable.

    expected: of a variable and its value, what is expected if it is wrong
    """
    wrong: dict[str, str] = {}
    variables = {v.name: v for v in probe.fmu.variables}
    for when, reading in _read_in_runs(probe):
        for name, value in reading.values.items():
            text = "" if name in wrong else expected(variables[name], value)
            if text:
                wrong[name] = f"{name} is {texts(value)[0]} {when}: expected {text}"
    yield from wrong.values()


@behaviour_rule("advice: other models expect numbers", needs="variables-can-be-read")
def outputs_are_finite(probe: Probe) -> Iterator[str]:
    """The Real outputs are finite, in initialization mode and after steps."""

    def expected(v: Variable, value: Any) -> str:
        is_finite = v.causality != "output" or not isinstance(value, float) or math.isfinite(value)
        return "" if is_finite else "a finite number"

    return _first_wrong(probe, expected)


@behaviour_rule(_TYPES)
def enumerations_are_items(probe: Probe) -> Iterator[str]:
    """An Enumeration that is read is the value of one of its items."""
    items = {v.name: v.items for v in probe.fmu.variables if v.items}

    def expected(v: Variable, value: Any) -> str:
        known = items.get(v.name, (value,))
        return "" if value in known else f"one of {', '.join(map(str, sorted(known)))}"

    return _first_wrong(probe, expected)


@behaviour_rule(_TYPES)
def values_are_in_range(probe: Probe) -> Iterator[str]:
    """Integers and Enumerations that are read lie between min and max, and Reals up to rounding."""
    limits = {v.name: (v.number("min"), v.number("max")) for v in probe.fmu.variables}

    def expected(v: Variable, value: Any) -> str:
        low, high = limits[v.name]
        if v.base_kind in ("Boolean", "String") or math.isnan(value) or low is high is None:
            return ""
        margin = _ROUNDED * max(abs(low or 0.0), abs(high or 0.0), 1.0) if v.base_kind == "Real" else 0.0
        low, high = -math.inf if low is None else low, math.inf if high is None else high
        return "" if low - margin <= value <= high + margin else f"{low}..{high}"

    return _first_wrong(probe, expected)


@behaviour_rule(_PLATFORM)
def strings_are_utf_8(probe: Probe) -> Iterator[str]:
    """Strings that are read are UTF-8."""

    def expected(_: Variable, value: Any) -> str:
        return "" if not isinstance(value, bytes) or is_utf_8(value) else "UTF-8"

    return _first_wrong(probe, expected)


@behaviour_rule(_PLATFORM, needs="variables-can-be-read questions-change-nothing")
def values_belong_to_references(probe: Probe) -> Iterator[str]:
    """A value does not depend on the order in which variables are read; aliases are equal; Booleans are
    0 or 1.
    """
    variables = probe.fmu.variables
    some = variables[:MOST_VARIABLES]
    otherwise = [
        do.read(variables[::-1], "read in another order"),
        *(do.read([b, a], "read with the variable before it") for a, b in itertools.pairwise(some)),
        *(do.read([v, v], "read twice in one call") for v in some),
    ]
    varied = do.begin, do.step(2), do.expect(do.read_all()), *otherwise
    yield from differences(probe, [Row("read otherwise", varied, (), "", again="{}")])
    play = do.played(probe, varied, logging=True)  # the same
    yield from _impossible(play.expected[0].values, variables)


def _impossible(values: dict[str, Any], variables: Sequence[Variable]) -> Iterator[str]:
    """Yields messages of aliases that differ, and of Booleans that are neither 0 nor 1."""
    first: dict[tuple[str, int | None], str] = {}
    for v in variables:
        other = first.setdefault((v.base_kind, v.reference), v.name)
        value, alias = texts(values[v.name], values[other])
        if not same(values[v.name], values[other]):
            yield f"{v.name} is {value} and its alias {other} {alias}: expected the same value"
        if v.base_kind == "Boolean" and values[v.name] not in (0, 1):
            yield f"{v.name} is {value}: expected 0 or 1, a Boolean"


@differential(_INITIALIZATION, needs="allowed-calls-succeed statuses-are-legal questions-change-nothing")
def final_values_after_terminate(_: Probe) -> Iterator[Row]:
    """After fmi2Terminate the final values can be read: those of the last step."""
    varied = do.begin, do.step(2), do.expect(do.read_all()), do.terminate, do.read_all()
    yield Row("after fmi2Terminate", varied, ())


# values that change only when they may


@differential(_VARIABLES, needs="communication-points-may-be-rounded")
def constants_have_their_value(probe: Probe) -> Iterator[Row]:
    """Constants have their start value after steps."""
    read = do.read_as(start_values(v for v in probe.fmu.variables if v.variability == "constant"))
    varied = do.begin, *itertools.chain(*((do.step(count), read) for count in _STEPS))
    yield Row("after steps", varied, (), tolerance=_ROUNDED, again="{}, as it is a constant")


@differential(_VARIABLES, needs="communication-points-may-be-rounded variables-can-be-read")
def fixed_values_stay(probe: Probe) -> Iterator[Row]:
    """Fixed and tunable variables, and inputs, change by steps only if the importer sets them."""
    chosen = [
        v for v in probe.fmu.variables if v.variability in ("fixed", "tunable") or v.causality == "input"
    ]
    read = do.read(chosen)
    varied = do.begin, do.expect(read), *itertools.chain(*((do.step(count), read) for count in _STEPS))
    yield Row("after steps", varied, (), "", ROUNDING, again="{} as before")


@differential(_VARIABLES, needs="fixed-values-stay allowed-calls-succeed")
def fixed_values_follow_nothing(probe: Probe) -> Iterator[Row]:
    """Fixed values do not follow inputs and tunable parameters that are set at communication points,
    tunable ones do not follow inputs.
    """
    settable, variables = settable_while_stepping(probe.fmu), probe.fmu.variables
    fixed, tunable = ([v for v in variables if v.variability == kind] for kind in ("fixed", "tunable"))
    for causality, chosen, what in (
        ("input", [*fixed, *tunable], "inputs"),
        ("parameter", fixed, "tunable parameters"),
    ):
        changed = [v for v in settable if v.causality == causality]
        pairs = do.others_accepted(probe, changed, do.begin, do.step())
        if pairs and chosen:
            read, set_others = do.read(chosen), do.set_values(pairs)
            varied = do.begin, do.step(), do.expect(read), do.step(), set_others, do.step(2), read
            when = f"after other {what}"
            yield Row(when, varied, (), tolerance=ROUNDING, may_fail=True, again="{} as before")


@differential(_VARIABLES, needs="inputs-that-are-set-are-read values-that-are-set-are-read")
def tunable_values_are_computed_anew(probe: Probe) -> Iterator[Row]:
    """A tunable parameter that is set at a communication point gives calculated tunable values as if it
    had been set before.
    """
    computed = [v for v in probe.fmu.variables if v.variability == "tunable" and v.causality != "parameter"]
    settable = [v for v in settable_while_stepping(probe.fmu) if v.causality == "parameter"]
    pairs = other_values(settable[:MOST_VARIABLES])
    if not computed or not pairs:
        raise NotApplicableError("there is no tunable parameter, or no tunable value that is calculated")
    for v, x in pairs:
        early = do.initialise, do.set_values([(v, x)]), do.exit_initialization_mode, do.read(computed)
        late = do.begin, do.step(), do.set_values([(v, x)]), do.step(), do.read(computed)
        when = f"after {v.name} was set at a communication point"
        again = "{}, as if it had been set in initialization mode"
        yield Row(when, late, early, tolerance=ROUNDING, may_fail=True, again=again)
