"""Directional derivatives in step mode, as far as the FMU claims them."""

import math
from collections.abc import Iterator
from typing import Any

from fmus.compliance.accepted import accepted_together
from fmus.compliance.comparison import same, texts
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.rules.directional import (
    AGREEMENT,
    DIFFERENCE,
    DIRECTIONAL,
    MOST_KNOWNS,
    PROVIDES,
    derivatives_by,
    other_quotients,
    states_of,
)
from fmus.compliance.script import Script
from fmus.compliance.values import (
    other_values,
    settable_in_initialization,
    settable_while_stepping,
    start_value,
)
from fmus.compliance.variable import Variable

_MOST_CHANGED = 50  # variables of one run
_LATER = 3  # steps after which a factor is looked at again


@behaviour_rule(
    DIRECTIONAL,
    condition=PROVIDES,
    needs="directional-derivatives directional-derivatives-are-linear",
)
def directional_derivatives_in_step_mode(probe: Probe) -> Iterator[str]:
    """After initialisation with other values, the derivatives of outputs and state derivatives in step mode
    lie near difference quotients: those of runs with other inputs and states at first.
    """
    settable = [v for v in settable_in_initialization(probe.fmu) if v.kind == "Real"]
    pairs, states = other_values(settable[:_MOST_CHANGED]), states_of(probe.fmu)
    point = accepted_together(probe, pairs, lambda: probe.script().initialise())
    for known, unknowns in list(_step_pairs(probe.fmu, states).items())[:MOST_KNOWNS]:
        v = probe.fmu.variables[known - 1]
        start = {w.index: x for w, x in point}.get(known, start_value(v))
        if isinstance(start, float):
            yield from _other_derivatives(probe, point, v, start, unknowns, states)


def _step_pairs(fmu: FmuFile, states: list[Variable]) -> dict[int, list[Variable]]:
    """Returns index of a Real input or exact state -> continuous unknowns of step mode that list it."""
    settable = {
        v.index
        for v in settable_in_initialization(fmu)
        if v.kind == "Real" and (v.causality == "input" or v in states)
    }
    pairs: dict[int, list[Variable]] = {}
    for unknown, knowns, _ in [*fmu.dependencies["Outputs"], *fmu.dependencies["Derivatives"]]:
        for known in sorted(settable if knowns is None else settable & set(knowns)):
            if unknown.kind == "Real" and unknown.index != known:
                pairs.setdefault(known, []).append(unknown)
    return pairs


def _other_derivatives(
    probe: Probe,
    point: list[tuple[Variable, Any]],
    known: Variable,
    start: float,
    unknowns: list[Variable],
    states: list[Variable],
) -> Iterator[str]:
    """Yields messages of derivatives outside of quotients, unless a state follows the known at once."""
    width = DIFFERENCE * max(1.0, abs(start))
    scripts = [_in_step_mode(probe, point, known, x) for x in (start, start - width, start + width)]
    readings = [script.read([*unknowns, *states]) for script in scripts]
    reply = derivatives_by(scripts[0], unknowns, known)
    probe.play_each(scripts)
    if not all(script.succeeded for script in scripts):
        return
    middle, low, high = (reading.values for reading in readings)
    if any(middle[v.name] != low[v.name] or middle[v.name] != high[v.name] for v in states if v is not known):
        return
    for v, derivative in zip(unknowns, reply.value, strict=True):
        quotients = [(middle[v.name] - low[v.name]) / width, (high[v.name] - middle[v.name]) / width]
        rounding = 1e-13 * abs(middle[v.name]) / width + 1e-9
        if not all(map(math.isfinite, quotients)):
            continue
        if expected := other_quotients(derivative, quotients, rounding):
            yield f"d {v.name} / d {known.name} is {derivative:.9g} in step mode: expected {expected}"


def _in_step_mode(probe: Probe, point: list[tuple[Variable, Any]], known: Variable, value: float) -> Script:
    """Returns a run in step mode after initialisation at a point, but with another value of one variable."""
    script = probe.script().initialise()
    for v, x in point:
        if v is not known:
            script.set(v, x)
    script.set(known, value)
    return script.exit_initialization_mode()


@behaviour_rule(
    "2.2.8 Definition of the Model Structure (ModelStructure)",
    condition=PROVIDES,
    needs="directional-derivatives directional-derivatives-are-linear",
)
def factors_change_as_declared(probe: Probe) -> Iterator[str]:
    """In step mode a factor that is constant or fixed is the same when inputs, states and tunable parameters
    have changed, and a tunable one when inputs and states have.
    """
    factors = _declared_factors(probe.fmu)
    if not factors:
        raise NotApplicableError("no dependency is of the kind constant, fixed or tunable")
    changes = other_values(settable_while_stepping(probe.fmu))
    for kinds, chosen in (
        (("constant", "fixed"), changes),
        (("tunable",), [(v, x) for v, x in changes if v.causality == "input"]),
    ):
        judged = [factor for factor in factors if factor[2] in kinds][:MOST_KNOWNS]
        first, later = probe.script().begin().step(), probe.script().begin()
        pairs = chosen[:_MOST_CHANGED] if judged else []
        for v, x in accepted_together(probe, pairs, lambda: probe.script().begin()):
            later.set(v, x)
        later.step(_LATER)
        replies = [[derivatives_by(script, [u], k) for u, k, _ in judged] for script in (first, later)]
        probe.play_each([first, later])
        for (u, k, kind), one, other in zip(judged, *replies, strict=True):
            if one.ok and other.ok and not same(one.value[0], other.value[0], AGREEMENT, 1e-12):
                shown = texts(other.value[0], one.value[0])
                yield f"d {u.name} / d {k.name} is {shown[0]} and was {shown[1]}: its factor is said {kind}"


def _declared_factors(fmu: FmuFile) -> list[tuple[Variable, Variable, str]]:
    """Returns (unknown, known, kind) of the Real ones that change seldom, of Outputs and Derivatives."""
    factors, initial = [], {index for index, _ in fmu.unknowns("InitialUnknowns")}
    settable = settable_in_initialization(fmu)
    for unknown, knowns, kinds in [*fmu.dependencies["Outputs"], *fmu.dependencies["Derivatives"]]:
        for number, kind in zip(knowns or (), kinds, strict=False):
            known = fmu.variables[number - 1] if number and number <= len(fmu.variables) else unknown
            real = unknown.kind == known.kind == "Real" and known.causality != "independent"
            has_a_rule = kind == "constant" and unknown.index in initial and known in settable
            if real and known is not unknown and kind in ("constant", "fixed", "tunable") and not has_a_rule:
                factors.append((unknown, known, kind))
    return factors
