"""Behaviour of derivatives: of inputs, of outputs, and directional ones, as far as the FMU claims them."""

import itertools
import math
from collections.abc import Iterator

from fmus.binding import DISCARD, ERROR
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.instance_rules import unknown_reference
from fmus.compliance.probe import Probe
from fmus.compliance.rule import Level, NotApplicableError, Stage, rule
from fmus.compliance.script import CallError, Reading, Script
from fmus.compliance.values import (
    RESTARTED,
    continuous_reals,
    differing,
    other_value,
    references_of,
    same,
    set_input_derivatives,
    start_value,
    texts,
    unless_claimed,
)
from fmus.compliance.variable import Variable, integer

_TRANSFER = "4.2.1 Transfer of Input / Output Values and Parameters"
_STATES = "4.2.4 State Machine of Calling Sequence from Master to Slave"
_DERIVATIVE = "2.2.7 Definition of Model Variables (ModelVariables): derivative"
INTERPOLATES = "canInterpolateInputs"
_MANY_STEPS, _INTEGRATED = 30, 0.02  # steps; relative: of an integral, beside the error of a coarse solver
_ANY_STEP = "canHandleVariableCommunicationStepSize"
_SHORT = 0.30901699  # of a step: no simple fraction, so that nothing that repeats with it stands still
_ROUGH = 0.1  # relative: of slopes over a step, which is no limit


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


def _no_derivatives(fmu: FmuFile) -> str:
    return _orders(fmu) and unless_claimed(INTERPOLATES)(fmu) and "no derivatives are claimed"


def derive(script: Script, v: Variable, value: float) -> None:
    script.call("set_input_derivatives", references_of([v]), [1], [value])


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=unless_claimed(INTERPOLATES), needs=["allowed-calls-succeed"])
def input_derivatives(probe: Probe) -> Iterator[str]:
    """The first derivative of every continuous Real input can be set before a step; zero, also after
    another value, changes nothing."""
    usual, script = probe.script().begin(), probe.script(logging=True).begin()
    expected = usual.run(2)
    for v in continuous_reals(probe, "input"):
        derive(script, v, 1.0)
        derive(script, v, 0.0)
    got = script.run(2)
    usual.play()
    script.play()
    yield from differing(expected, got, "where derivatives of inputs were set to 0", RESTARTED)


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=unless_claimed(INTERPOLATES), needs=["input-derivatives"])
def input_derivatives_have_an_effect(probe: Probe) -> Iterator[str]:
    """The derivative of an input that outputs follow moves them, in the direction of the input itself."""
    verdicts = probe.once("effects of derivatives", lambda: input_effects(probe))
    backwards = [name for name, verdict in verdicts if verdict == "backwards"]
    without = [name for name, verdict in verdicts if verdict == "not"]
    if backwards:
        yield f"the derivative of {backwards[0]} moves outputs against the input in a step"
    elif without and not any(verdict == "right" for _, verdict in verdicts):
        yield f"the derivative of {without[0]} has no effect in a step, as canInterpolateInputs says it has"


@rule(
    _TRANSFER,
    Stage.BEHAVIOUR,
    Level.WARNING,
    condition=unless_claimed(INTERPOLATES),
    needs=["input-derivatives-have-an-effect"],
)
def each_input_derivative_has_an_effect(probe: Probe) -> Iterator[str]:
    """If the derivative of one continuous input has an effect, that of each that outputs follow has one."""
    for name, verdict in probe.once("effects of derivatives", lambda: input_effects(probe)):
        if verdict == "not":
            yield f"the derivative of {name} has no effect in a step, where those of other inputs have one"


def input_effects(probe: Probe) -> list[tuple[str, str]]:
    """Continuous inputs that take another value, each with what its derivative does to outputs."""
    verdicts = []
    for v in continuous_reals(probe, "input"):
        value = other_value(v)
        if value is None:
            continue
        change, held = value - start_value(v), probe.script().begin().step()
        raised, moving = probe.script().begin().step(), probe.script().begin().step()
        for script in (held, raised, moving):
            script.set(v, value if script is raised else start_value(v))
        derive(moving, v, change / probe.step_size)
        readings = [script.step().read(probe.outputs) for script in (held, raised, moving)]
        probe.play_each([held, raised, moving])
        if not (held.failure or raised.failure or moving.failure):
            verdicts.append((v.name, _moved(*readings)))
    return verdicts


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
    chosen = continuous_reals(probe, "output")
    script = probe.script(logging=True).begin().step(2)
    replies = [
        script.call("output_derivatives", references_of(chosen), order)
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


_FAR = 10.0  # times: a derivative of one communication point, and not of the next
_TO_COMPARE = ["output-derivatives", "variables-can-be-read", "communication-points-may-be-rounded"]


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=_orders, needs=_TO_COMPARE)
def output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """The first derivative of an output is 0, where its order is lower, or its slope: near the difference
    quotients before and after it.
    """
    for name, comparisons in probe.once("slopes of outputs", lambda: _slopes(probe)).items():
        wrong = list(_wrong_slope(name, comparisons, [c for c in comparisons if c[0] != 0.0]))
        if wrong and _are_wrong_in_short_steps(probe, name):
            yield from wrong
        if not wrong and _are_late(comparisons):
            yield f"{name}: its derivative is that of the step's begin: expected that of its end"


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


def _are_wrong_in_short_steps(probe: Probe, name: str) -> bool:
    """Whether the derivatives of an output are wrong in steps of another size too, if it takes them."""
    if not probe.fmu.claims(_ANY_STEP):
        return True
    try:
        comparisons = probe.once("slopes in short steps", lambda: _slopes(probe, _SHORT)).get(name, [])
    except CallError:
        return True
    return any(_wrong_slope(name, comparisons, [c for c in comparisons if c[0] != 0.0]))


def _slopes(probe: Probe, part: float = 1.0) -> dict[str, list[Comparison]]:
    """Name of an output -> its derivatives at communication points, beside its slopes.

    part: of the step size, for each step
    """
    chosen = continuous_reals(probe, "output")
    script = probe.script().begin()
    readings, replies, step_size = [], [], part * probe.step_size
    for i in range(8):
        script.call("do_step", probe.point(0) + i * step_size, step_size)
        readings.append(script.read(chosen))
        if chosen:
            replies.append(script.call("output_derivatives", references_of(chosen), 1))
    script.play()
    comparisons: dict[str, list[Comparison]] = {}
    for index, v in enumerate(chosen):
        values = [reading.values[v.name] for reading in readings]
        if not all(map(math.isfinite, values)):
            continue
        derivatives = [reply.value[index] for reply in replies]
        comparisons[v.name] = _compared(values, derivatives, step_size)
    return comparisons


def _wrong_slope(name: str, every: list[Comparison], judged: list[Comparison]) -> Iterator[str]:
    """A message if more than half of the derivatives are among those that are judged, and wrong."""
    wrong = [comparison for comparison in judged if _is_wrong(*comparison)]
    if len(wrong) > (len(every) + 1) // 2:  # a jump or an event is not a wrong derivative
        shown = texts(*wrong[0][:3])
        yield f"{name}: its derivative is {shown[0]}: expected about {shown[1]}..{shown[2]}, its slopes"


def _are_late(comparisons: list[Comparison]) -> bool:
    """Whether each derivative is the mean slope around the communication point before, and not around its
    own: nearer by far, and not for rounding.
    """
    means = [(before + after) / 2 for _, before, after, _ in comparisons]
    own = [abs(c[0] - mean) for c, mean in zip(comparisons[1:], means[1:], strict=True)]
    late = [abs(c[0] - mean) for c, mean in zip(comparisons[1:], means, strict=False)]
    rounding = max((c[3] for c in comparisons), default=0.0)
    return bool(own) and min(own) > _FAR * max([rounding, *late])


def _is_wrong(derivative: float, before: float, after: float, rounding: float) -> bool:
    margin = 2 * abs(after - before) + _ROUGH * max(abs(before), abs(after)) + rounding
    return not min(before, after) - margin <= derivative <= max(before, after) + margin


@rule(_TRANSFER, Stage.BEHAVIOUR, Level.WARNING, condition=_orders, needs=_TO_COMPARE)
def higher_output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """A derivative of an output of a higher order is 0, where its order is lower, or the slope of the one
    before; each of several that are read in one call is its own.
    """
    chosen = continuous_reals(probe, "output")
    script, replies = probe.script().begin(), []
    for _ in range(8):
        script.step()
        orders = range(1, probe.fmu.output_derivative_order + 1) if chosen else ()
        replies.append([script.call("output_derivatives", references_of(chosen), order) for order in orders])
    together = [script.call("output_derivatives", references_of([v]), 1) for v in chosen]
    highest = probe.fmu.output_derivative_order
    alternating = [1 + (highest - 1) * (i % 2) for i in range(len(chosen))]
    mixed = [
        (orders, script.call("output_derivatives", references_of(chosen), orders))
        for orders in (alternating, [1 + highest - order for order in alternating])
        if chosen and highest > 1
    ]
    script.play()
    for orders, reply in mixed:
        for v, order, value, *each in zip(
            chosen, orders, reply.value, *(r.value for r in replies[-1]), strict=True
        ):
            if not same(value, each[order - 1]):
                shown = texts(value, each[order - 1])
                yield (
                    f"{v.name}: its derivative of order {order} is {shown[0]} read in one call with other "
                    f"orders: expected {shown[1]}"
                )
                return
    for index, v in enumerate(chosen):
        last = replies[-1][0].value[index]
        if not same(together[index].value[0], last):
            shown = texts(together[index].value[0], last)
            yield f"{v.name}: its derivative is {shown[0]} read alone and {shown[1]} with those of others"
        for order in range(2, probe.fmu.output_derivative_order + 1):
            lower = [reply[order - 2].value[index] for reply in replies]
            values = [reply[order - 1].value[index] for reply in replies]
            if all(map(math.isfinite, [*lower, *values])):
                comparisons = _compared(lower, values, probe.step_size)
                yield from _wrong_slope(
                    f"{v.name}, order {order}", comparisons, [c for c in comparisons if c[0] != 0.0]
                )


def _compared(values: list[float], derivatives: list[float], step_size: float) -> list[Comparison]:
    """Derivatives beside the slopes of values at equal distances."""
    slopes = [(b - a) / step_size for a, b in itertools.pairwise(values)]
    rounding = 1e-9 * max(map(abs, values)) / step_size
    return [(derivatives[i], slopes[i - 1], slopes[i], rounding) for i in range(1, len(slopes))]


@rule(
    _DERIVATIVE,
    Stage.BEHAVIOUR,
    needs=["variables-can-be-read", "communication-points-may-be-rounded"],
)
def derivatives_are_slopes(probe: Probe) -> Iterator[str]:
    """A variable with the attribute derivative is the slope of the variable that it names: in most steps it
    lies near the difference quotients.
    """
    for v, state, values, slopes in _derivatives_in_a_run(probe):
        messages = _no_slope(v, state, values, slopes, probe.step_size)
        if messages and _is_wrong_in_short_steps(probe, v.name):
            yield from messages


def _no_slope(
    v: Variable, state: Variable, values: list[float], slopes: list[float], step_size: float
) -> list[str]:
    """A message if neither the integral of a derivative nor its values are right."""
    if _difference_of_integral(values, slopes, step_size) is None:
        return []
    compared = _compared(values, slopes, step_size)
    return list(_wrong_slope(f"{v.name} by {state.name}", compared, compared))


def _is_wrong_in_short_steps(probe: Probe, name: str) -> bool:
    """Whether a derivative is none with steps of another size too: what repeats with each step moves then.

    Where the FMU takes no other steps, `derivatives-integrate-to-their-variables` warns.
    """
    if not probe.fmu.claims(_ANY_STEP):
        return False
    try:
        runs = probe.once("run of short steps", lambda: _run_with_derivatives(probe, _SHORT))
    except CallError:
        return False
    step_size = _SHORT * probe.step_size
    return any(_no_slope(*run, step_size) for run in runs if run[0].name == name)


@rule(_DERIVATIVE, Stage.BEHAVIOUR, Level.WARNING, needs=["derivatives-are-slopes"])
def derivatives_integrate_to_their_variables(probe: Probe) -> Iterator[str]:
    """A variable changes by the integral of the variable that names it with the attribute derivative."""
    for v, state, values, slopes in _derivatives_in_a_run(probe):
        if (difference := _difference_of_integral(values, slopes, probe.step_size)) is not None:
            shown = texts(*difference)
            yield f"{state.name} changes by {shown[0]} where the integral of {v.name} is {shown[1]}"


def _derivatives_in_a_run(probe: Probe) -> list[tuple[Variable, Variable, list[float], list[float]]]:
    """(derivative, its variable, values of the variable, values of the derivative) that are finite."""
    return probe.once("run with derivatives", lambda: _run_with_derivatives(probe))


def _run_with_derivatives(
    probe: Probe, part: float = 1.0
) -> list[tuple[Variable, Variable, list[float], list[float]]]:
    """part: of the step size, for each step."""
    variables = probe.fmu.variables
    pairs = [(v, index) for v in variables if (index := integer(v.typed.get("derivative"))) is not None]
    pairs = [(v, variables[i - 1]) for v, i in pairs if 1 <= i <= len(variables) and i != v.index]
    continuous = [
        (v, w)
        for v, w in pairs
        if v.kind == w.kind == "Real" and v.variability == w.variability == "continuous"
    ]
    if not continuous:
        raise NotApplicableError("no continuous variable is marked as a derivative")
    script, chosen = probe.script().begin(), [x for pair in continuous for x in pair]
    readings, step_size = [script.read(chosen)], part * probe.step_size
    for i in range(_MANY_STEPS):
        script.call("do_step", probe.point(0) + i * step_size, step_size)
        readings.append(script.read(chosen))
    script.play()
    rows = [reading.values for reading in readings]
    pairs = [(v, w, [row[w.name] for row in rows], [row[v.name] for row in rows]) for v, w in continuous]
    return [row for row in pairs if all(map(math.isfinite, [*row[2], *row[3]]))]


def _difference_of_integral(
    values: list[float], slopes: list[float], step_size: float
) -> tuple[float, float] | None:
    """The change of a variable and the integral of its derivative, if they are not about the same."""
    integral = step_size * (sum(slopes) - (slopes[0] + slopes[-1]) / 2)
    variation = sum(abs(b - a) for a, b in itertools.pairwise(slopes))
    margin = step_size * (variation + _INTEGRATED * sum(map(abs, slopes)))
    change = values[-1] - values[0]
    differ = abs(change - integral) > margin + 1e-9 * max(map(abs, values))
    return (change, integral) if differ else None


@rule(
    _STATES,
    Stage.BEHAVIOUR,
    Level.WARNING,
    condition=unless_claimed(INTERPOLATES),
    needs=["allowed-calls-succeed"],
)
def input_derivatives_when_instantiated(probe: Probe) -> Iterator[str]:
    """Derivatives of inputs can be set when instantiated: 4.2.4 allows it, although 4.2.1 gives them the
    restrictions of fmi2SetReal, which cannot set inputs there.
    """
    script = probe.script(logging=True)
    set_input_derivatives(probe, script, 0.0)
    script.begin().step().play(keep_going=True)
    if script.failure:
        when = "when instantiated, which 4.2.4 allows and 4.2.1 does not"
        yield f"where derivatives of inputs were set {when}: {script.failure.problem}"


@rule(
    "2.1.2 Platform Dependent Definitions (fmi2TypesPlatform.h)",
    Stage.BEHAVIOUR,
    Level.WARNING,
    condition=_no_derivatives,
)
def wrong_references_of_derivatives_are_refused(probe: Probe) -> Iterator[str]:
    """A value reference that no variable has is an error for derivatives too."""
    reference, calls = unknown_reference(probe), []
    if probe.fmu.claims(INTERPOLATES):
        calls.append(("set_input_derivatives", [reference], [1], [0.0]))
    if probe.fmu.output_derivative_order > 0:
        calls.append(("output_derivatives", [reference], 1))
    pairs = [(script := probe.script(logging=True).begin().step(), script.call(*call)) for call in calls]
    probe.play_each([script for script, _ in pairs])
    for _, reply in pairs:
        if reply.status not in (None, ERROR, DISCARD):  # discard is illegal: `refusals-have-legal-statuses`
            yield f"{reply.function} of the value reference {reference}, which is none: {reply.status_name}"
