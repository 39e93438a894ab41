"""Derivatives of outputs, as far as the FMU claims them."""

import itertools
import math
from collections.abc import Iterator, Sequence

from fmus.compliance.comparison import same, texts
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.rules.instance import unknown_reference
from fmus.compliance.script import Reply
from fmus.compliance.slopes import Comparison, compared, read_in_steps, with_short_steps, wrong_slope
from fmus.compliance.values import INTERPOLATES, continuous_reals, references_of, unless_claimed
from fmus.compliance.variable import Variable
from fmus.fmi.binding import DISCARD, ERROR

_TRANSFER = "4.2.1 Transfer of Input / Output Values and Parameters"
_FAR = 10.0  # times: a derivative of one communication point, and not of the next
_STEPS = 8
_TO_COMPARE = "output-derivatives variables-can-be-read communication-points-may-be-rounded"


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


def _no_derivatives(fmu: FmuFile) -> str:
    return _orders(fmu) and unless_claimed(INTERPOLATES)(fmu) and "no derivatives are claimed"


@behaviour_rule(_TRANSFER, condition=_orders, needs="allowed-calls-succeed")
def output_derivatives(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of continuous Real outputs can be read, of each order that is claimed."""
    probe.once("derivatives of outputs", lambda: _derivatives(probe))
    yield from ()


def _derivatives(probe: Probe) -> list[tuple[str, int, float]]:
    """Returns (name of an output, order, derivative) after a step."""
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


@behaviour_rule(
    "advice: importers extrapolate with finite numbers",
    condition=_orders,
    needs="output-derivatives",
)
def output_derivatives_are_finite(probe: Probe) -> Iterator[str]:
    """After a step the derivatives of outputs are finite."""
    for name, order, value in probe.once("derivatives of outputs", lambda: _derivatives(probe)):
        if not math.isfinite(value):
            yield f"{name}: derivative of order {order} is {value}: expected a finite number"


@behaviour_rule(_TRANSFER, condition=_orders, needs=_TO_COMPARE)
def output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """The first derivative of an output is 0, where its order is lower, or its slope: near the difference
    quotients before and after it.
    """
    for name, comparisons in probe.once("slopes of outputs", lambda: _slopes(probe, 1.0)).items():
        wrong = list(wrong_slope(name, comparisons))
        if wrong and _are_wrong_in_short_steps(probe, name):
            yield from wrong
        if not wrong and _are_late(comparisons):
            yield f"{name}: its derivative is that of the step's begin: expected that of its end"


def _are_wrong_in_short_steps(probe: Probe, name: str) -> bool:
    """Whether the derivatives of an output are wrong in steps of another size too, if it takes them."""
    slopes = with_short_steps(probe, "slopes in short steps", _slopes)
    return slopes is None or any(wrong_slope(name, slopes.get(name, ())))


@behaviour_rule("advice: 4.2.1 allows 0 where the order is lower", condition=_orders, needs=_TO_COMPARE)
def output_derivatives_are_not_zero(probe: Probe) -> Iterator[str]:
    """The first derivative of an output that moves is not 0, as maxOutputDerivativeOrder claims one."""
    for name, comparisons in probe.once("slopes of outputs", lambda: _slopes(probe, 1.0)).items():
        yield from wrong_slope(name, comparisons, judged=lambda derivative: not derivative)


def _slopes(probe: Probe, part: float) -> dict[str, list[Comparison]]:
    """Returns the name of an output -> its derivatives at communication points, beside its slopes.

    part: of the step size, for each step
    """
    chosen = continuous_reals(probe, "output")
    script, readings, replies = probe.script().begin(), [], []
    for reading in read_in_steps(probe, script, chosen, _STEPS, part):
        readings.append(reading)
        if chosen:
            replies.append(script.call("output_derivatives", references_of(chosen), 1))
    script.play()
    comparisons: dict[str, list[Comparison]] = {}
    for index, v in enumerate(chosen):
        values = [reading.values[v.name] for reading in readings]
        if all(map(math.isfinite, values)):
            derivatives = [reply.value[index] for reply in replies]
            comparisons[v.name] = compared(values, derivatives, part * probe.step_size)
    return comparisons


def _are_late(comparisons: list[Comparison]) -> bool:
    """Whether each derivative is the mean slope around the communication point before, and not around its
    own: nearer by far, and not for rounding.
    """
    means = [(before + after) / 2 for _, before, after, _ in comparisons]
    own = [abs(c[0] - mean) for c, mean in zip(comparisons[1:], means[1:], strict=True)]
    late = [abs(c[0] - mean) for c, mean in zip(comparisons[1:], means, strict=False)]
    rounding = max((c[3] for c in comparisons), default=0.0)
    return bool(own) and min(own) > _FAR * max([rounding, *late])


@behaviour_rule(_TRANSFER, condition=_orders, needs=_TO_COMPARE)
def higher_output_derivatives_are_right(probe: Probe) -> Iterator[str]:
    """A derivative of an output of a higher order is 0, where its order is lower, or the slope of the one
    before; each of several that are read in one call is its own.
    """
    chosen, highest = continuous_reals(probe, "output"), probe.fmu.output_derivative_order
    references, orders = references_of(chosen), range(1, highest + 1) if chosen else ()
    script, replies = probe.script().begin(), []
    for _ in range(_STEPS):
        script.step()
        replies.append([script.call("output_derivatives", references, order) for order in orders])
    alone = [script.call("output_derivatives", [reference], 1) for reference in references]
    alternating = [1 + (highest - 1) * (i % 2) for i in range(len(chosen))]
    mixed = [
        (several, script.call("output_derivatives", references, several))
        for several in (alternating, [1 + highest - order for order in alternating])
        if chosen and highest > 1
    ]
    script.play()
    if message := next(_of_other_orders(chosen, mixed, replies[-1]), ""):
        yield message
        return
    for index, v in enumerate(chosen):
        value, last = alone[index].value[0], replies[-1][0].value[index]
        if not same(value, last):
            shown = texts(value, last)
            yield f"{v.name}: its derivative is {shown[0]} read alone and {shown[1]} with those of others"
        series = [[reply[order - 1].value[index] for reply in replies] for order in orders]
        for order, (lower, higher) in enumerate(itertools.pairwise(series), 2):
            if all(map(math.isfinite, [*lower, *higher])):
                yield from wrong_slope(f"{v.name}, order {order}", compared(lower, higher, probe.step_size))


def _of_other_orders(
    chosen: Sequence[Variable], mixed: Sequence[tuple[Sequence[int], Reply]], expected: Sequence[Reply]
) -> Iterator[str]:
    """Yields messages of derivatives that are others where one call reads several orders.

    mixed: the order of each output in a call, and its reply; expected: a reply for each order
    """
    for orders, reply in mixed:
        for i, (v, order) in enumerate(zip(chosen, orders, strict=True)):
            shown = texts(reply.value[i], expected[order - 1].value[i])
            if not same(reply.value[i], expected[order - 1].value[i]):
                yield (
                    f"{v.name}: its derivative of order {order} is {shown[0]} read in one call with other "
                    f"orders: expected {shown[1]}"
                )


@behaviour_rule(
    "2.1.2 Platform Dependent Definitions (fmi2TypesPlatform.h)",
    condition=_no_derivatives,
    last=True,
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
