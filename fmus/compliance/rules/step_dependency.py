"""Dependencies of outputs at communication points, against what a change of an input in step mode shows.

4.2.4 allows no reading between setting an input and the next step, so that a direct dependency is seen
through a step alone: its effect stays as steps become short, where one through a continuous state vanishes.
"""

import math
import random
from collections.abc import Iterator, Sequence
from typing import Any

from fmus.compliance.comparison import same
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.rules.dependency import declared
from fmus.compliance.script import Reading, Script
from fmus.compliance.values import other_value, random_value, read_value, start_value
from fmus.compliance.variable import Variable

_ANY_STEP = "canHandleVariableCommunicationStepSize"
_MOST_INPUTS = 20  # each of which costs some instances
_SHORT = (1.0, 0.1, 0.01)  # parts of a step: through a state, an effect shrinks with them
_STAYS = 0.5  # of an effect at a tenth of the step: what is direct does not shrink
_NOISE = 1e-9  # relative
_ADVICE = "advice: 2.2.8, a direct dependency is told from one step's delay by no call"


def _inputs(probe: Probe) -> list[Variable]:
    return [v for v in probe.fmu.variables if v.causality == "input"][:_MOST_INPUTS]


def _script(
    probe: Probe, changes: Sequence[tuple[Variable, Any]], part: float
) -> tuple[Script, Reading, Reading]:
    """Values after a step of a part of the step size with changed inputs, and after another without them."""
    script = probe.script().begin().step(2)
    t, h = probe.point(2), part * probe.step_size
    for v, x in changes:
        script.set(v, x)
    script.call("do_step", t, h)
    first = script.read(probe.outputs)
    for v, _ in changes:
        script.set(v, start_value(v))
    script.call("do_step", t + h, h)
    return script, first, script.read(probe.outputs)


@behaviour_rule(
    _ADVICE,
    needs="variables-can-be-read initial-dependencies-are-declared "
    "directional-derivatives-are-zero-without-dependency",
)
def outputs_follow_declared_inputs_alone(probe: Probe) -> Iterator[str]:
    """In step mode an input has no direct effect on an output that lists others: one that stays as steps
    become short and ends with the input.
    """
    inputs = {v.index for v in probe.fmu.variables if v.causality == "input"}
    direct_ones = {name: listed for name, listed in declared(probe, "Outputs").items() if listed & inputs}
    parts = _SHORT if probe.fmu.claims(_ANY_STEP) else (1.0,)
    for v in _inputs(probe):
        unlisted = {name for name, listed in direct_ones.items() if v.index not in listed}
        if (value := other_value(v)) is None or not unlisted:
            continue
        direct = unlisted
        for part in parts:
            direct = direct & _directly_moved(probe, v, value, part)
        if len(parts) > 1 and direct:
            direct = {name for name in direct if _remains(probe, v, value, name)}
        for name in sorted(direct):
            expected = "expected that among its dependencies"
            yield f"{name} changes with {v.name} in a step, however short: {expected}"


def _directly_moved(probe: Probe, v: Variable, value: Any, part: float) -> set[str]:
    """Outputs that another value of an input changes in a step, and that are as before one step after it."""
    scripts = [_script(probe, [(v, x)], part) for x in (start_value(v), value)]
    probe.play_each([script for script, *_ in scripts])
    (held, first, second), (changed, first_changed, second_changed) = scripts
    if not held.succeeded or not changed.succeeded:
        return set()
    moved = {name for name, x in first.values.items() if not same(x, first_changed.values[name], _NOISE)}
    return {name for name in moved if _is_back(second, second_changed, first, first_changed, name)}


def _is_back(second: Reading, changed: Reading, first: Reading, first_changed: Reading, name: str) -> bool:
    now, then = (read_value(reading.values[name]) for reading in (second, changed))
    if isinstance(now, float):
        effect = abs(first_changed.values[name] - first.values[name])
        return math.isfinite(effect) and abs(then - now) <= 0.1 * effect
    return now == then


def _remains(probe: Probe, v: Variable, value: Any, name: str) -> bool:
    """Whether the effect of an input on an output is as large in a short step as in a usual one."""
    effects = []
    for part in (_SHORT[0], _SHORT[-1]):
        scripts = [_script(probe, [(v, x)], part) for x in (start_value(v), value)]
        probe.play_each([script for script, *_ in scripts])
        values = [read_value(first.values[name]) for script, first, _ in scripts if script.succeeded]
        if len(values) < 2 or not isinstance(values[0], float):
            return len(values) == 2
        effects.append(abs(values[1] - values[0]))
    return effects[1] > _STAYS * effects[0] > 0.0


@behaviour_rule(
    "advice: 2.2.8, dependencies may list more",
    needs="allowed-calls-succeed variables-can-be-read",
)
def listed_inputs_move_outputs(probe: Probe) -> Iterator[str]:
    """An output that lists inputs as dependencies changes with one of them in steps, somewhere."""
    inputs, chance = _inputs(probe), random.Random(0)
    indices = {v.index for v in inputs}
    unmoved = {
        name: listed & indices for name, listed in declared(probe, "Outputs").items() if listed & indices
    }
    numbers = _finite(probe)
    unmoved = {name: listed for name, listed in unmoved.items() if name in numbers}
    points: list[list[tuple[Variable, Any]]] = [
        [],
        *([(v, x) for v in inputs if (x := random_value(v, chance)) is not None] for _ in range(4)),
    ]
    for point in points:
        for v in inputs:
            if not any(v.index in listed for listed in unmoved.values()):
                continue
            values = [other_value(v), random_value(v, chance)]
            for value in [x for x in values if x is not None]:
                moved = _moved(probe, point, v, value)
                unmoved = {n: ls for n, ls in unmoved.items() if n not in moved or v.index not in ls}
    for name in sorted(unmoved):
        yield f"{name} changes with none of the inputs that it lists as dependencies in steps"


def _finite(probe: Probe) -> set[str]:
    """Returns the outputs that are not constant, and no infinite numbers after a step."""
    script = probe.script().begin().step()
    reading = script.read([v for v in probe.outputs if v.variability != "constant"])
    script.play()
    return {n for n, x in reading.values.items() if not isinstance(x, float) or math.isfinite(x)}


def _moved(probe: Probe, point: list[tuple[Variable, Any]], v: Variable, value: Any) -> set[str]:
    """Outputs that another value of an input changes within two steps; all where the FMU refuses one."""
    scripts = [probe.script().begin().step() for _ in range(2)]
    for script in scripts:
        for other, x in point:
            if other is not v:
                script.set(other, x)
    scripts[1].set(v, value)
    readings = [script.run(2) for script in scripts]
    probe.play_each(scripts)
    if not all(script.succeeded for script in scripts):
        return {output.name for output in probe.outputs}
    pairs = zip(*readings, strict=True)
    return {name for a, b in pairs for name, x in a.values.items() if not same(x, b.values[name])}
