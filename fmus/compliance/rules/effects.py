"""Effects of variables on others: what ModelStructure and directional derivatives say of them, beside what
runs show that differ in the value of one variable alone.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, TypeVar

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.script import Reading, Reply, Script
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
from fmus.compliance.variable import Variable

T = TypeVar("T")
Point = Sequence[tuple[Variable, Any]]
Factor = tuple[Variable, Variable, str]
"""An unknown, a known on which it depends, and the kind of this dependency."""

_PARTIAL = "2.1.9 Getting Partial Derivatives"
_STRUCTURE = "2.2.8 Definition of the Model Structure (ModelStructure)"
_PROVIDES = unless_claimed("providesDirectionalDerivative")
_ANY_STEP = "canHandleVariableCommunicationStepSize"
_AT_FIRST, _STEPPING = ("InitialUnknowns",), ("Outputs", "Derivatives")
_MOST_KNOWNS, _MOST_DERIVED = 100, 40  # of one FMU: each costs two runs, with derivatives three
_MOST_INPUTS, _MOST_CHANGED = 20, 50
_DIFFERENCE = 1e-6  # relative change for a difference quotient: half the digits for truncation and rounding
_AGREEMENT = 1e-4  # relative; a wrong derivative is wrong by much more
_LINEAR = 1e-6  # relative: of changes of values
_SUMMED = 1e-3  # relative: derivatives may be difference quotients of one side (2.1.9)
_NOISE = 1e-9  # an iteration may stop elsewhere: relative to a value; of derivatives as it is
_CLOSE, _SHARE = 1e-6, 0.1  # of a change: two values that are as close give changes that are as equal
_SELDOM = ("constant", "fixed", "tunable")  # kinds of a factor that does not change with every input
_PARTS = (1.0, 0.1, 0.01)  # of a step: an effect through a state shrinks with them
_STAYS, _ENDS = 0.5, 0.1  # of an effect: in a short step, and a step after its cause has gone


def _runs(
    probe: Probe,
    begun: Callable[[], Script],
    known: Variable,
    values: Sequence[Any],
    read: Callable[[Script], T],
    point: Point = (),
) -> list[tuple[Script, T]]:
    """Returns runs that differ in the value of one variable alone, played, each with what it has read.

    begun: a new script, up to where values are set; values: None is not set; point: values of other variables
    """
    runs = []
    for value in values:
        script = begun()
        for v, x in [*(pair for pair in point if pair[0] is not known), (known, value)]:
            if x is not None:
                script.set(v, x)
        runs.append((script, read(script)))
    probe.play_each([script for script, _ in runs])
    return runs


def _factors(
    fmu: FmuFile, sections: Sequence[str], knowns: Iterable[Variable], stated: bool = False
) -> Iterator[Factor]:
    """Yields those of Real unknowns and knowns, each once.

    stated: only what is listed; otherwise an unknown that lists nothing depends on all knowns
    """
    by_index = {v.index: v for v in knowns if v.kind == "Real"}
    for section in sections:
        for unknown, listed, kinds in fmu.dependencies[section]:
            kind_of = dict(zip(listed or (), kinds, strict=False))
            chosen = by_index.keys() if listed is None and not stated else by_index.keys() & set(listed or ())
            for index in sorted(chosen - {unknown.index}) if unknown.kind == "Real" else ():
                yield unknown, by_index[index], kind_of.get(index, "")


def _by_known(factors: Iterable[Factor]) -> list[tuple[Variable, list[Variable]]]:
    """Returns each known with its unknowns, each once."""
    knowns: dict[int, Variable] = {}
    unknowns: dict[int, dict[int, Variable]] = {}
    for unknown, known, _ in factors:
        knowns[known.index] = known
        unknowns.setdefault(known.index, {})[unknown.index] = unknown
    return [(known, list(unknowns[index].values())) for index, known in knowns.items()]


def _states(fmu: FmuFile) -> list[Variable]:
    """Returns the continuous states that Derivatives exposes."""
    return [fmu.variables[index - 1] for index in fmu.state_derivatives.values()]


# initial values


@behaviour_rule(_STRUCTURE)
def initial_dependencies_are_declared(probe: Probe) -> Iterator[str]:
    """An initial unknown changes only with the knowns that its dependencies list."""
    for known, value in other_values(settable_in_initialization(probe.fmu)[:_MOST_KNOWNS]):
        unlisted = [
            unknown
            for unknown, listed, _ in probe.fmu.dependencies["InitialUnknowns"]
            if listed is not None and known.index not in listed and unknown.name != known.name
        ]
        for name in sorted(_changed(probe, known, value, unlisted)):
            expected = "expected that among its dependencies"
            yield f"{name} changes with {known.name} in initialization mode: {expected}"


def _changed(probe: Probe, known: Variable, value: Any, unknowns: list[Variable]) -> set[str]:
    """Returns the unknowns that change when a known has another value, by more than an iteration leaves: not
    as much between two values that are almost one.
    """
    start = start_value(known)

    def values_with(*values: Any) -> list[dict[str, Any]]:
        runs = _runs(probe, lambda: probe.script().initialise(), known, values, lambda s: s.read(unknowns))
        return [reading.values for script, reading in runs if script.succeeded]

    pair = values_with(None, value) if unknowns else []
    names = {v.name for v in unknowns if pair[1:] and not same(pair[0][v.name], pair[1][v.name], _NOISE)}
    if not names or not isinstance(start, float):
        return names
    near = values_with(start, value, value + _CLOSE * (value - start))
    if len(near) < 3:
        return names

    def is_noise(name: str) -> bool:
        a, b, c = (values[name] for values in near)
        return isinstance(a, float) and abs(c - b) > _SHARE * abs(b - a)

    return {name for name in names if not is_noise(name)}


@behaviour_rule(_STRUCTURE, needs="variables-can-be-read")
def dependencies_on_time_are_declared(probe: Probe) -> Iterator[str]:
    """An initial unknown changes with the start time only if it lists the independent variable, where that is
    defined.
    """
    independent = {v.index for v in probe.fmu.variables if v.causality == "independent"}
    if not independent:
        raise NotApplicableError("no variable is independent")
    initial = probe.fmu.dependencies["InitialUnknowns"]
    scripts = [probe.script().initialise(t) for t in (probe.start_time, probe.start_time + probe.step_size)]
    readings = [script.read(unknown for unknown, *_ in initial) for script in scripts]
    probe.play_each(scripts)
    if not all(script.succeeded for script in scripts):
        raise NotJudgedError("another start time is refused")
    before, after = (reading.values for reading in readings)
    for name in [v.name for v, listed, _ in initial if listed is not None and not {*listed} & independent]:
        if not same(before[name], after[name], _NOISE):
            yield f"{name} changes with the start time: expected the independent variable in its dependencies"


@behaviour_rule(_STRUCTURE, needs="variables-can-be-read")
def constant_factors_are_constant(probe: Probe) -> Iterator[str]:
    """An initial unknown changes with a known of the kind constant by the same factor everywhere, whatever
    the inputs are.
    """
    fmu, knowns = probe.fmu, settable_in_initialization(probe.fmu)
    point = other_values(v for v in knowns if v.causality == "input")
    initial = {unknown.index for unknown, *_ in fmu.dependencies["InitialUnknowns"]}
    factors = _factors(fmu, ("InitialUnknowns", "Outputs"), knowns, stated=True)
    constant = (factor for factor in factors if factor[2] == "constant" and factor[0].index in initial)
    for known, unknowns in _by_known(constant)[:_MOST_KNOWNS]:
        start, value = start_value(known), other_value(known)
        if isinstance(start, float) and value is not None:
            yield from _other_factors(probe, known, unknowns, start, value, point)


def _other_factors(
    probe: Probe, known: Variable, unknowns: list[Variable], start: float, value: float, point: Point
) -> Iterator[str]:
    twice = start + 2 * (value - start)
    runs = [
        run
        for values, others in (((start, value, twice), ()), ((start, value), point))
        for run in _runs(
            probe, lambda: probe.script().initialise(), known, values, lambda s: s.read(unknowns), others
        )
    ]
    for v in unknowns if all(script.succeeded for script, _ in runs) else ():
        a, b, c, d, e = (reading.values[v.name] for _, reading in runs)
        changes, scale = [b - a, c - b, e - d], max(map(abs, (a, b, c, d, e)))
        margin = _LINEAR * max(map(abs, changes)) + 1e-12 * scale
        if math.isfinite(scale) and max(changes) - min(changes) > margin:
            yield f"the factor of {known.name} in {v.name} is not constant: its dependenciesKind is"


# outputs after steps


@behaviour_rule(
    "advice: 2.2.8, a direct dependency is told from one step's delay by no call",
    needs="variables-can-be-read initial-dependencies-are-declared "
    "directional-derivatives-are-zero-without-dependency",
)
def outputs_follow_declared_inputs_alone(probe: Probe) -> Iterator[str]:
    """In step mode an input has no direct effect on an output that lists others: one that stays as steps
    become short and ends with the input.
    """
    # 4.2.4 allows no reading between setting an input and the next step
    inputs = [v for v in probe.fmu.variables if v.causality == "input"]
    indices = {v.index for v in inputs}
    parts = _PARTS if probe.fmu.claims(_ANY_STEP) else _PARTS[:1]
    for v, value in other_values(inputs[:_MOST_INPUTS]):
        unlisted = [
            unknown.name
            for unknown, listed, _ in probe.fmu.dependencies["Outputs"]
            if listed is not None and indices & set(listed) and v.index not in listed
        ]
        effects = [_direct_effects(probe, v, value, part) for part in parts] if unlisted else []
        for name in sorted(unlisted):
            found = [effect[name] for effect in effects if name in effect]
            if len(found) == len(parts) and (found[-1] is True or found[-1] > _STAYS * found[0]):
                expected = "expected that among its dependencies"
                yield f"{name} changes with {v.name} in a step, however short: {expected}"


def _direct_effects(probe: Probe, v: Variable, value: Any, part: float) -> dict[str, Any]:
    """Returns the outputs that another value of an input changes in a step of a part of the step size, and
    that are as before one step after it, each with the change of a number, or True.
    """
    t, h = probe.point(2), part * probe.step_size

    def read(script: Script) -> tuple[Reading, Reading]:
        script.call("do_step", t, h)
        first = script.read(probe.outputs)
        script.set(v, start_value(v))
        script.call("do_step", t + h, h)
        return first, script.read(probe.outputs)

    runs = _runs(probe, lambda: probe.script().begin().step(2), v, (start_value(v), value), read)
    if not all(script.succeeded for script, _ in runs):
        return {}
    (usual, now), (changed, then) = ([r.values for r in readings] for _, readings in runs)
    effects: dict[str, Any] = {}
    for name in [name for name, x in usual.items() if not same(x, changed[name], _NOISE)]:
        if not isinstance(usual[name], float):
            effects |= {name: True} if now[name] == then[name] else {}
            continue
        effect = abs(changed[name] - usual[name])
        if math.isfinite(effect) and abs(then[name] - now[name]) <= _ENDS * effect:
            effects[name] = effect
    return effects


# directional derivatives


def _derivatives(script: Script, unknowns: Sequence[Variable], known: Variable) -> Reply:
    return script.call("directional_derivatives", references_of(unknowns), references_of([known]), [1.0])


@behaviour_rule(_PARTIAL, condition=_PROVIDES, needs="allowed-calls-succeed variables-can-be-read")
def directional_derivatives(probe: Probe) -> Iterator[str]:
    """In initialization mode, derivatives of outputs, calculated parameters and state derivatives lie between
    difference quotients of both sides.
    """
    for known, unknowns in _by_known(_initial_factors(probe.fmu))[:_MOST_DERIVED]:
        yield from _beside_quotients(probe, known, unknowns)


def _initial_factors(fmu: FmuFile) -> Iterator[Factor]:
    derivatives = {index for index, _ in fmu.unknowns("Derivatives")}
    for factor in _factors(fmu, _AT_FIRST, settable_in_initialization(fmu)):
        if factor[0].causality in ("output", "calculatedParameter") or factor[0].index in derivatives:
            yield factor


@behaviour_rule(
    _PARTIAL,
    condition=_PROVIDES,
    needs="directional-derivatives directional-derivatives-are-linear",
)
def directional_derivatives_in_step_mode(probe: Probe) -> Iterator[str]:
    """After initialisation with other values, the derivatives of continuous outputs and state derivatives in
    step mode lie near difference quotients: those of runs with other inputs and states at first.
    """
    settable = [v for v in settable_in_initialization(probe.fmu) if v.kind == "Real"]
    states = {v.index for v in _states(probe.fmu)}
    knowns = (v for v in settable if v.causality == "input" or v.index in states)
    pairs = other_values(settable[:_MOST_CHANGED])
    point = accepted_together(probe, pairs, lambda: probe.script().initialise())
    factors = (f for f in _factors(probe.fmu, _STEPPING, knowns) if f[0].variability == "continuous")
    for known, unknowns in _by_known(factors)[:_MOST_DERIVED]:
        yield from _beside_quotients(probe, known, unknowns, point)


def _beside_quotients(
    probe: Probe, known: Variable, unknowns: list[Variable], point: Point | None = None
) -> Iterator[str]:
    """Yields messages of derivatives outside of difference quotients.

    point: values of initialization mode for step mode, unless a state follows the known at once
    """
    start = next((x for v, x in point or () if v is known), start_value(known))
    if not isinstance(start, float):
        return
    states = [] if point is None else [v for v in _states(probe.fmu) if v is not known]
    low, high, width = known.number("min"), known.number("max"), _DIFFERENCE * max(1.0, abs(start))
    sides = [
        x for x in (start - width, start + width)
        if (low is None or x >= low) and (high is None or x <= high)
    ]  # fmt: skip

    def read(script: Script) -> tuple[Reading, Reply]:
        if point is not None:
            script.exit_initialization_mode()
        # 4.2.4 lets only outputs and initial unknowns be read in initialization mode
        return script.read([*unknowns, *states]), _derivatives(script, unknowns, known)

    def begun() -> Script:
        return probe.script(logging=True).initialise()

    (usual, (middle, reply)), *others = _runs(probe, begun, known, [start, *sides], read, point or ())
    if usual.failure and point is None:
        yield usual.failure.problem
    if not usual.succeeded:
        return
    values = middle.values
    taken = [(x, r.values) for x, (script, (r, _)) in zip(sides, others, strict=True) if script.succeeded]
    if any(values[v.name] != side[v.name] for v in states for _, side in taken):
        return
    for v, derivative in zip(unknowns, reply.value, strict=True):
        quotients = [(side[v.name] - values[v.name]) / (x - start) for x, side in taken]
        if quotients and all(map(math.isfinite, [values[v.name], *quotients])):
            rounding = 1e-13 * abs(values[v.name]) / width  # some hundred roundings of the output
            margin = _AGREEMENT * max(map(abs, [derivative, *quotients])) + rounding + _NOISE
            if not min(quotients) - margin <= derivative <= max(quotients) + margin:
                where = "" if point is None else f" in the state {usual.state!r}"
                expected = f"{min(quotients):.9g}..{max(quotients):.9g}"
                yield f"d {v.name} / d {known.name} is {derivative:.9g}{where}: expected {expected}"


@behaviour_rule(_PARTIAL, condition=_PROVIDES, needs="directional-derivatives questions-change-nothing")
def directional_derivatives_are_linear(probe: Probe) -> Iterator[str]:
    """A directional derivative is the sum of the partial derivatives, each times its seed, in every mode."""
    initial = [v for v, *_ in probe.fmu.dependencies["InitialUnknowns"] if v.kind == "Real"]
    inputs = continuous_reals(probe, "input")
    at_first = [known for known, _ in _by_known(_initial_factors(probe.fmu))]
    modes = (
        (initial, [*inputs, *at_first], False),
        (continuous_reals(probe, "output"), [*inputs, *_states(probe.fmu)], True),
    )
    if not any(unknowns and knowns for unknowns, knowns, _ in modes):
        raise NotApplicableError("there is no Real known, or neither an output nor an initial unknown")
    for unknowns, knowns, stepping in modes:
        if unknowns and knowns:
            chosen = list({v.index: v for v in knowns}.values())[:_MOST_DERIVED]
            yield from _other_sums(_in_mode(probe, stepping), unknowns, chosen)


def _in_mode(probe: Probe, stepping: bool) -> Script:
    """Returns a script in step mode, after a step, or in initialization mode."""
    script = probe.script(logging=True)
    return script.begin().step() if stepping else script.initialise()


def _other_sums(script: Script, unknowns: list[Variable], knowns: list[Variable]) -> Iterator[str]:
    seed = [2.5 + 0.5 * i for i in range(len(knowns))]
    alone = [_derivatives(script, unknowns, known) for known in knowns]
    together = script.call("directional_derivatives", references_of(unknowns), references_of(knowns), seed)
    script.play()
    for i, (v, got) in enumerate(zip(unknowns, together.value, strict=True)):
        parts = [s * reply.value[i] for s, reply in zip(seed, alone, strict=True)]
        if not abs(got - sum(parts)) <= _SUMMED * max([1e-300, abs(got), *map(abs, parts)]):
            shown = texts(got, sum(parts))
            yield (
                f"the directional derivative of {v.name} is {shown[0]} in the state "
                f"{script.state!r}: expected {shown[1]}, the sum of its parts"
            )


@behaviour_rule(
    _PARTIAL, condition=_PROVIDES, needs="directional-derivatives initial-dependencies-are-declared"
)
def directional_derivatives_are_zero_without_dependency(probe: Probe) -> Iterator[str]:
    """The derivative with respect to an input, in step mode also to a continuous state, that is not among
    the dependencies of an output or a state derivative is zero.
    """
    inputs, states = continuous_reals(probe, "input"), _states(probe.fmu)
    for section in (*_AT_FIRST, *_STEPPING):
        stepping = section in _STEPPING
        for unknown, stated, _ in probe.fmu.dependencies[section]:
            observed = unknown.causality == "output" or section == "Derivatives"
            if stated is None or unknown.kind != "Real" or not observed:
                continue
            indices = {*stated, unknown.index}
            listed = {(v.base_kind, v.reference) for v in probe.fmu.variables if v.index in indices}
            knowns = [*inputs, *states] if stepping else inputs
            others = [v for v in knowns if (v.base_kind, v.reference) not in listed][:_MOST_DERIVED]
            script = _in_mode(probe, stepping)
            replies = [_derivatives(script, [unknown], known) for known in others]
            script.play(keep_going=True)
            for known, reply in zip(others, replies, strict=True):
                if reply.ok and reply.value[0] != 0.0:
                    yield (
                        f"d {unknown.name} / d {known.name} is {reply.value[0]:.9g} in the state "
                        f"{script.state!r}: expected 0, as {section} lists no such dependency"
                    )


@behaviour_rule(
    _STRUCTURE,
    condition=_PROVIDES,
    needs="directional-derivatives directional-derivatives-are-linear",
)
def factors_change_as_declared(probe: Probe) -> Iterator[str]:
    """In step mode a factor that is constant or fixed is the same when inputs, states and tunable parameters
    have changed, and a tunable one when inputs and states have.
    """
    knowns = [v for v in probe.fmu.variables if v.causality != "independent"]
    factors = [f for f in _factors(probe.fmu, _STEPPING, knowns, stated=True) if f[2] in _SELDOM]
    if not factors:
        raise NotApplicableError("no dependency is of the kind constant, fixed or tunable")
    changes = other_values(settable_while_stepping(probe.fmu))
    of_inputs = [(v, x) for v, x in changes if v.causality == "input"]
    for kinds, chosen in ((_SELDOM[:2], changes), (_SELDOM[2:], of_inputs)):
        judged = [factor for factor in factors if factor[2] in kinds][:_MOST_DERIVED]
        first, later = probe.script().begin().step(), probe.script().begin()
        pairs = chosen[:_MOST_CHANGED] if judged else []
        for v, x in accepted_together(probe, pairs, lambda: probe.script().begin()):
            later.set(v, x)
        later.step(3)
        replies = [[_derivatives(script, [u], k) for u, k, _ in judged] for script in (first, later)]
        probe.play_each([first, later])
        for (u, k, kind), one, other in zip(judged, *replies, strict=True):
            if one.ok and other.ok and not same(one.value[0], other.value[0], _AGREEMENT, 1e-12):
                shown = texts(other.value[0], one.value[0])
                yield f"d {u.name} / d {k.name} is {shown[0]} and was {shown[1]}: its factor is said {kind}"
