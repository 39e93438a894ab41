"""Derivatives of outputs and of inputs in time, beside finite differences."""

import math
from collections.abc import Iterator, Sequence
from itertools import chain, product

from fmus.compliance import actions as do
from fmus.compliance import values
from fmus.compliance.differential import Row, Start, differential, starts
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.rules import finite_differences as finite
from fmus.compliance.script import Action, CallError
from fmus.compliance.variable import Variable

_INTERPOLATES = values.unless_claimed(values.INTERPOLATES)
_STEPS = 8
_SHORT = 0.30901699  # of a step: no simple fraction, so that nothing that repeats with it stands still
_BACKWARDS = 0.1  # of the effect of the input, at least


# derivatives of outputs


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


def _output_slopes(probe: Probe, order: int, start: Start, part: float = 1.0) -> dict[str, finite.Slopes]:
    """Returns derivatives of an order of continuous outputs beside the slopes of those of one less, after
    steps of a part of the step size from a start of runs; none where short steps fail. Raises CallError where
    steps of the usual size fail.
    """
    size, outputs = part * probe.step_size, values.continuous_reals(probe, "output")
    read = do.read_slopes(outputs, order=order - 1), do.read_slopes(outputs, order=order)

    def step(i: int) -> Action:
        return lambda script: script.call("do_step", script.time + i * size, size)

    steps = chain(*((step(i), *read) for i in range(_STEPS if outputs else 0)))
    script = do.played(probe, [do.begin, *start.lead, *steps], logging=True)
    if (failure := script.failure) and part == 1.0:
        raise CallError(failure.problem)
    rows = [] if failure else [reading.values for reading in script.readings]
    series = ((v.name, *([row[v.name] for row in rows[k::2]] for k in range(2))) for v in outputs)
    return {
        name: finite.Slopes(xs, slopes, size, order)
        for name, xs, slopes in series
        if xs and all(map(math.isfinite, xs))
    }


@behaviour_rule("4.2.1", condition=_orders)
def output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """A derivative of an output is 0, where its order is lower, or the slope of what is of one order less:
    near the difference quotients before and after it, the higher the order the less near; at the begin of a
    run and later in it.
    """
    orders = range(1, probe.fmu.output_derivative_order + 1)
    for start, order in product(starts(probe)[:3] if orders else (), orders):
        short = _output_slopes(probe, order, start, _SHORT) if probe.fmu.claims(finite.ANY_STEP) else {}
        for name, slopes in _output_slopes(probe, order, start).items():
            of, wrong = f"{name}, order {order}" if order > 1 else name, slopes.wrong()
            of += start.words
            if wrong and (not short or (name in short and short[name].wrong())):
                yield f"{of}: {wrong}"
            if order == 1 and not wrong and slopes.are_late():
                yield f"{of}: its derivative is that of the step's begin: expected that of its end"


# derivatives of inputs


@differential("4.2.1", condition=_INTERPOLATES)
def input_derivatives(_: Probe) -> Iterator[Row]:
    """The first derivative of every continuous Real input can be set before a step; zero, also after
    another value, changes nothing."""
    varied = do.begin, do.set_derivatives(1.0), do.set_derivatives(0.0), do.run(2)
    yield Row("where derivatives of inputs were set to 0", varied, failing="", tolerance=values.RESTARTED)


@behaviour_rule("4.2.1", condition=_INTERPOLATES)
def input_derivatives_have_an_effect(probe: Probe) -> Iterator[str]:
    """The derivative of an input that outputs follow moves them, in the direction of the input itself."""
    inputs = _inputs_by_effect(probe)
    if inputs["backwards"]:
        yield f"the derivative of {inputs['backwards'][0].name} moves outputs against the input in a step"
    for v in inputs["none"]:
        yield f"the derivative of {v.name} has no effect in a step, as canInterpolateInputs says it has"


def _step(probe: Probe, v: Variable, x: float, slope: float = 0.0) -> Sequence[Action]:
    """Returns actions that make a step with a value of an input, and a derivative unless that is 0."""
    derivative = do.call("fmi2SetRealInputDerivatives", values.references_of([v]), 1, [1], [slope])
    begin = do.begin, do.step(), do.set_values([(v, x)])
    return *begin, *([derivative] if slope else []), do.step(), do.read(probe.outputs)


def _inputs_by_effect(probe: Probe) -> dict[str, list[Variable]]:
    """Returns continuous inputs by what their derivatives do to outputs that follow them."""
    inputs: dict[str, list[Variable]] = {"right": [], "none": [], "backwards": []}
    for v, value in values.other_values(values.continuous_reals(probe, "input")):
        start = values.start_value(v)
        slope = (value - start) / probe.step_size
        # held, with another value, and moving to that by its derivative
        runs = finite.values_of(
            probe, [_step(probe, v, *way) for way in ((start,), (value,), (start, slope))]
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
