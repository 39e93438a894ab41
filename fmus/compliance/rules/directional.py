"""Directional derivatives in initialization mode, and as sums, as far as the FMU claims them."""

import math
from collections.abc import Iterator, Sequence

from fmus.compliance.comparison import texts
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.script import Reading, Reply, Script
from fmus.compliance.values import (
    continuous_reals,
    references_of,
    settable_in_initialization,
    start_value,
    unless_claimed,
)
from fmus.compliance.variable import Variable, integer

DIRECTIONAL = "2.1.9 Getting Partial Derivatives"
PROVIDES = unless_claimed("providesDirectionalDerivative")
MOST_KNOWNS = 40  # of one FMU: each costs four evaluations
DIFFERENCE = 1e-6  # relative change for a difference quotient: half the digits for truncation and rounding
AGREEMENT = 1e-4  # relative; a wrong derivative is wrong by much more
_LINEAR = 1e-6  # relative: derivatives may be difference quotients


@behaviour_rule(DIRECTIONAL, condition=PROVIDES, needs="allowed-calls-succeed variables-can-be-read")
def directional_derivatives(probe: Probe) -> Iterator[str]:
    """In initialization mode, derivatives of outputs, calculated parameters and state derivatives lie between
    difference quotients of both sides.
    """
    for known, unknowns in list(_pairs(probe.fmu).items())[:MOST_KNOWNS]:
        yield from _compared(probe, probe.fmu.variables[known - 1], unknowns)


def _pairs(fmu: FmuFile) -> dict[int, list[Variable]]:
    """Returns settable Real known's index -> Real outputs, calculated parameters and state derivatives that
    depend on it at first.
    """
    derivatives = {index for index, _ in fmu.unknowns("Derivatives")}
    dependents: dict[int, list[Variable]] = {}
    settable = {v.index for v in settable_in_initialization(fmu) if v.kind == "Real"}
    for unknown, knowns, _ in fmu.dependencies["InitialUnknowns"]:
        judged = unknown.causality in ("output", "calculatedParameter") or unknown.index in derivatives
        if unknown.kind == "Real" and judged:
            for known in sorted(settable if knowns is None else settable & set(knowns)):
                dependents.setdefault(known, []).append(unknown)
    return dependents


def _compared(probe: Probe, known: Variable, unknowns: list[Variable]) -> Iterator[str]:
    before = start_value(known)
    if before is None:
        return
    script = probe.script(logging=True).initialise()
    script.set(known, before)  # 4.2.4 lets only outputs and initial unknowns be read here
    middle = script.read(unknowns)
    reply = derivatives_by(script, unknowns, known)
    script.play()
    sides = [side for sign in (-1, 1) if (side := _quotients(probe, known, unknowns, before, sign, middle))]
    width = DIFFERENCE * max(1.0, abs(before))
    for v, derivative in zip(unknowns, reply.value, strict=True):
        quotients = [side[v.name] for side in sides]
        if all(map(math.isfinite, [middle.values[v.name], *quotients])):
            rounding = 1e-13 * abs(middle.values[v.name]) / width  # some hundred roundings of the output
            if expected := other_quotients(derivative, quotients, rounding):
                yield f"d {v.name} / d {known.name} is {derivative:.9g}: expected {expected}"


def derivatives_by(script: Script, unknowns: Sequence[Variable], known: Variable) -> Reply:
    """Returns the partial derivatives of unknowns."""
    return script.call("directional_derivatives", references_of(unknowns), references_of([known]), [1.0])


def other_quotients(derivative: float, quotients: Sequence[float], rounding: float) -> str:
    """Returns the range of difference quotients, as text, if a derivative lies outside of it."""
    tolerance = AGREEMENT * max([abs(derivative), *map(abs, quotients)]) + rounding
    low, high = min(quotients, default=-math.inf), max(quotients, default=math.inf)
    return "" if low - tolerance <= derivative <= high + tolerance else f"{low:.9g}..{high:.9g}"


def _quotients(
    probe: Probe, known: Variable, unknowns: list[Variable], before: float, sign: int, middle: Reading
) -> dict[str, float]:
    """Returns difference quotients of all unknowns on one side; none where the FMU refuses the value."""
    low, high = known.number("min"), known.number("max")
    value = before + sign * DIFFERENCE * max(1.0, abs(before))
    if (low is not None and value < low) or (high is not None and value > high):
        return {}
    script = probe.script().initialise()
    script.set(known, value)
    after = script.read(unknowns)
    script.play(keep_going=True)
    if script.failure:
        return {}
    return {name: (after.values[name] - x) / (value - before) for name, x in middle.values.items()}


@behaviour_rule(DIRECTIONAL, condition=PROVIDES, needs="directional-derivatives questions-change-nothing")
def directional_derivatives_are_linear(probe: Probe) -> Iterator[str]:
    """A directional derivative is the sum of the partial derivatives, each times its seed, in every mode."""
    initial = [v for v, *_ in probe.fmu.dependencies["InitialUnknowns"] if v.kind == "Real"]
    outputs, states = continuous_reals(probe, "output"), states_of(probe.fmu)
    inputs = {v.index: v for v in continuous_reals(probe, "input")}
    at_first = inputs | {i: probe.fmu.variables[i - 1] for i in _pairs(probe.fmu)}
    later = inputs | {v.index: v for v in states}
    if not (initial and at_first) and not (outputs and later):
        raise NotApplicableError("there is no Real known, or neither an output nor an initial unknown")
    for unknowns, knowns, stepping in ((initial, at_first, False), (outputs, later, True)):
        if unknowns and knowns:
            yield from _other_sums(probe, unknowns, list(knowns.values())[:MOST_KNOWNS], stepping)


def _other_sums(
    probe: Probe, unknowns: list[Variable], knowns: list[Variable], stepping: bool
) -> Iterator[str]:
    seed = [2.5 + 0.5 * i for i in range(len(knowns))]
    script = _in_mode(probe, stepping)
    alone = [derivatives_by(script, unknowns, known) for known in knowns]
    together = script.call("directional_derivatives", references_of(unknowns), references_of(knowns), seed)
    script.play()
    for i, (v, got) in enumerate(zip(unknowns, together.value, strict=True)):
        parts = [s * reply.value[i] for s, reply in zip(seed, alone, strict=True)]
        if not abs(got - sum(parts)) <= _LINEAR * max([1e-300, abs(got), *map(abs, parts)]):
            shown = texts(got, sum(parts))
            yield (
                f"the directional derivative of {v.name} is {shown[0]} in the state "
                f"{script.state!r}: expected {shown[1]}, the sum of its parts"
            )


def _in_mode(probe: Probe, stepping: bool) -> Script:
    """Returns a script in step mode, after a step, or in initialization mode."""
    script = probe.script(logging=True)
    return script.begin().step() if stepping else script.initialise()


@behaviour_rule(
    DIRECTIONAL, condition=PROVIDES, needs="directional-derivatives initial-dependencies-are-declared"
)
def directional_derivatives_are_zero_without_dependency(probe: Probe) -> Iterator[str]:
    """The derivative with respect to an input, in step mode also to a continuous state, that is not among
    the dependencies of an output or a state derivative is zero.
    """
    inputs = continuous_reals(probe, "input")
    knowns = {"InitialUnknowns": inputs, "Outputs": [*inputs, *states_of(probe.fmu)]}
    knowns["Derivatives"] = knowns["Outputs"]
    for section in knowns:
        for unknown, stated, _ in probe.fmu.dependencies[section]:
            observed = unknown.causality == "output" or section == "Derivatives"
            if stated is None or unknown.kind != "Real" or not observed:
                continue
            indices = {*stated, unknown.index}
            listed = {(v.base_kind, v.reference) for v in probe.fmu.variables if v.index in indices}
            others = [v for v in knowns[section] if (v.base_kind, v.reference) not in listed][:MOST_KNOWNS]
            script = _in_mode(probe, stepping=section != "InitialUnknowns")
            replies = [derivatives_by(script, [unknown], known) for known in others]
            script.play(keep_going=True)
            for known, reply in zip(others, replies, strict=True):
                if reply.ok and reply.value[0] != 0.0:
                    yield (
                        f"d {unknown.name} / d {known.name} is {reply.value[0]:.9g} in the state "
                        f"{script.state!r}: expected 0, as {section} lists no such dependency"
                    )


def states_of(fmu: FmuFile) -> list[Variable]:
    """Returns the continuous states that Derivatives exposes."""
    indices = [integer(v.typed.get("derivative")) for v, *_ in fmu.dependencies["Derivatives"]]
    return [fmu.variables[i - 1] for i in indices if i is not None and 1 <= i <= len(fmu.variables)]
