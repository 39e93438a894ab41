"""Derivatives of outputs and of inputs in time, beside finite differences."""

import itertools
import math
from collections.abc import Iterator
from functools import partial

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, differences, differential
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.rules import finite_differences as finite
from fmus.compliance.variable import Variable

_TRANSFER = "4.2.1"
_INTERPOLATES = values.unless_claimed(values.INTERPOLATES)
_STEPS = 8
_SHORT = 0.30901699  # of a step: no simple fraction, so that nothing that repeats with it stands still
_BACKWARDS = 0.1  # of the effect of the input, at least


# derivatives of outputs


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


_rule_of_outputs = partial(behaviour_rule, condition=_orders)


def _outputs(probe: Probe, part: float = 1.0) -> dict[str, list[list[float]]]:
    """Returns the values of continuous outputs, and their derivatives of each order that is claimed."""
    chosen = values.continuous_reals(probe, "output")
    return finite.series(probe, chosen, _STEPS, part, probe.fmu.output_derivative_order)


def _output_slopes(probe: Probe, part: float = 1.0) -> dict[str, finite.Slopes]:
    return {
        name: finite.Slopes(outputs, first, part * probe.step_size)
        for name, (outputs, first, *_) in _outputs(probe, part).items()
        if all(map(math.isfinite, outputs))
    }


@_rule_of_outputs("4.2.1")
def output_derivatives(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of continuous Real outputs can be read, of each order that is claimed."""
    _outputs(probe)
    yield from ()


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
    chosen, highest = values.continuous_reals(probe, "output"), probe.fmu.output_derivative_order
    alternating = [1 + (highest - 1) * (i % 2) for i in range(len(chosen))]
    for orders in ([1] * len(chosen), alternating, [1 + highest - order for order in alternating]):
        names = " or ".join(str(order) for order in sorted(set(orders)))
        when = f"as derivative of order {names}, read in one call with those of others"
        together, alone = (do.read_slopes(chosen, orders=orders, alone=x) for x in (False, True))
        begin = do.begin, do.step(3)
        yield Row(when, (*begin, together), (*begin, alone), again="{}, as alone")


# derivatives of inputs


_rule_of_inputs = partial(behaviour_rule, _TRANSFER, _INTERPOLATES)


@differential("4.2.1", condition=_INTERPOLATES)
def input_derivatives(_: Probe) -> Iterator[Row]:
    """The first derivative of every continuous Real input can be set before a step; zero, also after
    another value, changes nothing."""
    varied = do.begin, do.set_derivatives(1.0), do.set_derivatives(0.0), do.run(2)
    yield Row("where derivatives of inputs were set to 0", varied, failing="", tolerance=values.RESTARTED)


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
    for v, value in values.other_values(values.continuous_reals(probe, "input")):
        start = values.start_value(v)
        # held, with another value, and moving to that by its derivative
        ways = (start, None), (value, None), (start, (value - start) / probe.step_size)
        runs = finite.values_of(
            probe, (finite.in_steps(probe, v, [x], probe.step_size, slope) for x, slope in ways)
        )
        held, raised, moving = (rows[0] for rows in runs) if all(runs) else ({}, {}, {})
        names = [name for name, x in held.items() if isinstance(x, float) and raised[name] != x]
        pairs = [(raised[name] - held[name], moving[name] - held[name]) for name in names]
        if pairs:
            effect, moved = max(pairs, key=lambda pair: abs(pair[0]))
            is_backwards = effect * moved < 0.0 and abs(moved) > _BACKWARDS * abs(effect)
            is_none = all(moved == 0.0 for _, moved in pairs)
            inputs["none" if is_none else "backwards" if is_backwards else "right"].append(v)
    return inputs


@differential("4.2.1", condition=_INTERPOLATES)
def input_derivatives_are_set_together(probe: Probe) -> Iterator[Row]:
    """Derivatives of several inputs that are set in one call act as if each is set in a call of its own, also
    of different orders.
    """
    pairs = values.other_values(values.continuous_reals(probe, "input"))
    if len(pairs) < 2:
        raise NotApplicableError("fewer than two continuous inputs take another value")
    mixed = [1 + i % 2 for i in range(len(pairs))]
    second = do.played(probe, (do.begin, do.set_derivatives(0.0, order=2)))
    # it may know the first order alone, and tell so by a warning
    mixtures = [] if second.replies[-1].status else [mixed, [3 - order for order in mixed]]
    for orders in ([1] * len(pairs), *mixtures):
        slopes = [
            (values.references_of([v]), [order], [(x - values.start_value(v)) / probe.step_size**order])
            for (v, x), order in zip(pairs, orders, strict=True)
        ]
        alone = (do.call("set_input_derivatives", *one) for one in slopes)
        together = do.call(
            "set_input_derivatives", *(list(itertools.chain(*some)) for some in zip(*slopes, strict=True))
        )
        when = f"where one call sets derivatives of {len(pairs)} inputs"
        begin, end = (do.begin, do.step()), do.run(2)
        yield Row(when, (*begin, together, end), (*begin, *alone, end), may_fail=True)
