"""Rules of the derivative of an input: it moves what follows as far as the input itself on that line."""

import math
from collections.abc import Callable, Iterator

from fmus.compliance.comparison import differing, texts
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.rules.input_derivative import derive, input_effects
from fmus.compliance.script import Reading, Script
from fmus.compliance.values import (
    INTERPOLATES,
    continuous_reals,
    other_value,
    other_values,
    references_of,
    start_value,
    unless_claimed,
)
from fmus.compliance.variable import Variable

_ANY_STEP = "canHandleVariableCommunicationStepSize"
_MOST_INPUTS = 10  # each of which costs six instances
_PARTS = 8  # short steps in the place of one
_CONVERGED = 0.05  # relative: a solver that short steps change more is too coarse to judge
_THROUGH_A_STATE = 0.3  # of an effect at most, after a short step: a direct one is as large at once
_APART = 0.35  # relative: less than what a half or a double is away
_NOISE = 1e-9  # relative


@behaviour_rule(
    "4.2.1 Transfer of Input / Output Values and Parameters",
    condition=unless_claimed(INTERPOLATES),
    needs="input-derivatives-have-an-effect setting-the-same-changes-nothing variable-step-size",
)
def input_derivatives_are_slopes(probe: Probe) -> Iterator[str]:
    """With its first derivative an input moves an output, which follows it through a state, in a step about
    as far as in short steps in which the input is set to its values on that line.
    """
    if not probe.fmu.claims(_ANY_STEP):
        raise NotApplicableError(f"{_ANY_STEP} is not claimed")
    verdicts = dict(probe.once("effects of derivatives", lambda: input_effects(probe)))
    inputs = [v for v in continuous_reals(probe, "input") if verdicts.get(v.name) == "right"]
    for v in inputs[:_MOST_INPUTS]:
        if (value := other_value(v)) is not None:
            yield from _wrong_effect(probe, v, value - start_value(v))


def _run(
    probe: Probe, v: Variable, value: Callable[[float], float], parts: int, slope: float = 0.0
) -> tuple[Script, Reading, Reading]:
    """Continuous outputs after the first and the last of some parts of a step.

    value: of the input, by the middle of a part [parts of the step]; slope: its derivative, set before
    """
    script = probe.script().begin().step()
    t, h, readings = probe.point(1), probe.step_size / parts, []
    for i in range(parts):
        script.set(v, value((i + 0.5) / parts))
        if slope:
            derive(script, v, slope)
        script.call("do_step", t + i * h, h)
        readings.append(script.read(continuous_reals(probe, "output")))
    return script, readings[0], readings[-1]


def _wrong_effect(probe: Probe, v: Variable, change: float) -> Iterator[str]:
    """Yields a message if the derivative of the input moves each output that can be judged otherwise."""
    start = start_value(v)
    runs = [
        _run(probe, v, lambda _: start, 1),
        _run(probe, v, lambda _: start, 1, change / probe.step_size),
        _run(probe, v, lambda _: start + change, 1),
        _run(probe, v, lambda _: start, _PARTS),
        _run(probe, v, lambda part: start + change * part, _PARTS),
        _run(probe, v, lambda _: start + change, _PARTS),
    ]
    probe.play_each([script for script, *_ in runs])
    if any(script.failure for script, *_ in runs):
        return
    judged = {}
    for name in runs[0][2].values:
        held, moving, raised, short_held, line, short_raised = (last.values[name] for *_, last in runs)
        whole, converged = raised - held, short_raised - short_held
        first = runs[5][1].values[name] - runs[3][1].values[name]
        is_state = abs(first) < _THROUGH_A_STATE * abs(converged)
        same = abs(whole - converged) <= _CONVERGED * abs(converged)
        if is_state and same and abs(converged) > _NOISE * abs(held) and math.isfinite(moving):
            judged[name] = moving - held, line - short_held
    if judged and all(abs(a - b) > _APART * abs(b) for a, b in judged.values()):
        name, (got, expected) = next(iter(judged.items()))
        shown = texts(got, expected)
        yield (
            f"the derivative of {v.name} moves {name} by {shown[0]} in a step: expected about {shown[1]}, as "
            f"{_PARTS} short steps along its line do"
        )


@behaviour_rule(
    "4.2.1 Transfer of Input / Output Values and Parameters",
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
    ones, mixed = [1] * len(chosen), [1 + i % 2 for i in range(len(chosen))]
    for orders in (ones, mixed, [3 - order for order in mixed]):
        alone, together = probe.script().begin().step(), probe.script().begin().step()
        slopes = [x / probe.step_size**order for (_, x), order in zip(chosen, orders, strict=True)]
        references = references_of([v for v, _ in chosen])
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
