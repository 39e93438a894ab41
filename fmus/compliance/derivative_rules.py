"""Behaviour of derivatives: of inputs, of outputs, and directional ones, as far as the FMU claims them."""

import math
from collections.abc import Iterator

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.instance import CallError
from fmus.compliance.lifecycle_rules import unless_claimed
from fmus.compliance.probe import Instance, Probe
from fmus.compliance.rule import Stage, rule
from fmus.compliance.variable import Variable, integer

_TRANSFER = "4.2.1 Transfer of Input / Output Values and Parameters"
_DIRECTIONAL = "2.1.9 Getting Partial Derivatives"
_MOST_KNOWNS = 40  # of one FMU: each costs four evaluations
_DIFFERENCE = 1e-6  # relative change for a difference quotient: half the digits for truncation and rounding
_AGREEMENT = 1e-4  # relative; a wrong derivative is wrong by much more


def _orders(fmu: FmuFile) -> str:
    return "" if fmu.output_derivative_order > 0 else "maxOutputDerivativeOrder is 0"


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=unless_claimed("canInterpolateInputs"))
def input_derivatives(probe: Probe) -> Iterator[str]:
    """The first derivative of every continuous Real input can be set before a step, which then succeeds."""
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        for v in probe.real("input"):
            if v.variability == "continuous":
                instance.set_input_derivative(v, 1, 0.0)
        probe.run(instance, 2)
    yield from ()


@rule(_TRANSFER, Stage.BEHAVIOUR, condition=_orders)
def output_derivatives(probe: Probe) -> Iterator[str]:
    """After a step every continuous Real output has a finite derivative of each order that is claimed."""
    chosen = [v for v in probe.real("output") if v.variability == "continuous"]
    with probe.instance() as instance:
        instance.enter_step_mode(probe.start_time)
        probe.run(instance, 2)
        for order in range(1, probe.fmu.output_derivative_order + 1) if chosen else ():
            for v, value in zip(chosen, instance.output_derivatives(chosen, order), strict=True):
                if not math.isfinite(value):
                    yield f"{v.name}: derivative of order {order} is {value}: expected a finite number"


@rule(_DIRECTIONAL, Stage.BEHAVIOUR, condition=unless_claimed("providesDirectionalDerivative"))
def directional_derivatives(probe: Probe) -> Iterator[str]:
    """In initialization mode, derivatives of outputs lie between difference quotients of both sides."""
    with probe.instance() as instance:
        instance.initialise(probe.start_time)
        for known, unknowns in list(_pairs(probe.fmu).items())[:_MOST_KNOWNS]:
            yield from _compared(instance, probe.fmu.variables[known - 1], unknowns)


def _pairs(fmu: FmuFile) -> dict[int, list[Variable]]:
    """Index of a continuous Real known that can be set -> the Real outputs that depend on it at first."""
    dependents: dict[int, list[Variable]] = {}
    settable = [v.index for v in fmu.variables if v.kind == "Real" and v.is_settable]
    for index, element in fmu.unknowns("InitialUnknowns"):
        unknown = fmu.variables[(index or 1) - 1]
        stated = element.get("dependencies")
        listed = settable if stated is None else [integer(index) for index in stated.split()]
        for known in sorted(set(settable) & set(listed)):
            if unknown.kind == "Real" and unknown.causality == "output":
                dependents.setdefault(known, []).append(unknown)
    return dependents


def _compared(instance: Instance, known: Variable, unknowns: list[Variable]) -> Iterator[str]:
    derivatives = instance.directional_derivatives(unknowns, known)
    before = instance.get([known])[known.name]
    width = _DIFFERENCE * max(1.0, abs(before))
    middle = instance.get(unknowns)
    sides = [_quotients(instance, known, unknowns, before, h) for h in (-width, width)]
    sides = [side for side in sides if side]
    for v, derivative in zip(unknowns, derivatives, strict=True):
        quotients = [side[v.name] for side in sides]
        rounding = 1e-13 * abs(middle[v.name]) / width  # some hundred roundings of the output
        tolerance = _AGREEMENT * max([abs(derivative), *map(abs, quotients)]) + rounding
        low, high = min(quotients, default=-math.inf), max(quotients, default=math.inf)
        if not low - tolerance <= derivative <= high + tolerance:
            yield f"d {v.name} / d {known.name} is {derivative:.9g}: expected {low:.9g}..{high:.9g}"


def _quotients(
    instance: Instance, known: Variable, unknowns: list[Variable], before: float, h: float
) -> dict[str, float]:
    """Difference quotients of all unknowns on one side; none where the FMU refuses the value."""
    low, high = known.number("min"), known.number("max")
    value = before + h
    if (low is not None and value < low) or (high is not None and value > high):
        return {}
    middle = instance.get(unknowns)
    try:
        instance.set(known, value)
        after = instance.get(unknowns)
    except CallError:
        return {}
    finally:
        instance.set(known, before)
    return {name: (after[name] - middle[name]) / (value - before) for name in middle}
