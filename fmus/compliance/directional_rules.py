"""Behaviour of directional derivatives, as far as the FMU claims them."""

import math
from collections.abc import Iterator
from typing import Any

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Level, NotApplicableError, Stage, rule
from fmus.compliance.script import Reading
from fmus.compliance.values import (
    accepted_together,
    continuous_reals,
    other_value,
    other_values,
    references_of,
    same,
    settable_in_initialization,
    settable_while_stepping,
    start_value,
    texts,
    unless_claimed,
)
from fmus.compliance.variable import Variable, integer

_DIRECTIONAL = "2.1.9 Getting Partial Derivatives"
_STRUCTURE = "2.2.8 Definition of the Model Structure (ModelStructure)"
_PROVIDES = "providesDirectionalDerivative"
_MOST_KNOWNS = 40  # of one FMU: each costs four evaluations
_MOST_CHANGED = 50  # variables of one run
_DIFFERENCE = 1e-6  # relative change for a difference quotient: half the digits for truncation and rounding
_AGREEMENT = 1e-4  # relative; a wrong derivative is wrong by much more
_LATER = 3  # steps after which a factor is looked at again
_LINEAR = 1e-6  # relative: derivatives may be difference quotients


@rule(
    _DIRECTIONAL,
    Stage.BEHAVIOUR,
    condition=unless_claimed(_PROVIDES),
    needs=["allowed-calls-succeed", "variables-can-be-read"],
)
def directional_derivatives(probe: Probe) -> Iterator[str]:
    """In initialization mode, derivatives of outputs, calculated parameters and state derivatives lie between
    difference quotients of both sides.
    """
    for known, unknowns in list(_pairs(probe.fmu).items())[:_MOST_KNOWNS]:
        yield from _compared(probe, probe.fmu.variables[known - 1], unknowns)


def _pairs(fmu: FmuFile) -> dict[int, list[Variable]]:
    """Index of a Real known that can be set -> Real outputs, calculated parameters and state derivatives that
    depend on it at first.
    """
    derivatives = {index for index, _ in fmu.unknowns("Derivatives")}
    dependents: dict[int, list[Variable]] = {}
    settable = [v.index for v in settable_in_initialization(fmu) if v.kind == "Real"]
    for index, element in fmu.unknowns("InitialUnknowns"):
        unknown = fmu.variables[(index or 1) - 1]
        stated = element.get("dependencies")
        listed = settable if stated is None else [integer(index) for index in stated.split()]
        for known in sorted(set(settable) & set(listed)):
            judged = unknown.causality in ("output", "calculatedParameter") or index in derivatives
            if unknown.kind == "Real" and judged:
                dependents.setdefault(known, []).append(unknown)
    return dependents


def _compared(probe: Probe, known: Variable, unknowns: list[Variable]) -> Iterator[str]:
    before = start_value(known)
    if before is None:
        return
    script = probe.script(logging=True).initialise()
    script.set(known, before)  # 4.2.4 lets only outputs and initial unknowns be read here
    middle = script.read(unknowns)
    reply = script.call("directional_derivatives", references_of(unknowns), references_of([known]), [1.0])
    script.play()
    sides = [side for sign in (-1, 1) if (side := _quotients(probe, known, unknowns, before, sign, middle))]
    for v, derivative in zip(unknowns, reply.value, strict=True):
        quotients = [side[v.name] for side in sides]
        if not all(map(math.isfinite, [middle.values[v.name], *quotients])):
            continue
        width = _DIFFERENCE * max(1.0, abs(before))
        rounding = 1e-13 * abs(middle.values[v.name]) / width  # some hundred roundings of the output
        tolerance = _AGREEMENT * max([abs(derivative), *map(abs, quotients)]) + rounding
        low, high = min(quotients, default=-math.inf), max(quotients, default=math.inf)
        if not low - tolerance <= derivative <= high + tolerance:
            yield f"d {v.name} / d {known.name} is {derivative:.9g}: expected {low:.9g}..{high:.9g}"


def _quotients(
    probe: Probe, known: Variable, unknowns: list[Variable], before: float, sign: int, middle: Reading
) -> dict[str, float]:
    """Difference quotients of all unknowns on one side; none where the FMU refuses the value."""
    low, high = known.number("min"), known.number("max")
    value = before + sign * _DIFFERENCE * max(1.0, abs(before))
    if (low is not None and value < low) or (high is not None and value > high):
        return {}
    script = probe.script().initialise()
    script.set(known, value)
    after = script.read(unknowns)
    script.play(keep_going=True)
    if script.failure:
        return {}
    return {name: (after.values[name] - x) / (value - before) for name, x in middle.values.items()}


@rule(
    _DIRECTIONAL,
    Stage.BEHAVIOUR,
    condition=unless_claimed(_PROVIDES),
    needs=["directional-derivatives", "questions-change-nothing"],
)
def directional_derivatives_are_linear(probe: Probe) -> Iterator[str]:
    """A directional derivative is the sum of the partial derivatives, each times its seed, in every mode."""
    initial = [probe.fmu.variables[(i or 1) - 1] for i, _ in probe.fmu.unknowns("InitialUnknowns")]
    initial = [v for v in initial if v.kind == "Real"]
    outputs, states = continuous_reals(probe, "output"), _states(probe.fmu)
    inputs = {v.index: v for v in continuous_reals(probe, "input")}
    at_first = inputs | {i: probe.fmu.variables[i - 1] for i in _pairs(probe.fmu)}
    later = inputs | {v.index: v for v in states}
    if not (initial and at_first) and not (outputs and later):
        raise NotApplicableError("there is no Real known, or neither an output nor an initial unknown")
    for unknowns, by_index, stepping in ((initial, at_first, False), (outputs, later, True)):
        knowns = list(by_index.values())[:_MOST_KNOWNS]
        if not unknowns or not knowns:
            continue
        seed = [2.5 + 0.5 * i for i in range(len(knowns))]
        script = probe.script(logging=True)
        script = script.begin().step() if stepping else script.initialise()
        alone = [
            script.call("directional_derivatives", references_of(unknowns), references_of([known]), [1.0])
            for known in knowns
        ]
        together = script.call(
            "directional_derivatives", references_of(unknowns), references_of(knowns), seed
        )
        script.play()
        for i, v in enumerate(unknowns):
            parts = [s * reply.value[i] for s, reply in zip(seed, alone, strict=True)]
            got, expected = together.value[i], sum(parts)
            if not abs(got - expected) <= _LINEAR * max([1e-300, abs(got), *map(abs, parts)]):
                shown = texts(got, expected)
                yield (
                    f"the directional derivative of {v.name} is {shown[0]} in the state "
                    f"{script.state!r}: expected {shown[1]}, the sum of its parts"
                )


@rule(
    _DIRECTIONAL,
    Stage.BEHAVIOUR,
    condition=unless_claimed(_PROVIDES),
    needs=["directional-derivatives", "initial-dependencies-are-declared"],
)
def directional_derivatives_are_zero_without_dependency(probe: Probe) -> Iterator[str]:
    """The derivative with respect to an input, in step mode also to a continuous state, that is not among
    the dependencies of an output or a state derivative is zero.
    """
    inputs = continuous_reals(probe, "input")
    knowns = {"InitialUnknowns": inputs, "Outputs": [*inputs, *_states(probe.fmu)]}
    knowns["Derivatives"] = knowns["Outputs"]
    for section in knowns:
        stepping = section != "InitialUnknowns"
        for index, element in probe.fmu.unknowns(section):
            unknown, stated = probe.fmu.variables[(index or 1) - 1], element.get("dependencies")
            observed = unknown.causality == "output" or section == "Derivatives"
            if stated is None or unknown.kind != "Real" or not observed:
                continue
            indices = {integer(i) for i in stated.split()} | {unknown.index}
            listed = {(v.base_kind, v.reference) for v in probe.fmu.variables if v.index in indices}
            others = [v for v in knowns[section] if (v.base_kind, v.reference) not in listed][:_MOST_KNOWNS]
            script = probe.script(logging=True)
            script = script.begin().step() if stepping else script.initialise()
            replies = [
                script.call(
                    "directional_derivatives", references_of([unknown]), references_of([known]), [1.0]
                )
                for known in others
            ]
            script.play(keep_going=True)
            for known, reply in zip(others, replies, strict=True):
                if reply.ok and reply.value[0] != 0.0:
                    yield (
                        f"d {unknown.name} / d {known.name} is {reply.value[0]:.9g} in the state "
                        f"{script.state!r}: expected 0, as {section} lists no such dependency"
                    )


@rule(
    _DIRECTIONAL,
    Stage.BEHAVIOUR,
    Level.WARNING,
    condition=unless_claimed(_PROVIDES),
    needs=["directional-derivatives", "directional-derivatives-are-linear"],
)
def directional_derivatives_in_step_mode(probe: Probe) -> Iterator[str]:
    """After initialisation with other values, the derivatives of outputs and state derivatives in step mode
    lie near difference quotients: those of runs with other inputs and states at first.
    """
    settable = [v for v in settable_in_initialization(probe.fmu) if v.kind == "Real"]
    pairs = other_values(settable[:_MOST_CHANGED])
    point, states = accepted_together(probe, pairs, lambda: probe.script().initialise()), _states(probe.fmu)
    for known, unknowns in list(_step_pairs(probe.fmu, states).items())[:_MOST_KNOWNS]:
        v = probe.fmu.variables[known - 1]
        start = {w.index: x for w, x in point}.get(known, start_value(v))
        if isinstance(start, float):
            yield from _step_quotients(probe, point, v, start, unknowns, states)


def _states(fmu: FmuFile) -> list[Variable]:
    """The continuous states that Derivatives exposes."""
    derivatives = [fmu.variables[(index or 1) - 1] for index, _ in fmu.unknowns("Derivatives")]
    indices = [integer(v.typed.get("derivative")) for v in derivatives]
    return [fmu.variables[i - 1] for i in indices if i is not None and 1 <= i <= len(fmu.variables)]


def _step_pairs(fmu: FmuFile, states: list[Variable]) -> dict[int, list[Variable]]:
    """Index of a Real input or state with initial exact -> continuous unknowns of step mode that list it."""
    knowns = {v.index for v in settable_in_initialization(fmu) if v.kind == "Real"}
    knowns = {i for i in knowns if fmu.variables[i - 1].causality == "input"} | (
        knowns & {v.index for v in states}
    )
    pairs: dict[int, list[Variable]] = {}
    for index, element in [*fmu.unknowns("Outputs"), *fmu.unknowns("Derivatives")]:
        unknown, stated = fmu.variables[(index or 1) - 1], element.get("dependencies")
        listed = knowns if stated is None else {integer(i) for i in stated.split()}
        for known in sorted(knowns & listed):
            if unknown.kind == "Real" and unknown.index != known:
                pairs.setdefault(known, []).append(unknown)
    return pairs


def _step_quotients(
    probe: Probe,
    point: list[tuple[Variable, Any]],
    known: Variable,
    start: float,
    unknowns: list[Variable],
    states: list[Variable],
) -> Iterator[str]:
    """Messages of derivatives outside of the quotients, unless a state follows the known when it is set."""
    width = _DIFFERENCE * max(1.0, abs(start))
    scripts, readings = [], []
    for value in (start, start - width, start + width):
        script = probe.script().initialise()
        for v, x in point:
            if v is not known:
                script.set(v, x)
        script.set(known, value)
        script.exit_initialization_mode()
        readings.append(script.read([*unknowns, *states]))
        scripts.append(script)
    reply = scripts[0].call("directional_derivatives", references_of(unknowns), references_of([known]), [1.0])
    probe.play_each(scripts)
    if not all(script.succeeded for script in scripts):
        return
    middle, low, high = (reading.values for reading in readings)
    if any(middle[v.name] != low[v.name] or middle[v.name] != high[v.name] for v in states if v is not known):
        return
    for v, derivative in zip(unknowns, reply.value, strict=True):
        quotients = [(middle[v.name] - low[v.name]) / width, (high[v.name] - middle[v.name]) / width]
        if not all(map(math.isfinite, quotients)):
            continue
        tolerance = _AGREEMENT * max([abs(derivative), *map(abs, quotients)])
        tolerance += 1e-13 * abs(middle[v.name]) / width + 1e-9
        if not min(quotients) - tolerance <= derivative <= max(quotients) + tolerance:
            yield (
                f"d {v.name} / d {known.name} is {derivative:.9g} in step mode: expected "
                f"{min(quotients):.9g}..{max(quotients):.9g}"
            )


@rule(
    _STRUCTURE,
    Stage.BEHAVIOUR,
    Level.WARNING,
    condition=unless_claimed(_PROVIDES),
    needs=["directional-derivatives", "directional-derivatives-are-linear"],
)
def factors_change_as_declared(probe: Probe) -> Iterator[str]:
    """In step mode a factor that is constant or fixed is the same when inputs, states and tunable parameters
    have changed, and a tunable one when inputs and states have.
    """
    factors = _declared_factors(probe.fmu)
    if not factors:
        raise NotApplicableError("no dependency is of the kind constant, fixed or tunable")
    settable = [v for v in settable_while_stepping(probe.fmu) if other_value(v) is not None]
    for kinds, chosen in (
        (("constant", "fixed"), settable),
        (("tunable",), [v for v in settable if v.causality == "input"]),
    ):
        judged = [factor for factor in factors if factor[2] in kinds][:_MOST_KNOWNS]
        first, later = probe.script().begin().step(), probe.script().begin()
        changes = [(v, other_value(v)) for v in chosen[:_MOST_CHANGED]]
        for v, x in accepted_together(probe, changes, lambda: probe.script().begin()) if judged else ():
            later.set(v, x)
        later.step(_LATER)
        replies = [
            [
                script.call("directional_derivatives", [u.reference], [k.reference], [1.0])
                for u, k, _ in judged
            ]
            for script in (first, later)
        ]
        probe.play_each([first, later])
        for (u, k, kind), one, other in zip(judged, *replies, strict=True):
            if one.ok and other.ok and not same(one.value[0], other.value[0], _AGREEMENT, 1e-12):
                shown = texts(other.value[0], one.value[0])
                yield f"d {u.name} / d {k.name} is {shown[0]} and was {shown[1]}: its factor is said {kind}"


def _declared_factors(fmu: FmuFile) -> list[tuple[Variable, Variable, str]]:
    """(unknown, known, kind) of the Real ones that change seldom, of Outputs and Derivatives."""
    factors, initial = [], {index for index, _ in fmu.unknowns("InitialUnknowns")}
    settable = settable_in_initialization(fmu)
    for index, element in [*fmu.unknowns("Outputs"), *fmu.unknowns("Derivatives")]:
        listed, kinds = (element.get(name, "").split() for name in ("dependencies", "dependenciesKind"))
        unknown = fmu.variables[(index or 1) - 1]
        for number, kind in zip(map(integer, listed), kinds, strict=False):
            known = fmu.variables[number - 1] if number and number <= len(fmu.variables) else unknown
            real = unknown.kind == known.kind == "Real" and known.causality != "independent"
            is_initial = kind == "constant" and index in initial and known in settable  # it has its own rule
            if real and known is not unknown and kind in ("constant", "fixed", "tunable") and not is_initial:
                factors.append((unknown, known, kind))
    return factors
