"""Derivatives in time, of variables that others name, of outputs and of inputs, beside slopes of values."""

import itertools
import math
from collections.abc import Callable, Iterator, Sequence

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.script import CallError, Reading, Script
from fmus.compliance.values import (
    INTERPOLATES,
    RESTARTED,
    continuous_reals,
    differing,
    other_values,
    references_of,
    same,
    start_value,
    texts,
    unless_claimed,
)
from fmus.compliance.variable import Variable, integer, is_true

_ATTRIBUTE = "2.2.7 Definition of Model Variables (ModelVariables): derivative"
_TRANSFER = "4.2.1 Transfer of Input / Output Values and Parameters"
_ANY_STEP = "canHandleVariableCommunicationStepSize"
_STEPS = 30
_SHORT = 0.30901699  # of a step: no simple fraction, so that nothing that repeats with it stands still
_ROUGH = 0.1  # relative: of slopes and effects over a step, which is no limit
_FAR = 10.0  # times: a derivative of one communication point, and not of the next
_INTEGRATED = 0.02  # relative: of an integral, beside the error of a coarse solver
_MOST_INPUTS = 10  # each of which costs six instances
_PARTS = 8  # short steps in the place of one
_CONVERGED = 0.05  # relative: a solver that short steps change more is too coarse to judge
_THROUGH_A_STATE = 0.3  # of an effect at most, after a short step: a direct one is as large at once
_APART = 0.35  # relative: less than what a half or a double is away
_NOISE = 1e-9  # relative

Series = dict[str, list[list[float]]]
"""What is judged -> its values after equal steps, and those of its derivatives of order 1, 2, ..."""


def _series(probe: Probe, name: str, run: Callable[[Probe, float], Series], part: float = 1.0) -> Series:
    """Returns series of finite numbers of a run in steps of a part of the step size, made once for all rules.

    Nothing where the FMU does not take short steps.
    """
    if part != 1.0 and not probe.fmu.claims(_ANY_STEP):
        return {}
    try:
        return probe.once(f"{name} in steps", lambda: run(probe, part), part)
    except CallError:
        if part == 1.0:
            raise
        return {}


def _read_in_steps(
    probe: Probe, script: Script, variables: Sequence[Variable], part: float
) -> Iterator[Reading]:
    """Yields readings after steps from the start time, each of a part of the step size."""
    for i in range(_STEPS):
        script.call("do_step", probe.point(0) + i * part * probe.step_size, part * probe.step_size)
        yield script.read(variables)


class _Slopes:
    """Derivatives at communication points beside the slopes of the values before and after them."""

    def __init__(self, values: Sequence[float], derivatives: Sequence[float], step_size: float) -> None:
        slopes = [(b - a) / step_size for a, b in itertools.pairwise(values)]
        self.derivatives = derivatives[1:-1]
        self.sides = list(itertools.pairwise(slopes))
        self.rounding = _NOISE * max(map(abs, values)) / step_size

    def wrong(self, name: str, judged: Callable[[float], bool] = bool) -> list[str]:
        """Returns a message if over half of the derivatives are wrong, and are to be judged: those that are
        not 0, unless `judged` is given.
        """
        pairs = zip(self.derivatives, self.sides, strict=True)
        wrong = [(x, *sides) for x, sides in pairs if judged(x) and self._is_wrong(x, *sides)]
        if len(wrong) <= (len(self.sides) + 1) // 2:  # a jump or an event is not a wrong derivative
            return []
        shown = texts(*wrong[0])
        return [f"{name}: its derivative is {shown[0]}: expected about {shown[1]}..{shown[2]}, its slopes"]

    def _is_wrong(self, derivative: float, before: float, after: float) -> bool:
        margin = 2 * abs(after - before) + _ROUGH * max(abs(before), abs(after)) + self.rounding
        return not min(before, after) - margin <= derivative <= max(before, after) + margin

    def are_late(self) -> bool:
        """Whether each derivative is the mean slope around the communication point before, and not around its
        own: nearer by far, and not for rounding.
        """
        means = [(before + after) / 2 for before, after in self.sides]
        own = [abs(x - mean) for x, mean in zip(self.derivatives[1:], means[1:], strict=True)]
        late = [abs(x - mean) for x, mean in zip(self.derivatives[1:], means, strict=False)]
        return bool(own) and min(own) > _FAR * max([self.rounding, *late])


# the attribute derivative


def _named_derivatives(probe: Probe, part: float) -> Series:
    """Returns the values of each continuous variable that another one names as its derivative, the values of
    that, and the nominal value of the variable; states that events change are left out.
    """
    variables = probe.fmu.variables
    indices = [(v, integer(v.typed.get("derivative")) or 0) for v in variables]
    pairs = [(v, variables[i - 1]) for v, i in indices if 1 <= i <= len(variables) and i != v.index]
    continuous = [
        (v, w)
        for v, w in pairs
        if v.kind == w.kind == "Real"
        and v.variability == w.variability == "continuous"
        and not is_true(w.get("reinit"))
    ]
    if not continuous:
        raise NotApplicableError("no continuous variable without reinit has another as its derivative")
    script, chosen = probe.script().begin(), [x for pair in continuous for x in pair]
    readings = [script.read(chosen), *_read_in_steps(probe, script, chosen, part)]
    script.play()
    rows = [reading.values for reading in readings]
    series = {
        f"{v.name} by {w.name}": [
            *([row[x.name] for row in rows] for x in (w, v)),
            [w.number("nominal") or 1.0],
        ]
        for v, w in continuous
    }
    return {name: lists for name, lists in series.items() if all(map(math.isfinite, itertools.chain(*lists)))}


@behaviour_rule(_ATTRIBUTE, needs="variables-can-be-read communication-points-may-be-rounded")
def derivatives_are_slopes(probe: Probe) -> Iterator[str]:
    """A variable with the attribute derivative is the slope of the variable that it names: in most steps it
    lies near the difference quotients.
    """
    # what repeats with each step moves in steps of another size
    short = _series(probe, "derivatives", _named_derivatives, _SHORT)
    for name, series in _series(probe, "derivatives", _named_derivatives).items():
        messages = _no_slope(name, series, probe.step_size)
        if messages and name in short and _no_slope(name, short[name], _SHORT * probe.step_size):
            yield from messages


def _no_slope(name: str, series: list[list[float]], step_size: float) -> list[str]:
    """Returns a message if neither the integral of a derivative nor its values are right."""
    values, derivatives, _ = series
    if _difference_of_integral(series, step_size) is None:
        return []
    return _Slopes(values, derivatives, step_size).wrong(name, judged=lambda _: True)


@behaviour_rule(_ATTRIBUTE, needs="derivatives-are-slopes")
def derivatives_integrate_to_their_variables(probe: Probe) -> Iterator[str]:
    """A variable changes by the integral of the variable that names it with the attribute derivative."""
    for name, series in _series(probe, "derivatives", _named_derivatives).items():
        if (difference := _difference_of_integral(series, probe.step_size)) is not None:
            shown, (v, state) = texts(*difference), name.split(" by ")
            yield f"{state} changes by {shown[0]} where the integral of {v} is {shown[1]}"


def _difference_of_integral(series: list[list[float]], step_size: float) -> tuple[float, float] | None:
    """Returns the change of a variable and the integral of its derivative, if they are not about the same."""
    values, slopes, nominal = series
    integral = step_size * (sum(slopes) - (slopes[0] + slopes[-1]) / 2)
    variation = sum(abs(b - a) for a, b in itertools.pairwise(slopes))
    margin = step_size * (variation + _INTEGRATED * sum(map(abs, slopes)))
    change = values[-1] - values[0]
    differ = abs(change - integral) > margin + _NOISE * max(map(abs, [*nominal, *values]))
    return (change, integral) if differ else None


# derivatives of outputs


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


def _outputs(probe: Probe, part: float) -> Series:
    """Returns the values of continuous outputs, and their derivatives of each order that is claimed."""
    chosen = continuous_reals(probe, "output")
    orders = range(1, probe.fmu.output_derivative_order + 1) if chosen else ()
    script, references = probe.script(logging=True).begin(), references_of(chosen)
    rows = [
        (reading, [script.call("output_derivatives", references, order) for order in orders])
        for reading in itertools.islice(_read_in_steps(probe, script, chosen, part), 8)
    ]
    script.play()
    return {
        v.name: [
            [reading.values[v.name] for reading, _ in rows],
            *([replies[order - 1].value[i] for _, replies in rows] for order in orders),
        ]
        for i, v in enumerate(chosen)
    }


def _output_slopes(probe: Probe, part: float = 1.0) -> dict[str, _Slopes]:
    series = _series(probe, "derivatives of outputs", _outputs, part)
    return {
        name: _Slopes(values, first, part * probe.step_size)
        for name, (values, first, *_) in series.items()
        if all(map(math.isfinite, values))
    }


_COMPARED = "output-derivatives variables-can-be-read communication-points-may-be-rounded"


@behaviour_rule(
    _TRANSFER, condition=_orders, needs="allowed-calls-succeed communication-points-may-be-rounded"
)
def output_derivatives(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of continuous Real outputs can be read, of each order that is claimed."""
    _series(probe, "derivatives of outputs", _outputs)
    yield from ()


@behaviour_rule(
    "advice: importers extrapolate with finite numbers", condition=_orders, needs="output-derivatives"
)
def output_derivatives_are_finite(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of outputs are finite."""
    for name, (_, *orders) in _series(probe, "derivatives of outputs", _outputs).items():
        for order, derivatives in enumerate(orders, 1):
            wrong = next((x for x in derivatives if not math.isfinite(x)), None)
            if wrong is not None:
                yield f"{name}: derivative of order {order} is {wrong}: expected a finite number"


@behaviour_rule(_TRANSFER, condition=_orders, needs=_COMPARED)
def output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """The first derivative of an output is 0, where its order is lower, or its slope: near the difference
    quotients before and after it.
    """
    short = _output_slopes(probe, _SHORT)
    for name, slopes in _output_slopes(probe).items():
        wrong = slopes.wrong(name)
        if wrong and (not short or (name in short and short[name].wrong(name))):
            yield from wrong
        if not wrong and slopes.are_late():
            yield f"{name}: its derivative is that of the step's begin: expected that of its end"


@behaviour_rule("advice: 4.2.1 allows 0 where the order is lower", condition=_orders, needs=_COMPARED)
def output_derivatives_are_not_zero(probe: Probe) -> Iterator[str]:
    """The first derivative of an output that moves is not 0, as maxOutputDerivativeOrder claims one."""
    for name, slopes in _output_slopes(probe).items():
        yield from slopes.wrong(name, judged=lambda derivative: not derivative)


@behaviour_rule(_TRANSFER, condition=_orders, needs=_COMPARED)
def higher_output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """A derivative of an output of a higher order is 0, where its order is lower, or the slope of the one
    before; each of several that are read in one call is its own.
    """
    messages = list(_read_together(probe))
    yield from messages
    for name, (_, *orders) in _series(probe, "derivatives of outputs", _outputs).items():
        for order, (lower, higher) in enumerate(itertools.pairwise(orders), 2):
            if not messages and all(map(math.isfinite, [*lower, *higher])):
                yield from _Slopes(lower, higher, probe.step_size).wrong(f"{name}, order {order}")


def _read_together(probe: Probe) -> Iterator[str]:
    """Yields derivatives that are others where one call reads several, also of different orders."""
    chosen, highest = continuous_reals(probe, "output"), probe.fmu.output_derivative_order
    references, script = references_of(chosen), probe.script().begin().step(3)
    alone = [
        [script.call("output_derivatives", [reference], order) for order in range(1, highest + 1)]
        for reference in references
    ]
    ones, alternating = [1] * len(chosen), [1 + (highest - 1) * (i % 2) for i in range(len(chosen))]
    choices = [ones, alternating, [1 + highest - order for order in alternating]] if chosen else []
    together = [(orders, script.call("output_derivatives", references, orders)) for orders in choices]
    script.play()
    for orders, reply in together:
        for v, order, got, replies in zip(chosen, orders, reply.value, alone, strict=True):
            expected = replies[order - 1].value[0]
            if not same(got, expected):
                shown = texts(got, expected)
                yield (
                    f"{v.name}: its derivative of order {order} is {shown[0]} read in one call with those of "
                    f"others: expected {shown[1]}, as alone"
                )
                return


# derivatives of inputs


def _derive(script: Script, v: Variable, value: float) -> None:
    script.call("set_input_derivatives", references_of([v]), [1], [value])


@behaviour_rule(_TRANSFER, condition=unless_claimed(INTERPOLATES), needs="allowed-calls-succeed")
def input_derivatives(probe: Probe) -> Iterator[str]:
    """The first derivative of every continuous Real input can be set before a step; zero, also after
    another value, changes nothing."""
    usual, script = probe.script().begin(), probe.script(logging=True).begin()
    expected = usual.run(2)
    for v in continuous_reals(probe, "input"):
        _derive(script, v, 1.0)
        _derive(script, v, 0.0)
    got = script.run(2)
    usual.play()
    script.play()
    yield from differing(expected, got, "where derivatives of inputs were set to 0", RESTARTED)


@behaviour_rule(_TRANSFER, condition=unless_claimed(INTERPOLATES), needs="input-derivatives")
def input_derivatives_have_an_effect(probe: Probe) -> Iterator[str]:
    """The derivative of an input that outputs follow moves them, in the direction of the input itself."""
    effects = _effects(probe)
    backwards = [name for name, effect in effects if effect == "backwards"]
    without = [name for name, effect in effects if effect == "not"]
    if backwards:
        yield f"the derivative of {backwards[0]} moves outputs against the input in a step"
    elif without and not any(effect == "right" for _, effect in effects):
        yield f"the derivative of {without[0]} has no effect in a step, as canInterpolateInputs says it has"


@behaviour_rule(_TRANSFER, condition=unless_claimed(INTERPOLATES), needs="input-derivatives-have-an-effect")
def each_input_derivative_has_an_effect(probe: Probe) -> Iterator[str]:
    """If the derivative of one continuous input has an effect, that of each that outputs follow has one."""
    for name, effect in _effects(probe):
        if effect == "not":
            yield f"the derivative of {name} has no effect in a step, where those of other inputs have one"


def _effects(probe: Probe) -> list[tuple[str, str]]:
    """Returns continuous inputs that take another value, each with what its derivative does to outputs."""
    return probe.once("effects of derivatives", lambda: list(_found_effects(probe)))


def _found_effects(probe: Probe) -> Iterator[tuple[str, str]]:
    for v, value in other_values(continuous_reals(probe, "input")):
        change, held = value - start_value(v), probe.script().begin().step()
        raised, moving = probe.script().begin().step(), probe.script().begin().step()
        for script in (held, raised, moving):
            script.set(v, value if script is raised else start_value(v))
        _derive(moving, v, change / probe.step_size)
        readings = [script.step().read(probe.outputs) for script in (held, raised, moving)]
        probe.play_each([held, raised, moving])
        if not (held.failure or raised.failure or moving.failure):
            yield v.name, _moved(*readings)


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
    input_moved, moved = max(pairs, key=lambda pair: abs(pair[0]))
    is_backwards = input_moved * moved < 0.0 and abs(moved) > _ROUGH * abs(input_moved)
    return "backwards" if is_backwards else "right"


@behaviour_rule(
    _TRANSFER,
    condition=unless_claimed(INTERPOLATES),
    needs="input-derivatives-have-an-effect setting-the-same-changes-nothing variable-step-size",
)
def input_derivatives_are_slopes(probe: Probe) -> Iterator[str]:
    """With its first derivative an input moves an output, which follows it through a state, in a step about
    as far as in short steps in which the input is set to its values on that line.
    """
    if not probe.fmu.claims(_ANY_STEP):
        raise NotApplicableError(f"{_ANY_STEP} is not claimed")
    right = [name for name, effect in _effects(probe) if effect == "right"][:_MOST_INPUTS]
    for v, value in other_values(v for v in continuous_reals(probe, "input") if v.name in right):
        judged = _effects_of_a_line(probe, v, start_value(v), value - start_value(v))
        if judged and all(abs(got - expected) > _APART * abs(expected) for got, expected in judged.values()):
            name, effects = next(iter(judged.items()))
            shown = texts(*effects)
            yield (
                f"the derivative of {v.name} moves {name} by {shown[0]} in a step: expected about "
                f"{shown[1]}, as {_PARTS} short steps along its line do"
            )


def _effects_of_a_line(
    probe: Probe, v: Variable, start: float, change: float
) -> dict[str, tuple[float, float]]:
    """Returns continuous outputs that follow an input through a state -> how far its derivative moves them in
    a step, and how far its values on that line do in short steps.
    """
    scripts, first, last = [], {}, {}
    for parts in (1, _PARTS):
        for shape in ("held", "line", "raised"):
            script, h = probe.script().begin().step(), probe.step_size / parts
            for i in range(parts):
                on_line = (i + 0.5) / parts if parts > 1 else 0.0
                script.set(v, start + change * {"held": 0.0, "line": on_line, "raised": 1.0}[shape])
                if shape == "line" and parts == 1:
                    _derive(script, v, change / probe.step_size)
                script.call("do_step", probe.point(1) + i * h, h)
                last[parts, shape] = script.read(continuous_reals(probe, "output"))
                first.setdefault((parts, shape), last[parts, shape])
            scripts.append(script)
    probe.play_each(scripts)
    if any(script.failure for script in scripts):
        return {}
    judged = {}
    for name in last[1, "held"].values:
        held, moving, raised = (last[1, shape].values[name] for shape in ("held", "line", "raised"))
        short_held, line, converged = (last[_PARTS, s].values[name] for s in ("held", "line", "raised"))
        at_once = first[_PARTS, "raised"].values[name] - first[_PARTS, "held"].values[name]
        effect = converged - short_held
        is_state = abs(at_once) < _THROUGH_A_STATE * abs(effect)
        is_converged = abs(raised - held - effect) <= _CONVERGED * abs(effect)
        if is_state and is_converged and abs(effect) > _NOISE * abs(held) and math.isfinite(moving):
            judged[name] = moving - held, line - short_held
    return judged


@behaviour_rule(
    _TRANSFER,
    condition=unless_claimed(INTERPOLATES),
    needs="input-derivatives-have-an-effect variables-can-be-read",
)
def input_derivatives_are_set_together(probe: Probe) -> Iterator[str]:
    """Derivatives of several inputs that are set in one call act as if each is set in a call of its own, also
    of different orders.
    """
    chosen = [(v, x - start_value(v)) for v, x in other_values(continuous_reals(probe, "input"))]
    if len(chosen) < 2:
        raise NotApplicableError("fewer than two continuous inputs take another value")
    references, ones = references_of([v for v, _ in chosen]), [1] * len(chosen)
    mixed = [1 + i % 2 for i in range(len(chosen))]
    for orders in (ones, mixed, [3 - order for order in mixed]):
        alone, together = probe.script().begin().step(), probe.script().begin().step()
        slopes = [x / probe.step_size**order for (_, x), order in zip(chosen, orders, strict=True)]
        for reference, order, slope in zip(references, orders, slopes, strict=True):
            alone.call("set_input_derivatives", [reference], [order], [slope])
        together.call("set_input_derivatives", references, orders, slopes)
        expected, got = alone.run(2), together.run(2)
        probe.play_each([alone, together])
        if orders != ones and alone.failure:  # an FMU may know the first order alone
            return
        if failure := alone.failure or together.failure:
            raise NotJudgedError(f"a run with derivatives of inputs fails: {failure.problem}")
        messages = list(differing(expected, got, f"where one call sets derivatives of {len(chosen)} inputs"))
        yield from messages
        if messages:
            return
