"""Variables with the attribute derivative, against the variables that they name."""

import itertools
import math
from collections.abc import Iterator

from fmus.compliance.comparison import texts
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, behaviour_rule
from fmus.compliance.slopes import SHORT, compared, read_in_steps, with_short_steps, wrong_slope
from fmus.compliance.variable import Variable, integer

_DERIVATIVE = "2.2.7 Definition of Model Variables (ModelVariables): derivative"
_STEPS, _INTEGRATED = 30, 0.02  # relative: of an integral, beside the error of a coarse solver
_Run = tuple[Variable, Variable, list[float], list[float]]  # derivative, its variable, values, derivatives


@behaviour_rule(_DERIVATIVE, needs="variables-can-be-read communication-points-may-be-rounded")
def derivatives_are_slopes(probe: Probe) -> Iterator[str]:
    """A variable with the attribute derivative is the slope of the variable that it names: in most steps it
    lies near the difference quotients.
    """
    for run in _usual_runs(probe):
        messages = _no_slope(run, probe.step_size)
        if messages and _is_wrong_in_short_steps(probe, run[0].name):
            yield from messages


def _no_slope(run: _Run, step_size: float) -> list[str]:
    """Returns a message if neither the integral of a derivative nor its values are right."""
    v, state, values, slopes = run
    if _difference_of_integral(values, slopes, step_size) is None:
        return []
    comparisons = compared(values, slopes, step_size)
    return list(wrong_slope(f"{v.name} by {state.name}", comparisons, judged=lambda _: True))


def _is_wrong_in_short_steps(probe: Probe, name: str) -> bool:
    """Whether a derivative is none with steps of another size too: what repeats with each step moves then.

    Where the FMU takes no other steps, `derivatives-integrate-to-their-variables` warns.
    """
    runs = with_short_steps(probe, "run of short steps", _runs) or []
    return any(_no_slope(run, SHORT * probe.step_size) for run in runs if run[0].name == name)


@behaviour_rule(_DERIVATIVE, needs="derivatives-are-slopes")
def derivatives_integrate_to_their_variables(probe: Probe) -> Iterator[str]:
    """A variable changes by the integral of the variable that names it with the attribute derivative."""
    for v, state, values, slopes in _usual_runs(probe):
        if (difference := _difference_of_integral(values, slopes, probe.step_size)) is not None:
            shown = texts(*difference)
            yield f"{state.name} changes by {shown[0]} where the integral of {v.name} is {shown[1]}"


def _usual_runs(probe: Probe) -> list[_Run]:
    return probe.once("run with derivatives", lambda: _runs(probe, 1.0))


def _runs(probe: Probe, part: float) -> list[_Run]:
    """Returns the values of each continuous derivative and its variable in a run, if all are finite.

    part: of the step size, for each step
    """
    variables = probe.fmu.variables
    indices = [(v, integer(v.typed.get("derivative")) or 0) for v in variables]
    pairs = [(v, variables[i - 1]) for v, i in indices if 1 <= i <= len(variables) and i != v.index]
    continuous = [
        (v, w)
        for v, w in pairs
        if v.kind == w.kind == "Real" and v.variability == w.variability == "continuous"
    ]
    if not continuous:
        raise NotApplicableError("no continuous variable is marked as a derivative")
    script, chosen = probe.script().begin(), [x for pair in continuous for x in pair]
    readings = [script.read(chosen), *read_in_steps(probe, script, chosen, _STEPS, part)]
    script.play()
    rows = [reading.values for reading in readings]
    runs = [(v, w, [row[w.name] for row in rows], [row[v.name] for row in rows]) for v, w in continuous]
    return [run for run in runs if all(map(math.isfinite, [*run[2], *run[3]]))]


def _difference_of_integral(
    values: list[float], slopes: list[float], step_size: float
) -> tuple[float, float] | None:
    """Returns the change of a variable and the integral of its derivative, if they are not about the same."""
    integral = step_size * (sum(slopes) - (slopes[0] + slopes[-1]) / 2)
    variation = sum(abs(b - a) for a, b in itertools.pairwise(slopes))
    margin = step_size * (variation + _INTEGRATED * sum(map(abs, slopes)))
    change = values[-1] - values[0]
    differ = abs(change - integral) > margin + 1e-9 * max(map(abs, values))
    return (change, integral) if differ else None
