"""Derivatives that an FMU gives, beside the difference quotients of its values."""

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from fmus.compliance.comparison import texts
from fmus.compliance.probe import Probe
from fmus.compliance.script import CallError, Reading, Script
from fmus.compliance.variable import Variable

T = TypeVar("T")
Comparison = tuple[float, float, float, float]  # derivative, slope before, slope after, rounding of slopes
SHORT = 0.30901699  # of a step: no simple fraction, so that nothing that repeats with it stands still
_ANY_STEP = "canHandleVariableCommunicationStepSize"
_ROUGH = 0.1  # relative: of slopes over a step, which is no limit


def with_short_steps(probe: Probe, name: str, run: Callable[[Probe, float], T]) -> T | None:
    """Returns the run with steps of the part `SHORT` of the step size; None where the FMU refuses them.

    name: of that run, which is made once for all rules
    """
    if not probe.fmu.claims(_ANY_STEP):
        return None
    try:
        return probe.once(name, lambda: run(probe, SHORT))
    except CallError:
        return None


def read_in_steps(
    probe: Probe, script: Script, variables: Sequence[Variable], count: int, part: float
) -> Iterator[Reading]:
    """Readings after steps from the start time, each of a part of the step size."""
    step_size = part * probe.step_size
    for i in range(count):
        script.call("do_step", probe.point(0) + i * step_size, step_size)
        yield script.read(variables)


def compared(values: Sequence[float], derivatives: Sequence[float], step_size: float) -> list[Comparison]:
    """Derivatives beside the slopes of values at equal distances."""
    slopes = [(b - a) / step_size for a, b in itertools.pairwise(values)]
    rounding = 1e-9 * max(map(abs, values)) / step_size
    return [(derivatives[i], slopes[i - 1], slopes[i], rounding) for i in range(1, len(slopes))]


def wrong_slope(
    name: str, comparisons: Sequence[Comparison], judged: Callable[[float], bool] = bool
) -> Iterator[str]:
    """Yields a message if over half of the derivatives are wrong, and are to be judged: those that are not 0,
    unless `judged` is given.
    """
    wrong = [comparison for comparison in comparisons if judged(comparison[0]) and _is_wrong(*comparison)]
    if len(wrong) > (len(comparisons) + 1) // 2:  # a jump or an event is not a wrong derivative
        shown = texts(*wrong[0][:3])
        yield f"{name}: its derivative is {shown[0]}: expected about {shown[1]}..{shown[2]}, its slopes"


def _is_wrong(derivative: float, before: float, after: float, rounding: float) -> bool:
    margin = 2 * abs(after - before) + _ROUGH * max(abs(before), abs(after)) + rounding
    return not min(before, after) - margin <= derivative <= max(before, after) + margin
