"""Effects of variables on others: what ModelStructure and directional derivatives say of them, beside finite
differences.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.actions import Pair
from fmus.compliance.differential import starts
from fmus.compliance.fmu_file import CO_SIMULATION, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.rules.finite_differences import ANY_STEP, NOISE, Column, followers, in_steps, values_of
from fmus.compliance.script import Action, CallError, Reply, Script
from fmus.compliance.values import continuous_reals, other_values, references_of, same, start_value, texts
from fmus.compliance.variable import Variable

_PARTIAL = "2.1.9"
_PROVIDES = values.unless_claimed("providesDirectionalDerivative")
_partial_rule = partial(behaviour_rule, _PARTIAL, _PROVIDES)
_AT_FIRST, _STEPPING = ("InitialUnknowns",), ("Outputs", "Derivatives")
_INITIALIZATION, _STEP = (do.initialise,), (do.begin, do.step())
_MOST_KNOWNS, _MOST_DERIVED, _MOST_INPUTS = 100, 40, 20  # of one FMU: each costs runs
_DIFFERENCE = 1e-6  # relative change for a difference quotient: half the digits for truncation and rounding
_AGREEMENT = 1e-4  # relative; a wrong derivative is wrong by much more
_LINEAR = 1e-6  # relative: of difference quotients
_SUMMED = 1e-3  # relative: derivatives may be difference quotients of one side (2.1.9)
_CANCELLED = 1e-12  # times a seed: parts that are 0 alone leave roundings of terms that cancel
_SELDOM = ("constant", "fixed", "tunable")  # kinds of a factor that does not change with every input
_PARTS = (1.0, 0.1, 0.01)  # of a step: an effect through a state shrinks with them
_STAYS, _ENDS = 0.5, 0.1  # of an effect: in a short step, and a step after its cause has gone
_TO_BE_LISTED = "expected that among its dependencies"


class _Factor(NamedTuple):
    """An unknown, a known on which it depends, and the kind of this dependency."""

    unknown: Variable
    known: Variable
    kind: str


_Group = tuple[Variable, Sequence[Variable]]
"""A known with unknowns."""


def _factors(
    fmu: FmuFile, sections: Sequence[str], knowns: Iterable[Variable], stated: bool = False
) -> Iterator[_Factor]:
    """Yields those of Real unknowns and knowns, each once.

    stated: only what is listed; otherwise an unknown that lists nothing depends on all knowns
    """
    by_index = {v.index: v for v in knowns if v.kind == "Real"}
    for section in sections:
        for unknown, listed, kinds in fmu.dependencies[section]:
            kind_of = dict(zip(listed or (), kinds, strict=False))
            chosen = by_index.keys() if listed is None and not stated else by_index.keys() & set(listed or ())
            for index in sorted(chosen - {unknown.index}) if unknown.kind == "Real" else ():
                yield _Factor(unknown, by_index[index], kind_of.get(index, ""))


def _by_known(factors: Iterable[_Factor], most: int = _MOST_DERIVED) -> Sequence[_Group]:
    """Returns each known with its unknowns, each once."""
    groups: dict[int, tuple[Variable, dict[int, Variable]]] = {}
    for unknown, known, _ in factors:
        groups.setdefault(known.index, (known, {}))[1][unknown.index] = unknown
    return [(known, list(unknowns.values())) for known, unknowns in groups.values()][:most]


def _states(fmu: FmuFile) -> list[Variable]:
    """Returns the continuous states that Derivatives exposes."""
    return [fmu.variables[index - 1] for index in fmu.state_derivatives.values()]


# dependencies


@behaviour_rule("2.2.8")
def dependencies_are_declared(probe: Probe) -> Iterator[str]:
    """An initial unknown changes only with the knowns that its dependencies list; for model exchange, so do
    outputs and derivatives in event mode.
    """
    inputs = [v for v in probe.fmu.variables if v.causality == "input"]
    settable = values.settable_in_initialization(probe.fmu)
    begin: Sequence[Action] = _INITIALIZATION
    modes = [("initialization mode", begin, "InitialUnknowns", settable)]
    for start in starts(probe) if probe.fmu.is_model_exchange else ():
        mode, begin = f"event mode{start.words}", (do.begin, *start.lead)
        modes += [(mode, begin, section, inputs) for section in _STEPPING]
    for mode, actions, section, knowns in modes:
        for known, value in other_values(knowns[:_MOST_KNOWNS]):
            unlisted = [
                unknown
                for unknown, listed, _ in probe.fmu.dependencies[section]
                if listed is not None and known.index not in listed and unknown.name != known.name
            ]
            read = [do.read(unlisted)]
            for name in sorted(followers(probe, actions, known, value, read) if unlisted else ()):
                yield f"{name} changes with {known.name} in {mode}: {_TO_BE_LISTED}"


@behaviour_rule("2.2.8")
def dependencies_on_time_are_declared(probe: Probe) -> Iterator[str]:
    """An initial unknown changes with the start time only if it lists the independent variable, where that is
    defined.
    """
    independent = {v.index for v in probe.fmu.variables if v.causality == "independent"}
    if not independent:
        raise NotApplicableError("no variable is independent")
    initial = probe.fmu.dependencies["InitialUnknowns"]
    unlisted = [v for v, listed, _ in initial if listed is not None and not {*listed} & independent]
    set_up = [do.call("set_up_experiment", probe.point(i), None) for i in (0, 1)]
    runs = values_of(probe, [(call, do.enter_initialization_mode, do.read(unlisted)) for call in set_up])
    if not all(runs):
        raise NotJudgedError("a run up to initialization mode, in which initial unknowns are read, fails")
    (before,), (after,) = runs
    for name in [name for name, x in before.items() if not same(x, after[name], NOISE)]:
        yield f"{name} changes with the start time: expected the independent variable in its dependencies"


@behaviour_rule("advice: 2.2.8, a direct dependency is told from one step's delay by no call")
def outputs_follow_declared_inputs_alone(probe: Probe) -> Iterator[str]:
    """In step mode an input has no direct effect on an output that lists others: one that stays as steps
    become short and ends with the input.
    """
    # 4.2.4 allows no reading between setting an input and the next step
    inputs = [v for v in probe.fmu.variables if v.causality == "input"]
    indices = {v.index for v in inputs}
    parts = _PARTS if probe.fmu.claims(ANY_STEP) else _PARTS[:1]
    for v, value in other_values(inputs[:_MOST_INPUTS]):
        unlisted = [
            unknown.name
            for unknown, listed, _ in probe.fmu.dependencies["Outputs"]
            if listed is not None and indices & set(listed) and v.index not in listed
        ]
        effects = [_direct_effects(probe, v, value, part) for part in parts] if unlisted else []
        for name in sorted(unlisted):
            sizes = [effect.get(name, 0.0) for effect in effects]
            if all(sizes) and sizes[-1] > _STAYS * sizes[0]:
                yield f"{name} changes with {v.name} in a step, however short: {_TO_BE_LISTED}"


@behaviour_rule("4.2.1", interface=CO_SIMULATION)
def inputs_act_in_the_next_step(probe: Probe) -> Iterator[str]:
    """An output that an input changes at once in initialization mode changes with it in the step after it was
    set, and not only one step later, when the input has its old value again.
    """
    for v, value in other_values([v for v in probe.fmu.variables if v.causality == "input"][:_MOST_INPUTS]):
        direct = followers(probe, _INITIALIZATION, v, value, [do.read(probe.outputs)])
        start = start_value(v)
        runs = [in_steps(probe, v, (x, start), probe.step_size) for x in (start, value)] if direct else []
        (now, later), (changed, then) = r if all(r := values_of(probe, runs)) and r else (({}, {}),) * 2
        for name in sorted(direct & now.keys()):
            if now[name] == changed[name] and later[name] != then[name]:
                yield f"{name} follows {v.name} one step late: expected that in the step after it was set"


def _direct_effects(probe: Probe, v: Variable, value: Any, part: float) -> dict[str, float]:
    """Returns the outputs that another value of an input changes in a step of a part of the step size, and
    that are as before one step after it, each with the size of its change.
    """
    start, size = start_value(v), part * probe.step_size
    runs = values_of(probe, [in_steps(probe, v, (x, start), size) for x in (start, value)])
    (usual, now), (changed, then) = runs if all(runs) else (({}, {}),) * 2
    effects = {name: _distance(x, changed[name]) for name, x in usual.items()}
    return {
        name: effect
        for name, effect in effects.items()
        if math.isfinite(effect) and not same(usual[name], changed[name], NOISE)
        if _distance(now[name], then[name]) <= _ENDS * effect
    }


def _distance(a: Any, b: Any) -> float:
    """Returns how far two values are apart: 1 if they differ and are no Reals."""
    return abs(a - b) if isinstance(a, float) else float(a != b)


@behaviour_rule("2.2.8")
def constant_factors_are_constant(probe: Probe) -> Iterator[str]:
    """An initial unknown changes with a known of the kind constant by the same factor everywhere, whatever
    the inputs are.
    """
    knowns = values.settable_in_initialization(probe.fmu)
    inputs = other_values(v for v in knowns if v.causality == "input")
    initial = {unknown.index for unknown, *_ in probe.fmu.dependencies["InitialUnknowns"]}
    factors = _factors(probe.fmu, ("InitialUnknowns", "Outputs"), knowns, stated=True)
    constant = (f for f in factors if f.kind == "constant" and f.unknown.index in initial)
    for known, unknowns in _by_known(constant, _MOST_KNOWNS):
        start, value = start_value(known), values.other_value(known)
        if not isinstance(start, float) or value is None:
            continue
        column = partial(Column, probe, _INITIALIZATION, known, after=[do.read(unknowns)])
        here, there = column((start, value, 2 * value - start)), column((start, value), point=inputs)
        for v in unknowns if here.is_whole and there.is_whole else ():
            quotients = [*here.quotients(v.name), *there.quotients(v.name)]
            margin = _LINEAR * max(map(abs, quotients)) + here.rounding(v.name) + there.rounding(v.name)
            if math.isfinite(margin) and max(quotients) - min(quotients) > margin:
                yield f"the factor of {known.name} in {v.name} is not constant: its dependenciesKind is"


# directional derivatives


def _derive(
    unknowns: Sequence[Variable], knowns: Sequence[Variable], seed: Sequence[float] = (1.0,)
) -> Action:
    return do.call("directional_derivatives", references_of(unknowns), references_of(knowns), list(seed))


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
    return _beside_quotients(probe, (), _by_known(_initial_factors(probe.fmu)))


def _initial_factors(fmu: FmuFile) -> Iterator[_Factor]:
    derivatives = {index for index, _ in fmu.unknowns("Derivatives")}
    for factor in _factors(fmu, _AT_FIRST, values.settable_in_initialization(fmu)):
        v = factor.unknown
        if v.causality in ("output", "calculatedParameter") or v.index in derivatives:
            yield factor


@_partial_rule()
def directional_derivatives_in_step_mode(probe: Probe) -> Iterator[str]:
    """After initialisation with other values, the derivatives of continuous outputs and state derivatives in
    step mode lie near difference quotients: those of runs with other inputs and states at first.
    """
    settable = [v for v in values.settable_in_initialization(probe.fmu) if v.kind == "Real"]
    states = {v.index for v in _states(probe.fmu)}
    knowns = (v for v in settable if v.causality == "input" or v.index in states)
    factors = (f for f in _factors(probe.fmu, _STEPPING, knowns) if f.unknown.variability == "continuous")
    point = do.others_accepted(probe, settable, do.initialise)
    return _beside_quotients(probe, (do.exit_initialization_mode,), _by_known(factors), point)


def _beside_quotients(
    probe: Probe, exit_mode: Sequence[Action], groups: Sequence[_Group], others: Sequence[Pair] = ()
) -> Iterator[str]:
    """Yields messages of derivatives outside of difference quotients where knowns have their start values, or
    others. Raises CallError for a derivative that is refused at the start values.
    """
    point = {v.index: (v, x) for v, x in (*values.start_values(known for known, _ in groups), *others)}
    judged = [(known, unknowns) for known, unknowns in groups if known.index in point]
    replies = _derivatives(probe, (*_INITIALIZATION, do.set_values(point.values()), *exit_mode), judged)
    refused = next((reply for reply in replies if not reply.ok), None)
    if refused and not exit_mode:
        raise CallError(refused.problem)
    # 4.2.4 lets only outputs and initial unknowns be read in initialization mode
    states = _states(probe.fmu) if exit_mode else []
    read = do.read({v.index: v for v in (*(v for _, group in judged for v in group), *states)}.values())
    for (known, unknowns), reply in zip(judged, replies, strict=True):
        _, start = point[known.index]
        width = _DIFFERENCE * max(1.0, abs(start))
        xs = [start, *(x for x in (start - width, start + width) if known.low <= x <= known.high)]
        column = Column(probe, _INITIALIZATION, known, xs, (*exit_mode, read), others)
        if not reply.ok or column.xs[:1] != [start] or len(column.xs) < 2:
            continue
        if column.changed(0.0) & {v.name for v in states if v is not known}:  # they follow the known at once
            continue
        where = f" in the state {reply.state!r}" if exit_mode else ""
        for v, derivative in zip(unknowns, reply.value, strict=True):
            quotients = column.quotients(v.name)
            low, high = min(quotients), max(quotients)
            margin = _AGREEMENT * max(map(abs, [derivative, low, high])) + column.rounding(v.name) + NOISE
            if math.isfinite(high - low) and not low - margin <= derivative <= high + margin:
                got = f"d {v.name} / d {known.name} is {derivative:.9g}{where}"
                yield f"{got}: expected {low:.9g}..{high:.9g}"


@_partial_rule()
def directional_derivatives_are_linear(probe: Probe) -> Iterator[str]:
    """A directional derivative is the sum of the partial derivatives, each times its seed, in every mode."""
    initial = [v for v, *_ in probe.fmu.dependencies["InitialUnknowns"] if v.kind == "Real"]
    inputs, at_first = continuous_reals(probe, "input"), _by_known(_initial_factors(probe.fmu))
    modes = (
        (_INITIALIZATION, initial, [*inputs, *(known for known, _ in at_first)]),
        (_STEP, continuous_reals(probe, "output"), [*inputs, *_states(probe.fmu)]),
    )
    judged = [(mode, unknowns, knowns) for mode, unknowns, knowns in modes if unknowns and knowns]
    if not judged:
        raise NotApplicableError("there is no Real known, or neither an output nor an initial unknown")
    for mode, unknowns, knowns in judged:
        chosen = list({v.index: v for v in knowns}.values())[:_MOST_DERIVED]
        yield from _other_sums(probe.script(*mode, logging=True), unknowns, chosen)


def _other_sums(script: Script, unknowns: list[Variable], knowns: list[Variable]) -> Iterator[str]:
    seed = [2.5 + 0.5 * i for i in range(len(knowns))]
    partials = [_derive(unknowns, [known]) for known in knowns]
    *alone, together = script.write([*partials, _derive(unknowns, knowns, seed)])
    script.play()
    for i, (v, got) in enumerate(zip(unknowns, together.value, strict=True)):
        parts = [s * reply.value[i] for s, reply in zip(seed, alone, strict=True)]
        if not abs(got - sum(parts)) <= _SUMMED * max([abs(got), *map(abs, parts)]) + _CANCELLED * seed[-1]:
            shown, what = texts(got, sum(parts)), f"the directional derivative of {v.name}"
            where = f"in the state {together.state!r}"
            yield f"{what} is {shown[0]} {where}: expected {shown[1]}, the sum of its parts"


@_partial_rule()
def directional_derivatives_are_zero_without_dependency(probe: Probe) -> Iterator[str]:
    """The derivative with respect to an input, in step mode also to a continuous state, that is not among
    the dependencies of an output or a state derivative is zero.
    """
    inputs, states = continuous_reals(probe, "input"), _states(probe.fmu)
    for section in (*_AT_FIRST, *_STEPPING):
        mode, knowns = (_STEP, [*inputs, *states]) if section in _STEPPING else (_INITIALIZATION, inputs)
        groups = list(_unlisted(probe.fmu, section, knowns))
        for (known, (unknown,)), reply in zip(groups, _derivatives(probe, mode, groups), strict=True):
            if reply.ok and reply.value[0] != 0.0:
                got = (
                    f"d {unknown.name} / d {known.name} is {reply.value[0]:.9g} in the state {reply.state!r}"
                )
                yield f"{got}: expected 0, as {section} lists no such dependency"


def _unlisted(fmu: FmuFile, section: str, knowns: Sequence[Variable]) -> Iterator[_Group]:
    """Yields knowns, each with an output or state derivative that lists others and not this one."""
    for unknown, stated, _ in fmu.dependencies[section]:
        is_observed = unknown.causality == "output" or section == "Derivatives"
        if stated is not None and unknown.kind == "Real" and is_observed:
            indices = {*stated, unknown.index}
            listed = {(v.base_kind, v.reference) for v in fmu.variables if v.index in indices}
            others = [v for v in knowns if (v.base_kind, v.reference) not in listed]
            yield from ((known, [unknown]) for known in others[:_MOST_DERIVED])


@behaviour_rule("2.2.8", _PROVIDES)
def factors_change_as_declared(probe: Probe) -> Iterator[str]:
    """In step mode a factor that is constant or fixed is the same when inputs, states and tunable parameters
    have changed, and a tunable one when inputs and states have.
    """
    knowns = [v for v in probe.fmu.variables if v.causality != "independent"]
    factors = [f for f in _factors(probe.fmu, _STEPPING, knowns, stated=True) if f.kind in _SELDOM]
    if not factors:
        raise NotApplicableError("no dependency is of the kind constant, fixed or tunable")
    settable = values.settable_while_stepping(probe.fmu)
    inputs = [v for v in settable if v.causality == "input"]
    for kinds, changed in ((_SELDOM[:2], settable), (_SELDOM[2:], inputs)):
        judged = [f for f in factors if f.kind in kinds][:_MOST_DERIVED]
        groups = [(f.known, [f.unknown]) for f in judged]
        others = do.others_accepted(probe, changed, do.begin) if judged else []
        first = _derivatives(probe, _STEP, groups)
        later = _derivatives(probe, (do.begin, do.set_values(others), do.step(3)), groups)
        for (u, k, kind), one, other in zip(judged, first, later, strict=True):
            if one.ok and other.ok and not same(one.value[0], other.value[0], _AGREEMENT, 1e-12):
                shown = texts(other.value[0], one.value[0])
                yield f"d {u.name} / d {k.name} is {shown[0]} and was {shown[1]}: its factor is said {kind}"
