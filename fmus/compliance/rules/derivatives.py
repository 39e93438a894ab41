"""Derivatives in time, of variables that others name, of outputs and of inputs, beside finite differences."""

import itertools
import math
from collections.abc import Iterator, Sequence
from functools import partial

from fmus.compliance import actions as do
from fmus.compliance.differential import Row, differences, differential
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.rules import finite_differences as finite
from fmus.compliance.script import Action, Reading, Script
from fmus.compliance.values import (
    INTERPOLATES,
    RESTARTED,
    continuous_reals,
    other_values,
    references_of,
    start_value,
    texts,
    unless_claimed,
)
from fmus.compliance.variable import Variable, is_true

_TRANSFER = "4.2.1"
_INTERPOLATES = unless_claimed(INTERPOLATES)
_STEPS, _STEPS_OF_OUTPUTS = 30, 8
_SHORT = 0.30901699  # of a step: no simple fraction, so that nothing that repeats with it stands still
_BACKWARDS = 0.1  # of the effect of the input, at least
_MOST_INPUTS = 10  # each of which costs six instances
_PARTS = 8  # short steps in the place of one
_CONVERGED = 0.05  # relative: a solver that short steps change more is too coarse to judge
_THROUGH_A_STATE = 0.3  # of an effect at most, after a short step: a direct one is as large at once
_APART = 0.35  # relative: less than what a half or a double is away


# the attribute derivative


def _named_slopes(probe: Probe, part: float = 1.0) -> list[tuple[Variable, Variable, finite.Slopes]]:
    """Returns each continuous variable that names another one as its integral, the other one, and the slopes
    of that; states that events change are left out.
    """
    stated = ((probe.fmu.variables[index - 1], v) for index, v in probe.fmu.derivatives.items())
    pairs = [
        (derivative, v)
        for derivative, v in stated
        if derivative.kind == v.kind == "Real"
        and derivative.variability == v.variability == "continuous"
        and not is_true(v.get("reinit"))
    ]
    if not pairs:
        raise NotApplicableError("no continuous variable without reinit has another as its derivative")
    table = finite.series(probe, list(itertools.chain(*pairs)), _STEPS, part)
    columns = [(d, v, table[v.name][0], table[d.name][0]) for d, v in pairs if table]
    return [
        (d, v, finite.Slopes(values, derivatives, part * probe.step_size))
        for d, v, values, derivatives in columns
        if all(map(math.isfinite, [*values, *derivatives]))
    ]


def _no_slopes(probe: Probe, part: float = 1.0) -> dict[str, str]:
    """Returns a message for each variable by a derivative whose integral is wrong and whose values are."""
    return {
        f"{d.name} by {v.name}": message
        for d, v, slopes in _named_slopes(probe, part)
        if slopes.difference_of_integral(v.nominal) and (message := slopes.wrong(judged=lambda _: True))
    }


@behaviour_rule("2.2.7")
def derivatives_are_slopes(probe: Probe) -> Iterator[str]:
    """A variable with the attribute derivative is the slope of the variable that it names: in most steps it
    lies near the difference quotients.
    """
    wrong = _no_slopes(probe)
    # what repeats with each step moves in steps of another size
    short = _no_slopes(probe, _SHORT) if wrong and probe.fmu.claims(finite.ANY_STEP) else {}
    yield from (f"{name}: {message}" for name, message in wrong.items() if name in short)


@behaviour_rule("2.2.7")
def derivatives_integrate_to_their_variables(probe: Probe) -> Iterator[str]:
    """A variable changes by the integral of the variable that names it with the attribute derivative."""
    for derivative, v, slopes in _named_slopes(probe):
        if difference := slopes.difference_of_integral(v.nominal):
            shown = texts(*difference)
            yield f"{v.name} changes by {shown[0]} where the integral of {derivative.name} is {shown[1]}"


# derivatives of outputs


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


_rule_of_outputs = partial(behaviour_rule, condition=_orders)


def _outputs(probe: Probe, part: float = 1.0) -> dict[str, list[list[float]]]:
    """Returns the values of continuous outputs, and their derivatives of each order that is claimed."""
    chosen = continuous_reals(probe, "output")
    return finite.series(probe, chosen, _STEPS_OF_OUTPUTS, part, probe.fmu.output_derivative_order)


def _output_slopes(probe: Probe, part: float = 1.0) -> dict[str, finite.Slopes]:
    return {
        name: finite.Slopes(values, first, part * probe.step_size)
        for name, (values, first, *_) in _outputs(probe, part).items()
        if all(map(math.isfinite, values))
    }


@_rule_of_outputs("4.2.1")
def output_derivatives(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of continuous Real outputs can be read, of each order that is claimed."""
    _outputs(probe)
    yield from ()


@_rule_of_outputs("advice: importers extrapolate with finite numbers")
def output_derivatives_are_finite(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of outputs are finite."""
    for name, (_, *orders) in _outputs(probe).items():
        for order, derivatives in enumerate(orders, 1):
            wrong = next((x for x in derivatives if not math.isfinite(x)), None)
            if wrong is not None:
                yield f"{name}: derivative of order {order} is {wrong}: expected a finite number"


@_rule_of_outputs("4.2.1")
def output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """The first derivative of an output is 0, where its order is lower, or its slope: near the difference
    quotients before and after it.
    """
    short = _output_slopes(probe, _SHORT) if probe.fmu.claims(finite.ANY_STEP) else {}
    for name, slopes in _output_slopes(probe).items():
        wrong = slopes.wrong()
        if wrong and (not short or (name in short and short[name].wrong())):
            yield f"{name}: {wrong}"
        if not wrong and slopes.are_late():
            yield f"{name}: its derivative is that of the step's begin: expected that of its end"


@_rule_of_outputs("advice: 4.2.1 allows 0 where the order is lower")
def output_derivatives_are_not_zero(probe: Probe) -> Iterator[str]:
    """The first derivative of an output that moves is not 0, as maxOutputDerivativeOrder claims one."""
    for name, slopes in _output_slopes(probe).items():
        if wrong := slopes.wrong(judged=lambda derivative: not derivative):
            yield f"{name}: {wrong}"


@_rule_of_outputs("4.2.1")
def higher_output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """A derivative of an output of a higher order is 0, where its order is lower, or the slope of the one
    before; each of several that are read in one call is its own.
    """
    messages = list(differences(probe, _read_together(probe)))
    yield from messages
    for name, (_, *orders) in _outputs(probe).items() if not messages else ():
        for order, (lower, higher) in enumerate(itertools.pairwise(orders), 2):
            is_finite = all(map(math.isfinite, [*lower, *higher]))
            if is_finite and (wrong := finite.Slopes(lower, higher, probe.step_size).wrong()):
                yield f"{name}, order {order}: {wrong}"


def _read_together(probe: Probe) -> Iterator[Row]:
    """Yields rows of derivatives that one call reads, all of the first order, and of different ones."""
    chosen, highest = continuous_reals(probe, "output"), probe.fmu.output_derivative_order
    alternating = [1 + (highest - 1) * (i % 2) for i in range(len(chosen))]
    for orders in ([1] * len(chosen), alternating, [1 + highest - order for order in alternating]):
        names = " or ".join(str(order) for order in sorted(set(orders)))
        when = f"as derivative of order {names}, read in one call with those of others"
        begin, together = (do.begin, do.step(3)), do.read_slopes(chosen, orders=orders)
        yield Row(when, (*begin, together), (*begin, _read_alone(chosen, orders)), again="{}, as alone")


def _read_alone(outputs: Sequence[Variable], orders: Sequence[int]) -> Action:
    """Reads derivatives of outputs, each in a call of its own."""

    def action(script: Script) -> None:
        replies = {
            v.name: script.call("output_derivatives", references_of([v]), order)
            for v, order in zip(outputs, orders, strict=True)
        }
        script.observed.append(("", "", Reading({v.name: [v] for v in outputs}, replies)))

    return action


# derivatives of inputs


_rule_of_inputs = partial(behaviour_rule, _TRANSFER, _INTERPOLATES)


@differential("4.2.1", condition=_INTERPOLATES)
def input_derivatives(_: Probe) -> Iterator[Row]:
    """The first derivative of every continuous Real input can be set before a step; zero, also after
    another value, changes nothing."""
    varied = do.begin, do.set_derivatives(1.0), do.set_derivatives(0.0), do.run(2)
    yield Row("where derivatives of inputs were set to 0", varied, failing="", tolerance=RESTARTED)


@_rule_of_inputs()
def input_derivatives_have_an_effect(probe: Probe) -> Iterator[str]:
    """The derivative of an input that outputs follow moves them, in the direction of the input itself."""
    inputs = _inputs_by_effect(probe)
    if inputs["backwards"]:
        yield f"the derivative of {inputs['backwards'][0].name} moves outputs against the input in a step"
    elif inputs["none"] and not inputs["right"]:
        without = f"the derivative of {inputs['none'][0].name} has no effect in a step"
        yield f"{without}, as canInterpolateInputs says it has"


@_rule_of_inputs()
def each_input_derivative_has_an_effect(probe: Probe) -> Iterator[str]:
    """If the derivative of one continuous input has an effect, that of each that outputs follow has one."""
    for v in _inputs_by_effect(probe)["none"]:
        yield f"the derivative of {v.name} has no effect in a step, where those of other inputs have one"


def _inputs_by_effect(probe: Probe) -> dict[str, list[Variable]]:
    """Returns continuous inputs by what their derivatives do to outputs that follow them."""
    inputs: dict[str, list[Variable]] = {"right": [], "none": [], "backwards": []}
    for v, value in other_values(continuous_reals(probe, "input")):
        runs = _runs_to(probe, v, value, 1)
        held, raised, moving = (rows[0] for rows in runs) if all(runs) else ({}, {}, {})
        names = [name for name, x in held.items() if isinstance(x, float) and raised[name] != x]
        pairs = [(raised[name] - held[name], moving[name] - held[name]) for name in names]
        if pairs:
            effect, moved = max(pairs, key=lambda pair: abs(pair[0]))
            is_backwards = effect * moved < 0.0 and abs(moved) > _BACKWARDS * abs(effect)
            is_none = all(moved == 0.0 for _, moved in pairs)
            inputs["none" if is_none else "backwards" if is_backwards else "right"].append(v)
    return inputs


def _runs_to(probe: Probe, v: Variable, value: float, parts: int) -> list[list[finite.Values]]:
    """Returns the outputs after each part of a step, of an input that is held, one that has another value,
    and one that moves to it: by its derivative in one step, by its values in short steps.
    """
    start, size = start_value(v), probe.step_size / parts
    on_line = [start + (value - start) * (i + 0.5) / parts for i in range(parts)]
    moving = (on_line, None) if parts > 1 else ([start], (value - start) / size)
    runs = ([start] * parts, None), ([value] * parts, None), moving
    return finite.values_of(probe, [finite.in_steps(probe, v, xs, size, slope) for xs, slope in runs])


@_rule_of_inputs()
def input_derivatives_are_slopes(probe: Probe) -> Iterator[str]:
    """With its first derivative an input moves an output, which follows it through a state, in a step about
    as far as in short steps in which the input is set to its values on that line.
    """
    if not probe.fmu.claims(finite.ANY_STEP):
        raise NotApplicableError(f"{finite.ANY_STEP} is not claimed")
    for v, value in other_values(_inputs_by_effect(probe)["right"][:_MOST_INPUTS]):
        judged = list(_effects_of_a_line(probe, v, value))
        if judged and all(abs(got - expected) > _APART * abs(expected) for _, got, expected in judged):
            name, *effects = judged[0]
            shown = texts(*effects)
            yield (
                f"the derivative of {v.name} moves {name} by {shown[0]} in a step: expected about "
                f"{shown[1]}, as {_PARTS} short steps along its line do"
            )


def _effects_of_a_line(probe: Probe, v: Variable, value: float) -> Iterator[tuple[str, float, float]]:
    """Yields continuous outputs that follow an input through a state, with how far its derivative moves them
    in a step, and how far its values on that line do in short steps.
    """
    one, short = (_runs_to(probe, v, value, parts) for parts in (1, _PARTS))
    for name in [output.name for output in continuous_reals(probe, "output") if all((*one, *short))]:
        held, raised, moving = (rows[-1][name] for rows in one)
        short_held, converged, line = (rows[-1][name] for rows in short)
        effect, at_once = converged - short_held, short[1][0][name] - short[0][0][name]
        halfway = short[1][_PARTS // 2][name] - short[0][_PARTS // 2][name]
        # an output that is sampled once, late in the step, has not moved halfway and follows no line
        is_state = abs(at_once) < _THROUGH_A_STATE * abs(effect) and halfway != 0.0
        is_converged = abs(raised - held - effect) <= _CONVERGED * abs(effect)
        if is_state and is_converged and abs(effect) > finite.NOISE * abs(held) and math.isfinite(moving):
            yield name, moving - held, line - short_held


@differential("4.2.1", condition=_INTERPOLATES)
def input_derivatives_are_set_together(probe: Probe) -> Iterator[Row]:
    """Derivatives of several inputs that are set in one call act as if each is set in a call of its own, also
    of different orders.
    """
    changes = [(v, x - start_value(v)) for v, x in other_values(continuous_reals(probe, "input"))]
    if len(changes) < 2:
        raise NotApplicableError("fewer than two continuous inputs take another value")
    references, mixed = references_of(v for v, _ in changes), [1 + i % 2 for i in range(len(changes))]
    # an FMU may know the first order alone, and tell so by a warning
    second = do.played(probe, (do.begin, do.set_derivatives(0.0, order=2))).replies[-1]
    mixtures = [] if second.status else [mixed, [3 - order for order in mixed]]
    for orders in ([1] * len(changes), *mixtures):
        slopes = [x / probe.step_size**order for (_, x), order in zip(changes, orders, strict=True)]
        alone = [
            do.call("set_input_derivatives", *([argument] for argument in arguments))
            for arguments in zip(references, orders, slopes, strict=True)
        ]
        begin, end = (do.begin, do.step()), do.run(2)
        together = *begin, do.call("set_input_derivatives", references, orders, slopes), end
        when = f"where one call sets derivatives of {len(changes)} inputs"
        yield Row(when, together, (*begin, *alone, end), may_fail=True)
