"""Dependencies of ModelStructure and directional derivatives, compared with finite differences."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import starts
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.rules.derivatives import NOISE, columns, followers, values_of
from fmus.compliance.rules.events import discrete_variables
from fmus.compliance.script import Action, CallError, Reply
from fmus.compliance.variable import Unknown, Variable

_provides = values.unless_claimed("providesDirectionalDerivative")
_partial_rule = partial(behaviour_rule, "2.1.9", _provides)
_AT_FIRST, _STEPPING = ("InitialUnknowns",), ("Outputs", "Derivatives")
_INITIALIZATION, _STEP = (do.initialise,), (do.begin, do.step())
_MOST_KNOWNS, _MOST_DERIVED = 100, 40  # of one FMU: each costs runs
_DIFFERENCE = 1e-6  # relative change for a difference quotient: half the digits for truncation and rounding
_AGREEMENT = 1e-4  # relative; a wrong derivative is wrong by much more
_SUMMED = 1e-3  # relative: derivatives may be difference quotients of one side (2.1.9)
_CANCELLED = 1e-12  # times a seed: parts that are 0 alone leave roundings of terms that cancel
_TO_BE_LISTED = "expected that among its dependencies"


_Group = tuple[Variable, Sequence[Variable]]
"""A known with unknowns."""


def _by_known(
    fmu: FmuFile, sections: Sequence[str], knowns: Iterable[Variable], is_judged: Callable[[Variable], bool]
) -> Sequence[_Group]:
    """Returns each Real known with the Real unknowns that depend on it and are judged, each once; an unknown
    that lists nothing depends on all knowns.
    """
    unknowns = (unknown for section in sections for unknown in fmu.unknowns[section])
    chosen = [u for u in unknowns if _is_precise(u.variable) and is_judged(u.variable)]
    groups = ((known, _depending(chosen, known)) for known in filter(_is_precise, knowns))
    return list(itertools.islice((group for group in groups if group[1]), _MOST_DERIVED))


def _depending(unknowns: Iterable[Unknown], known: Variable) -> Sequence[Variable]:
    depending = (u.variable for u in unknowns if u.depends_on(known))
    return list({v.index: v for v in depending if v is not known}.values())


def _is_precise(v: Variable) -> bool:
    """Whether difference quotients of a variable have enough digits."""
    return v.kind == "Real" and not v.is_single


# dependencies


@behaviour_rule("2.2.8")
def dependencies_are_declared(probe: Probe) -> Iterator[str]:
    """An initial unknown changes only with the knowns that its dependencies list; for model exchange, so do
    outputs and derivatives in event mode.
    """
    inputs = [v for v in probe.fmu.variables if v.causality == "input"]
    settable = probe.fmu.settable_in_initialization
    begin: Sequence[Action] = _INITIALIZATION
    modes = [("initialization mode", begin, "InitialUnknowns", settable)]
    for start in starts(probe) if probe.fmu.is_model_exchange else ():
        begin = do.begin, *start.lead, do.set_values(values.start_values(inputs))
        modes += [(f"event mode{start.words}", begin, section, inputs) for section in _STEPPING]
    for mode, actions, section, knowns in modes:
        unknowns, pairs = probe.fmu.unknowns[section], values.other_values(knowns[:_MOST_KNOWNS])
        read, taken = do.read([u.variable for u in unknowns]), do.accepted_together(probe, pairs, *actions)
        back = [do.set_values(values.start_values([v])) for v, _ in taken]
        sets = itertools.chain(*((do.set_values([p]), read, b) for p, b in zip(taken, back, strict=True)))
        (run,) = values_of(probe, [(*actions, read, *sets)])
        pairs = [*taken, *(pair for pair in pairs if pair not in taken)]
        for i, (known, value) in enumerate(pairs):
            unlisted = [u.variable for u in unknowns if not u.depends_on(known) and u.variable is not known]
            names = {v.name for v in unlisted}
            if i + 1 >= len(run) or any(run[0][name] != run[i + 1][name] for name in names):
                changed = followers(probe, actions, known, value, [do.read(unlisted)])
                for name in sorted(changed):
                    yield f"{name} changes with {known.name} in {mode}: {_TO_BE_LISTED}"


# directional derivatives


def _derive(
    unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float] = (1.0,)
) -> Action:
    return do.call(
        "directional_derivatives", values.references_of(unknowns), values.references_of(knowns), list(seed)
    )


def _derivatives(probe: Probe, mode: Iterable[Action], groups: Iterable[_Group]) -> list[Reply]:
    """Returns replies with the derivatives of unknowns by each known, after some actions."""
    script = probe.script(*mode, logging=True)
    replies = script.write(_derive(unknowns, [known]) for known, unknowns in groups)
    probe.play_once([script])
    return replies


@_partial_rule()
def directional_derivatives(probe: Probe) -> Iterator[str]:
    """In initialization mode, derivatives of outputs, calculated parameters and state derivatives lie between
    difference quotients of both sides.
    """
    return _beside_quotients(probe, (), _groups_at_first(probe.fmu))


def _groups_at_first(fmu: FmuFile) -> Sequence[_Group]:
    derivatives = {unknown.variable.index for unknown in fmu.unknowns["Derivatives"]}

    def is_judged(v: Variable) -> bool:
        return v.causality in ("output", "calculatedParameter") or v.index in derivatives

    return _by_known(fmu, _AT_FIRST, fmu.settable_in_initialization, is_judged)


@_partial_rule()
def directional_derivatives_in_step_mode(probe: Probe) -> Iterator[str]:
    """The derivatives of continuous outputs and state derivatives lie near difference quotients: for
    co-simulation after initialisation with other values, between runs with other inputs and initial states;
    for model exchange in continuous-time mode, with other inputs and states. In event mode they are the same.
    """
    settable = [v for v in probe.fmu.settable_in_initialization if v.kind == "Real"]
    states = probe.fmu.state_variables
    if probe.fmu.is_model_exchange:
        knowns = [*values.continuous_reals(probe, "input"), *states]
    else:
        knowns = [v for v in settable if v.causality == "input" or v in states]
    groups = _by_known(probe.fmu, _STEPPING, knowns, lambda v: v.variability == "continuous")
    if not probe.fmu.is_model_exchange:
        point = do.others_accepted(probe, settable, do.initialise)
        yield from _beside_quotients(probe, (do.exit_initialization_mode,), groups, point)
        return
    modes = (do.begin,), (do.begin, do.enter_continuous_time_mode)
    early, late = (_derivatives(probe, mode, groups) for mode in modes)
    for (known, unknowns), a, b in zip(groups, early, late, strict=True):
        for v, x, y in zip(unknowns, a.value, b.value, strict=True) if a.ok and b.ok else ():
            if not values.same(x, y, _AGREEMENT, NOISE / _AGREEMENT):
                got = f"d {v.name} / d {known.name} is {x:.9g} in event mode"
                yield f"{got}: expected {y:.9g}, as in continuous-time mode after it"
    # Integers and Booleans would lead to other cases
    reals = [v for v in probe.fmu.settable_while_stepping if v.kind == "Real"]
    others = do.set_values(do.others_accepted(probe, reals, do.begin, do.step()))
    for lead in ((do.leap(2, True), others, do.step()), *(start.lead for start in starts(probe)[1:])):
        begin = do.begin, *lead, do.enter_continuous_time_mode
        (run,) = values_of(probe, [(*begin, do.read(knowns))])
        point = [(v, run[0][v.name]) for v in knowns if run]
        # a known at a limit stays there, and its derivative may belong to the side beyond
        inside = [v for v, x in point if v.low < x < v.high]
        here = [group for group in groups if group[0] in inside]
        yield from _beside_quotients(probe, (do.set_time,), here, point, begin)


def _beside_quotients(
    probe: Probe, exit_mode: Sequence[Action], groups: Sequence[_Group], others: Sequence[do.Pair] = (),
    begin: Sequence[Action] = _INITIALIZATION,
) -> Iterator[str]:  # fmt: skip
    """Yields messages of derivatives outside of difference quotients where knowns have their start values, or
    others. Raises CallError for a derivative that is refused at the start values.

    begin: leads to where values are set; exit_mode: from there to where unknowns are read
    """
    point = {v.index: (v, x) for v, x in (*values.start_values(known for known, _ in groups), *others)}
    judged = [(known, unknowns) for known, unknowns in groups if known.index in point]
    replies = _derivatives(probe, (*begin, do.set_point(point.values()), *exit_mode), judged)
    refused = next((reply for reply in replies if not reply.ok), None)
    if refused and not exit_mode:
        raise CallError(refused.problem)
    # 4.2.4 allows reading only outputs and initial unknowns in initialization mode
    held = [*probe.fmu.state_variables, *discrete_variables(probe.fmu)] if exit_mode else []
    read = do.read({v.index: v for v in (*(v for _, group in judged for v in group), *held)}.values())
    knowns = list[tuple[Variable, Sequence[float]]]()
    for known, _ in judged:
        _, start = point[known.index]
        width = _DIFFERENCE * max(1.0, abs(start))
        sides = [x for x in (start - width, start + width) if known.low <= x <= known.high]
        knowns.append((known, [start, *sides]))
    in_turn = begin != _INITIALIZATION
    found = columns(probe, begin, knowns, (*exit_mode, read), others, in_turn)
    for (known, unknowns), reply, column in zip(judged, replies, found, strict=True):
        if not reply.ok or column.xs[:1] != [point[known.index][1]] or len(column.xs) < 2:
            continue
        # the difference quotient then crosses an event or moves a state
        if column.changed(0.0) & {v.name for v in held if v is not known}:
            continue
        where = f" in the state {reply.state!r}" if exit_mode else ""
        for v, derivative in zip(unknowns, reply.value, strict=True):
            quotients = column.quotients(v.name)
            low, high = min(quotients), max(quotients)
            margin = _AGREEMENT * max(map(abs, [derivative, low, high])) + column.rounding(v) + NOISE
            if math.isfinite(high - low) and not low - margin <= derivative <= high + margin:
                got = f"d {v.name} / d {known.name} is {derivative:.9g}{where}"
                yield f"{got}: expected {low:.9g}..{high:.9g}"


@_partial_rule()
def directional_derivatives_are_linear(probe: Probe) -> Iterator[str]:
    """A directional derivative is the sum of the partial derivatives, each times its seed, in every mode; one
    with respect to an input or a state that is not among the dependencies of an output or a state derivative
    is zero.
    """
    unknowns = {section: probe.fmu.unknowns[section] for section in (*_AT_FIRST, *_STEPPING)}
    inputs, at_first = values.continuous_reals(probe, "input"), _groups_at_first(probe.fmu)
    late = [(do.begin, *start.lead) for start in starts(probe)[1:]]
    modes = (
        (_INITIALIZATION, _AT_FIRST, [*inputs, *(known for known, _ in at_first)]),
        *((way, _STEPPING, [*inputs, *probe.fmu.state_variables]) for way in (_STEP, *late)),
    )
    judged = [
        (mode, [u for name in sections for u in unknowns[name] if _is_precise(u.variable)], knowns)
        for mode, sections, knowns in modes
    ]
    judged = [(mode, chosen, knowns) for mode, chosen, knowns in judged if chosen and knowns]
    if not judged:
        raise NotApplicableError("there is no Real known, or neither an output nor an initial unknown")
    for mode, chosen, knowns in judged:
        distinct = list({v.index: v for v in knowns}.values())[:_MOST_DERIVED]
        yield from _other_sums(probe, mode, chosen, distinct)


def _other_sums(
    probe: Probe, mode: Iterable[Action], unknowns: Sequence[Unknown], knowns: Sequence[Variable]
) -> Iterator[str]:
    seed = [2.5 + 0.5 * i for i in range(len(knowns))]
    variables = [unknown.variable for unknown in unknowns]
    script = probe.script(*mode, logging=True)
    partials = [_derive(variables, [known]) for known in knowns]
    *alone, together = script.write([*partials, _derive(variables, knowns, seed)])
    script.play()
    where = f"in the state {together.state!r}"
    for i, (unknown, got) in enumerate(zip(unknowns, together.value, strict=True)):
        v, row = unknown.variable, [reply.value[i] for reply in alone]
        parts = [s * x for s, x in zip(seed, row, strict=True)]
        if abs(got - sum(parts)) > _SUMMED * max([abs(got), *map(abs, parts)]) + _CANCELLED * seed[-1]:
            shown, what = values.texts(got, sum(parts)), f"the directional derivative of {v.name}"
            yield f"{what} is {shown[0]} {where}: expected {shown[1]}, the sum of its parts"
        if v.causality != "output" and unknown.section != "Derivatives":
            continue
        for known, x in zip(knowns, row, strict=True):
            if abs(x) > 0.0 and not any(
                a is v or unknown.depends_on(a) for a in probe.fmu.aliases[known.base_kind, known.reference]
            ):
                lists = f"expected 0, as {unknown.section} lists no such dependency"
                yield f"d {v.name} / d {known.name} is {x:.9g} {where}: {lists}"
