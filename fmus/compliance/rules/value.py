"""Values that are read: right types and ranges, finite, final, and constant if declared so."""

import itertools
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import Any

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import ROUNDING, Row, differences, differential
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule, rule_of
from fmus.compliance.rules.derivatives import values_of
from fmus.compliance.traces import generator
from fmus.compliance.variable import Variable

_ROUNDED, _SOME = 1e-6, 2
_STEPS = (1, 1, 4, 10)  # between the readings of a run


@behaviour_rule("2.1.7")
def variables_can_be_read(probe: Probe) -> None:
    """After initialisation and after a step every variable can be read by its value reference and type."""
    read = do.read(probe.fmu.variables)
    probe.script(do.begin, read, do.step(), read, logging=True).play()


@behaviour_rule("2.1.7")
def initial_values_are_computed(probe: Probe) -> Iterator[str]:
    """In initialization mode calculated variables have their initial values: no calculated parameter has
    another one after it, and not each of some continuous variables that can be read.
    """
    readable = probe.fmu.readable_in_initialization
    calculated = [v for v in readable if (v.variability, v.initial) == ("continuous", "calculated")]
    parameters = [v for v in readable if v.causality == "calculatedParameter"]
    settable, read = probe.fmu.settable_in_initialization, do.read([*calculated, *parameters])
    others = do.set_values(do.others_accepted(probe, settable, do.initialise))
    ways = ((do.initialise, *sets, read, do.exit_initialization_mode, read) for sets in ((), (others,)))
    for first, after in filter(None, values_of(probe, ways)):
        told, moved = (
            [v for v in group if not values.same(first[v.name], after[v.name], _ROUNDED)]
            for group in (parameters, calculated)
        )
        stay = any(after[v.name] != 0.0 for v in calculated if v not in moved)
        for v in told + moved * (len({v.reference for v in moved}) >= _SOME and not stay):
            got, expected = values.texts(first[v.name], after[v.name])
            yield f"{v.name} is {got} in initialization mode: expected {expected}, as after it"


_Read = tuple[str, Mapping[str, Any]]
"""Words for when values were read, and the values by name."""


def _values(probe: Probe) -> list[_Read]:
    """Returns what `_values_in_runs` yields, played once."""
    return probe.once("values in runs", lambda: [*_values_in_runs(probe)])


def _values_in_runs(probe: Probe) -> Iterator[_Read]:
    """Yields the values of the outputs in initialization mode, of all variables after it, after some steps
    and in a run over the default experiment, and what is least and largest of each output in that.
    """
    ends = zip(_STEPS, itertools.accumulate(_STEPS), strict=True)
    few = [(do.step(count), do.read_all(f"after {end} steps")) for count, end in ends]
    start = do.initialise, do.read(probe.outputs, "in initialization mode"), do.exit_initialization_mode
    begin = *start, do.read_all("after initialisation")
    plays = [do.played(probe, [*begin, *itertools.chain(*few)], logging=True)]
    with suppress(NotApplicableError, NotJudgedError):
        plays.append(do.over_the_experiment(probe))
    outputs = do.comparable_outputs(probe)
    for play in plays:
        for when, where, reading in play.observed:
            if reading.ok:
                yield when + where, reading.values
        for reply in play.replies:
            observed: list[Any] = reply.value if reply.is_step and isinstance(reply.value, list) else []
            for v, (least, t, largest, other_t) in zip(outputs, observed, strict=False):
                yield f"in the default experiment, at {t:g} s", {v.name: least}
                yield f"in the default experiment, at {other_t:g} s", {v.name: largest}


def _with_others(probe: Probe) -> Iterator[Iterator[_Read]]:
    """Yields the values of all variables after initialisation with other values, and after steps with other
    inputs and tunable parameters, of each run.
    """
    for run in generator.played(probe):
        yield (("in a run with other values", r.values) for r in run.readings[1:] if r.ok)


def _wrong_values(
    probe: Probe, expected: Callable[[Variable, Any], str], *, of: Callable[[Variable], object],
    has_others: bool = True,
) -> Iterator[str]:  # fmt: skip
    """Yields values of variables that are wrong, also with other inputs, if so.

    expected: returns the expectation for a wrong value, or ""; of: whether a variable may have one
    """
    variables = {v.name: v for v in probe.fmu.variables if of(v)}
    others = itertools.chain(*_with_others(probe)) if has_others and variables else ()
    for when, row in itertools.chain(_values(probe), others):
        for name, value in row.items():
            if name in variables and (text := expected(variables[name], value)):
                yield f"{name} is {values.texts(value)[0]} {when}: expected {text}"


def _rule_of(clause: str, of: Callable[[Variable], object], **options: Any) -> Any:
    """Makes a function that returns what is expected in place of a wrong value a rule of some variables."""
    return rule_of(partial(_wrong_values, of=of, **options), clause)


@_rule_of("2.1.2, 2.1.7", lambda v: v.base_kind in ("Boolean", "String"))
def values_are_of_their_types(v: Variable, value: Any) -> str:
    """A Boolean that is read is 0 or 1, and a String not NULL."""
    if v.base_kind == "Boolean" and value not in (0, 1):
        return "0 or 1, a Boolean"
    return "a string, not NULL" if value is None else ""


@_rule_of("advice: other models expect numbers", lambda v: v.causality == "output", has_others=False)
def outputs_are_finite(_: Variable, value: Any) -> str:
    """The Real outputs are finite, in initialization mode and after steps."""
    return "a finite number" if isinstance(value, float) and not math.isfinite(value) else ""


@_rule_of("2.2.3", lambda v: v.items)
def enumerations_are_items(v: Variable, value: Any) -> str:
    """An Enumeration that is read is the value of one of its items, between min and max."""
    allowed = [x for x in sorted(v.items) if v.low <= x <= v.high]
    is_wrong = allowed and value not in allowed
    return f"one of {', '.join(map(str, allowed))}" if is_wrong else ""


def _has_a_limit(v: Variable) -> bool:
    is_number = v.base_kind in ("Real", "Integer") and not v.items
    return is_number and (math.isfinite(v.low) or math.isfinite(v.high))


@_rule_of("2.2.3", _has_a_limit)
def values_are_in_range(v: Variable, value: Any) -> str:
    """Integers that are read lie between min and max, and Reals up to rounding, outputs after each step of
    the default experiment.
    """
    limits = [x for x in (v.low, v.high) if math.isfinite(x)]
    margin = _ROUNDED * max(map(abs, [*limits, 1.0])) if v.base_kind == "Real" else 0.0
    is_wrong = value < v.low - margin or value > v.high + margin
    return f"{v.low}..{v.high}" if is_wrong else ""


@_rule_of("2.1.2", lambda v: v.base_kind == "String")
def strings_are_utf_8(_: Variable, value: Any) -> str:
    """Strings that are read are UTF-8."""
    is_wrong = isinstance(value, bytes) and value.decode(errors="ignore").encode() != value
    return "UTF-8" if is_wrong else ""


@differential("2.1.2")
def values_belong_to_references(probe: Probe) -> Iterator[Row]:
    """A value does not depend on the order in which variables are read, so that aliases are equal."""
    variables = probe.fmu.variables
    some = variables[: do.MOST_VARIABLES]
    otherwise = [
        do.read(variables[::-1], "read in another order"),
        *(do.read([b, a], "read with the variable before it") for a, b in itertools.pairwise(some)),
        *(do.read([v, v], "read twice in one call") for v in some),
    ]
    yield Row("", (do.start, do.step(2), do.expect(do.read(variables)), *otherwise), (), "", again="{}")
    others = do.others_accepted(probe, probe.fmu.settable_while_stepping, do.begin, do.step())
    # after which the first that is read computes values; 4.2.4 has no reading between setting and a step
    for change in ((), others) if probe.fmu.is_model_exchange else ((),):
        first = do.begin, do.step(), do.set_values(change)
        usual, varied = ((*first, do.read(some)) for some in (variables, variables[::-1]))
        yield Row("read first in another order", varied, usual, may_fail=True, again="{}")


@differential("2.1.6")
def final_values_after_terminate(probe: Probe) -> Iterator[Row]:
    """After fmi2Terminate the final values can be read; they are the values of the last step."""
    read = do.read(probe.fmu.variables)
    varied = do.start, do.step(2), do.expect(read), do.terminate, read
    # where terminating evaluates the model once more, crossing functions may differ by their hysteresis
    yield Row("after fmi2Terminate", varied, (), tolerance=_ROUNDED)


# values that change only when they may


@behaviour_rule("2.2.7")
def fixed_values_stay(probe: Probe) -> Iterator[str]:
    """Constants have their start value after steps; fixed and tunable variables, and inputs, change only if
    the importer sets them: fixed ones do not follow inputs and tunable parameters, tunable ones no inputs.
    """
    variables, kept = probe.fmu.variables, ("constant", "fixed", "tunable")
    held = {v.name: v for v in variables if v.variability in kept or v.causality == "input"}
    first = {v.name: x for v, x in values.start_values(held.values()) if v.variability == "constant"}
    runs = ({*held}, iter(_values(probe))), *_held_in_runs(probe, held)
    for names, run in runs:
        known = first.copy()
        for when, row in run:
            for name in [name for name in row if name in held and name in names]:
                value = values.read_value(row[name])
                if not values.same(before := known.setdefault(name, value), value, _ROUNDED):
                    what = "as it is a constant" if held.pop(name).variability == "constant" else "as before"
                    got, expected = values.texts(value, before)
                    yield f"{name} is {got} {when}: expected {expected}, {what}"


def _held_in_runs(probe: Probe, held: Mapping[str, Variable]) -> Iterator[tuple[set[str], Iterator[_Read]]]:
    """Yields names of variables that do not change in each run with other values, with what is read."""
    for trace, run in zip(generator.excited(probe), _with_others(probe), strict=True):
        causalities = {v.causality for v, _ in itertools.chain(*trace.sets)}
        kept = ("constant", "fixed") if "parameter" in causalities else ("constant", "fixed", "tunable")
        yield {name for name, v in held.items() if v.variability in kept and v.causality != "input"}, run


@behaviour_rule("2.2.7")
def tunable_values_are_computed_anew(probe: Probe) -> Iterator[str]:
    """A tunable parameter that is set at a communication point gives tunable calculated parameters and
    outputs as if it had been set before.
    """
    tunable = [v for v in probe.fmu.variables if v.variability == "tunable"]
    # a local variable may keep an intermediate value
    computed = [v for v in tunable if v.causality in ("calculatedParameter", "output")]
    pairs = values.other_values([v for v in tunable if v.causality == "parameter"][: do.MOST_VARIABLES])
    if not computed or not pairs:
        raise NotApplicableError("there is no tunable parameter, or none that is calculated")

    def row(*some: do.Pair) -> Row:
        early = do.initialise, do.set_values(some), do.exit_initialization_mode, do.read(computed)
        late = do.start, do.step(), do.set_values(some), do.step(), do.read(computed)
        when = f"after {', '.join(v.name for v, _ in some)} was set at a communication point"
        again = "{}, as if it had been set in initialization mode"
        return Row(when, late, early, tolerance=ROUNDING, may_fail=True, again=again)

    taken = do.accepted_together(probe, pairs, do.begin, do.step())
    together = [*differences(probe, [row(*taken)])]
    yield from together and ([*differences(probe, map(row, pairs))] or together)
