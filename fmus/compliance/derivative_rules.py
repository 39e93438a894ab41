"""Behaviour of derivatives: of inputs, of outputs, and directional ones, as far as the FMU claims them."""

import itertools
import math
from collections.abc import Iterator, Sequence

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Level, NotJudgedError, Stage, rule
from fmus.compliance.script import Reading, Script
from fmus.compliance.values import (
    RESTARTED,
    differing,
    other_value,
    settable_in_initialization,
    start_value,
    texts,
    unless_claimed,
)
from fmus.compliance.variable import Variable, integer

_TRANSFER = "4.2.1 Transfer of Input / Output Values and Parameters"
_DIRECTIONAL = "2.1.9 Getting Partial Derivatives"
_INTERPOLATES, _PROVIDES = "canInterpolateInputs", "providesDirectionalDerivative"
_MOST_KNOWNS = 40  # of one FMU: each costs four evaluations
_DIFFERENCE = 1e-6  # relative change for a difference quotient: half the digits for truncation and rounding
_AGREEMENT = 1e-4  # relative; a wrong derivative is wrong by much more
_ROUGH = 0.1  # relative: of slopes over a step, which is no limit
_LINEAR = 1e-6  # relative: derivatives may be difference quotients


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


def _continuous(probe: Probe, causality: str) -> list[Variable]:
    return [v for v in probe.real(causality) if v.variability == "continuous"]


def _references(variables: Sequence[Variable]) -> list[int]:
    return [v.reference or 0 for v in variables]


def _derive(script: Script, v: Variable, value: float) -> None:
    script.call("set_input_derivatives", _references([v]), [1], [value])


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=unless_claimed(_INTERPOLATES), needs=["allowed-calls-succeed"])
def input_derivatives(probe: Probe) -> Iterator[str]:
    """The first derivative of every continuous Real input can be set before a step; zero changes nothing."""
    usual, script = probe.script().begin(), probe.script(logging=True).begin()
    expected = usual.run(2)
    for v in _continuous(probe, "input"):
        _derive(script, v, 0.0)
    got = script.run(2)
    usual.play()
    script.play()
    yield from differing(expected, got, "where derivatives of inputs were set to 0", RESTARTED)


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=unless_claimed(_INTERPOLATES), needs=["input-derivatives"])
def input_derivatives_have_an_effect(probe: Probe) -> Iterator[str]:
    """The derivative of an input that outputs follow moves them, in the direction of the input itself."""
    wrong, right = [], False
    for v in _continuous(probe, "input"):
        value = other_value(v)
        if value is None:
            continue
        change, held = value - start_value(v), probe.script().begin().step()
        raised, moving = probe.script().begin().step(), probe.script().begin().step()
        for script in (held, raised, moving):
            script.set(v, value if script is raised else start_value(v))
        _derive(moving, v, change / probe.step_size)
        readings = [script.step().read(probe.outputs) for script in (held, raised, moving)]
        for script in (held, raised, moving):
            script.play(keep_going=True)
        if held.failure or raised.failure or moving.failure:
            continue
        verdict = _moved(*readings)
        right = right or verdict == "right"
        if verdict in ("not", "backwards"):
            wrong.append((v.name, verdict))
    if (wrong and not right) or any(verdict == "backwards" for _, verdict in wrong):
        name, verdict = next(((n, w) for n, w in wrong if w == "backwards"), wrong[0])
        how = "has no effect" if verdict == "not" else "moves outputs against the input"
        yield f"the derivative of {name} {how} in a step, as canInterpolateInputs says it has"


def _moved(held: Reading, raised: Reading, moving: Reading) -> str:
    """Whether outputs that follow an input follow its derivative: right, not, backwards, or unknown."""
    pairs = [
        (raised.values[name] - value, moving.values[name] - value)
        for name, value in held.values.items()
        if isinstance(value, float) and raised.values[name] != value
    ]
    if not pairs:
        return "unknown"
    if all(moved == 0.0 for _, moved in pairs):
        return "not"
    largest = max(pairs, key=lambda pair: abs(pair[0]))
    return (
        "backwards"
        if largest[0] * largest[1] < 0.0 and abs(largest[1]) > _ROUGH * abs(largest[0])
        else "right"
    )


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=_orders, needs=["allowed-calls-succeed"])
def output_derivatives(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of continuous Real outputs can be read, of each order that is claimed."""
    probe.once("derivatives of outputs", lambda: _derivatives(probe))
    yield from ()


def _derivatives(probe: Probe) -> list[tuple[str, int, float]]:
    """(name of an output, order, derivative) after a step."""
    chosen = _continuous(probe, "output")
    script = probe.script(logging=True).begin().step(2)
    replies = [
        script.call("output_derivatives", _references(chosen), order)
        for order in range(1, probe.fmu.output_derivative_order + 1)
        if chosen
    ]
    script.play()
    return [
        (v.name, order, value)
        for order, reply in enumerate(replies, 1)
        for v, value in zip(chosen, reply.value, strict=True)
    ]


@rule(
    "advice: importers extrapolate with finite numbers",
    Stage.BEHAVIOUR,
    Level.WARNING,
    condition=_orders,
    needs=["output-derivatives"],
)
def output_derivatives_are_finite(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of outputs are finite."""
    for name, order, value in probe.once("derivatives of outputs", lambda: _derivatives(probe)):
        if not math.isfinite(value):
            yield f"{name}: derivative of order {order} is {value}: expected a finite number"


_TO_COMPARE = ["output-derivatives", "variables-can-be-read", "communication-points-may-be-rounded"]


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=_orders, needs=_TO_COMPARE)
def output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """The first derivative of an output is 0, where its order is lower, or its slope: near the difference
    quotients before and after it.
    """
    for name, comparisons in probe.once("slopes of outputs", lambda: _slopes(probe)).items():
        yield from _wrong_slope(name, comparisons, [c for c in comparisons if c[0] != 0.0])


@rule(
    "advice: 4.2.1 allows 0 where the order is lower",
    Stage.BEHAVIOUR,
    Level.WARNING,
    condition=_orders,
    needs=_TO_COMPARE,
)
def output_derivatives_are_not_zero(probe: Probe) -> Iterator[str]:
    """The first derivative of an output that moves is not 0, as maxOutputDerivativeOrder claims one."""
    for name, comparisons in probe.once("slopes of outputs", lambda: _slopes(probe)).items():
        yield from _wrong_slope(name, comparisons, [c for c in comparisons if c[0] == 0.0])


Comparison = tuple[float, float, float, float]  # derivative, slope before, slope after, rounding of slopes


def _slopes(probe: Probe) -> dict[str, list[Comparison]]:
    """Name of an output -> its derivatives at communication points, beside its slopes."""
    chosen = _continuous(probe, "output")
    script = probe.script().begin()
    readings, replies = [], []
    for _ in range(8):
        script.step()
        readings.append(script.read(chosen))
        if chosen:
            replies.append(script.call("output_derivatives", _references(chosen), 1))
    script.play()
    comparisons: dict[str, list[Comparison]] = {}
    for index, v in enumerate(chosen):
        values = [reading.values[v.name] for reading in readings]
        if not all(map(math.isfinite, values)):
            continue
        slopes = [(b - a) / probe.step_size for a, b in itertools.pairwise(values)]
        rounding = 1e-9 * max(map(abs, values)) / probe.step_size
        comparisons[v.name] = [
            (replies[i].value[index], slopes[i - 1], slopes[i], rounding) for i in range(1, len(slopes))
        ]
    return comparisons


def _wrong_slope(name: str, every: list[Comparison], judged: list[Comparison]) -> Iterator[str]:
    """A message if more than half of the derivatives are among those that are judged, and wrong."""
    wrong = [comparison for comparison in judged if _is_wrong(*comparison)]
    if len(wrong) > (len(every) + 1) // 2:  # a jump or an event is not a wrong derivative
        shown = texts(*wrong[0][:3])
        yield f"{name}: its derivative is {shown[0]}: expected about {shown[1]}..{shown[2]}, its slopes"


def _is_wrong(derivative: float, before: float, after: float, rounding: float) -> bool:
    margin = 2 * abs(after - before) + _ROUGH * max(abs(before), abs(after)) + rounding
    return not min(before, after) - margin <= derivative <= max(before, after) + margin


@rule(
    _DIRECTIONAL,
    Stage.BEHAVIOUR,
    condition=unless_claimed(_PROVIDES),
    needs=["allowed-calls-succeed", "variables-can-be-read"],
)
def directional_derivatives(probe: Probe) -> Iterator[str]:
    """In initialization mode, derivatives of outputs lie between difference quotients of both sides."""
    for known, unknowns in list(_pairs(probe.fmu).items())[:_MOST_KNOWNS]:
        yield from _compared(probe, probe.fmu.variables[known - 1], unknowns)


def _pairs(fmu: FmuFile) -> dict[int, list[Variable]]:
    """Index of a continuous Real known that can be set -> the Real outputs that depend on it at first."""
    dependents: dict[int, list[Variable]] = {}
    settable = [v.index for v in settable_in_initialization(fmu) if v.kind == "Real"]
    for index, element in fmu.unknowns("InitialUnknowns"):
        unknown = fmu.variables[(index or 1) - 1]
        stated = element.get("dependencies")
        listed = settable if stated is None else [integer(index) for index in stated.split()]
        for known in sorted(set(settable) & set(listed)):
            if unknown.kind == "Real" and unknown.causality == "output":
                dependents.setdefault(known, []).append(unknown)
    return dependents


def _compared(probe: Probe, known: Variable, unknowns: list[Variable]) -> Iterator[str]:
    before = start_value(known)
    if before is None:
        return
    script = probe.script(logging=True).initialise()
    script.set(known, before)  # 4.2.4 lets only outputs and initial unknowns be read here
    middle = script.read(unknowns)
    reply = script.call("directional_derivatives", _references(unknowns), _references([known]), [1.0])
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


@rule(_DIRECTIONAL, Stage.BEHAVIOUR, condition=unless_claimed(_PROVIDES), needs=["directional-derivatives"])
def directional_derivatives_are_linear(probe: Probe) -> Iterator[str]:
    """A directional derivative is the sum of the partial derivatives, each times its seed, in every mode."""
    initial = [probe.fmu.variables[(i or 1) - 1] for i, _ in probe.fmu.unknowns("InitialUnknowns")]
    initial = [v for v in initial if v.kind == "Real"]
    outputs, knowns = _continuous(probe, "output"), _continuous(probe, "input")[:_MOST_KNOWNS]
    if not (initial or outputs) or not knowns:
        raise NotJudgedError("there is no continuous input, or neither an output nor an initial unknown")
    seed = [2.5 + 0.5 * i for i in range(len(knowns))]
    for unknowns, stepping in ((initial, False), (outputs, True)):
        if not unknowns:
            continue
        script = probe.script(logging=True)
        script = script.begin().step() if stepping else script.initialise()
        alone = [
            script.call("directional_derivatives", _references(unknowns), _references([known]), [1.0])
            for known in knowns
        ]
        together = script.call("directional_derivatives", _references(unknowns), _references(knowns), seed)
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


@rule(_DIRECTIONAL, Stage.BEHAVIOUR, condition=unless_claimed(_PROVIDES), needs=["directional-derivatives"])
def directional_derivatives_are_zero_without_dependency(probe: Probe) -> Iterator[str]:
    """The derivative with respect to an input that is not among the dependencies of an output is zero."""
    knowns = _continuous(probe, "input")
    for section, stepping in (("InitialUnknowns", False), ("Outputs", True)):
        for index, element in probe.fmu.unknowns(section):
            unknown, stated = probe.fmu.variables[(index or 1) - 1], element.get("dependencies")
            if stated is None or unknown.kind != "Real" or unknown.causality != "output":
                continue
            listed = {integer(i) for i in stated.split()}
            others = [v for v in knowns if v.index not in listed][:_MOST_KNOWNS]
            script = probe.script(logging=True)
            script = script.begin().step() if stepping else script.initialise()
            replies = [
                script.call("directional_derivatives", _references([unknown]), _references([known]), [1.0])
                for known in others
            ]
            script.play(keep_going=True)
            for known, reply in zip(others, replies, strict=True):
                if reply.ok and reply.value[0] != 0.0:
                    yield (
                        f"d {unknown.name} / d {known.name} is {reply.value[0]:.9g} in the state "
                        f"{script.state!r}: expected 0, as {section} lists no such dependency"
                    )
