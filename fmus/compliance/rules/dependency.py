"""Dependencies: what ModelStructure declares of initial values, against what a change shows."""

import math
import random
from collections.abc import Iterator
from typing import Any

from fmus.compliance.accepted import accepted
from fmus.compliance.comparison import same
from fmus.compliance.probe import Probe
from fmus.compliance.rule import NotApplicableError, NotJudgedError, behaviour_rule
from fmus.compliance.values import (
    other_value,
    other_values,
    random_value,
    settable_in_initialization,
    start_value,
)
from fmus.compliance.variable import Variable

_STRUCTURE = "2.2.8 Definition of the Model Structure (ModelStructure)"
_MOST_KNOWNS = 100
_MOST_TESTED = 40  # knowns without an effect at the start values, each of which costs two instances a point
_PARTS = (0.05, 0.1, 0.3, 1.0)  # of the other knowns that are changed: many FMUs refuse most sets
_MOST_SWITCHED = 20  # items of parameters that choose something
# random values of a known that must be accepted: of a Real that takes whole numbers alone hardly one is
_MOST_DRAWN = 3
_NOISE = 1e-9  # relative: an iteration may stop elsewhere
_CLOSE, _SHARE = 1e-6, 0.1  # of a change: two values that are as close give changes that are as equal
Point = list[tuple[Variable, Any]]


def _unknowns(probe: Probe) -> list[Variable]:
    return [unknown for unknown, *_ in probe.fmu.dependencies["InitialUnknowns"]]


def declared(probe: Probe, section: str = "InitialUnknowns") -> dict[str, set[int | None]]:
    """Returns unknown -> indices of the knowns that it declares; without a declaration it is left out."""
    listed = probe.fmu.dependencies[section]
    return {unknown.name: set(knowns) for unknown, knowns, _ in listed if knowns is not None}


def _changed(probe: Probe, pairs: list[tuple[Point, Variable, Any]]) -> list[tuple[Variable, set[str]]]:
    """Returns known -> unknowns that change when it has another value, at each point that the FMU accepts."""
    tried = []
    for point, known, value in pairs:
        scripts = [probe.script().initialise() for _ in range(2)]
        for script in scripts:
            for v, x in point:
                if v is not known:
                    script.set(v, x)
        scripts[1].set(known, value)
        tried.append((known, scripts, [script.read(_unknowns(probe)) for script in scripts]))
    probe.play_each([script for _, scripts, _ in tried for script in scripts])
    results = []
    for known, scripts, readings in tried:
        if all(script.succeeded for script in scripts):
            before, after = (reading.values for reading in readings)
            results.append((known, {name for name, x in before.items() if not same(x, after[name], _NOISE)}))
    return results


def _influences(probe: Probe) -> list[tuple[Variable, set[str]]]:
    """Returns known -> the initial unknowns that it changes, at the start values."""
    knowns = settable_in_initialization(probe.fmu)[:_MOST_KNOWNS]
    pairs: list[tuple[Point, Variable, Any]] = [([], known, value) for known, value in other_values(knowns)]
    return probe.once("change of what initial values depend on", lambda: _changed(probe, pairs))


@behaviour_rule(_STRUCTURE)
def initial_dependencies_are_declared(probe: Probe) -> Iterator[str]:
    """An initial unknown changes only with the knowns that its dependencies list."""
    listed = declared(probe)
    for known, changes in _influences(probe):
        named = changes & listed.keys() - {known.name}
        unlisted = {name for name in named if known.index not in listed[name]}
        for name in sorted(unlisted - _noise(probe, known, unlisted)):
            expected = "expected that among its dependencies"
            yield f"{name} changes with {known.name} in initialization mode: {expected}"


def _noise(probe: Probe, known: Variable, names: set[str]) -> set[str]:
    """Returns unknowns that change as much between two values that are almost one: an iteration leaves it."""
    start, value = start_value(known), other_value(known)
    if not names or not isinstance(start, float) or not isinstance(value, float):
        return set()
    scripts = [probe.script().initialise() for _ in range(3)]
    for script, x in zip(scripts, (start, value, value + _CLOSE * (value - start)), strict=True):
        script.set(known, x)
    readings = [script.read([v for v in _unknowns(probe) if v.name in names]) for script in scripts]
    probe.play_each(scripts)
    if not all(script.succeeded for script in scripts):
        return set()
    values = {name: [reading.values[name] for reading in readings] for name in names}
    return {
        name
        for name, (a, b, c) in values.items()
        if isinstance(a, float) and abs(c - b) > _SHARE * abs(b - a)
    }


@behaviour_rule(_STRUCTURE, needs="variables-can-be-read")
def dependencies_on_time_are_declared(probe: Probe) -> Iterator[str]:
    """An initial unknown changes with the start time only if it lists the independent variable, where that is
    defined.
    """
    independent = {v.index for v in probe.fmu.variables if v.causality == "independent"}
    if not independent:
        raise NotApplicableError("no variable is independent")
    scripts = [probe.script().initialise(t) for t in (probe.start_time, probe.start_time + probe.step_size)]
    readings = [script.read(_unknowns(probe)) for script in scripts]
    probe.play_each(scripts)
    if not all(script.succeeded for script in scripts):
        raise NotJudgedError("another start time is refused")
    before, after = (reading.values for reading in readings)
    for name, listed in declared(probe).items():
        if not listed & independent and not same(before[name], after[name], _NOISE):
            yield f"{name} changes with the start time: expected the independent variable in its dependencies"


@behaviour_rule(
    "advice: 2.2.8, dependencies may list more",
    needs="allowed-calls-succeed variables-can-be-read",
)
def initial_dependencies_exist(probe: Probe) -> Iterator[str]:
    """A continuous initial unknown that lists Real inputs changes with one of them somewhere."""
    knowns, chance = settable_in_initialization(probe.fmu), random.Random(0)
    anywhere = [(v, random_value(v, random.Random(i))) for v in knowns for i in range(_MOST_DRAWN)]
    pairs = [*other_values(knowns), *((v, x) for v, x in anywhere if x is not None)]
    taken = {(v.index, x) for v, x in accepted(probe, pairs, lambda: probe.script().initialise())}
    refused = {v.index for v, x in pairs if (v.index, x) not in taken}
    knowns = [known for known in knowns if known.index not in refused]
    real = {known.index for known in knowns if known.kind == "Real" and known.causality == "input"}
    numbers = _finite(probe)
    alone: dict[str, set[int | None]] = {
        name: listed & real for name, listed in declared(probe).items() if listed & real and name in numbers
    }
    alone = _unmoved(alone, _influences(probe))
    for point in _points(knowns, chance) if alone else ():
        indices = set().union(*alone.values())
        tested = [known for known in knowns if known.index in indices][:_MOST_TESTED]
        changes = [(point, known, x) for known in tested if (x := random_value(known, chance)) is not None]
        alone = _unmoved(alone, _changed(probe, changes))
    for name in alone:
        yield f"{name} changes with none of the inputs that it lists as dependencies in initialization mode"


def _finite(probe: Probe) -> set[str]:
    """Returns the continuous initial unknowns that are finite numbers at the start values."""
    script = probe.script().initialise()
    unknowns = [v for v in _unknowns(probe) if v.kind == "Real" and v.variability == "continuous"]
    reading = script.read(unknowns)
    script.play()
    return {name for name, value in reading.values.items() if math.isfinite(value)}


def _unmoved(
    listed: dict[str, set[int | None]], changes: list[tuple[Variable, set[str]]]
) -> dict[str, set[int | None]]:
    """Returns the unknowns that no known changes which they list."""
    moved = {(name, known.index) for known, names in changes for name in names}
    return {name: knowns for name, knowns in listed.items() if not any((name, i) in moved for i in knowns)}


def _points(knowns: list[Variable], chance: random.Random) -> Iterator[Point]:
    """Yields values of inputs anywhere, each other item of each choice, then some other knowns changed."""
    switches = [v for v in knowns if v.base_kind not in {"Real", "String"}]
    chosen: list[list[tuple[Variable, Any]]] = [
        [(v, x)] for v in switches for x in sorted(v.items or {0, 1}) if x != start_value(v)
    ][:_MOST_SWITCHED]
    for fixed in [[], *chosen]:
        inputs = [v for v in knowns if v.causality == "input"]
        yield fixed + [(v, x) for v in inputs if (x := random_value(v, chance)) is not None]
    for part in _PARTS:
        moved = [v for v in knowns if v.causality == "input" or chance.random() < part]
        yield [(v, x) for v in moved if (x := random_value(v, chance)) is not None]


@behaviour_rule(_STRUCTURE, needs="variables-can-be-read")
def constant_factors_are_constant(probe: Probe) -> Iterator[str]:
    """An initial unknown changes with a known of the kind constant by the same factor everywhere, whatever
    the inputs are.
    """
    inputs = [v for v in settable_in_initialization(probe.fmu) if v.causality == "input"]
    point: Point = other_values(inputs)
    for known, unknowns in _constant_factors(probe)[:_MOST_KNOWNS]:
        start, value = start_value(known), other_value(known)
        if not isinstance(start, float) or value is None:
            continue
        values = [start, value, start + 2 * (value - start), start, value]
        scripts = [probe.script().initialise() for _ in values]
        for i, (script, x) in enumerate(zip(scripts, values, strict=True)):
            for v, other in point if i > 2 else ():
                if v is not known:
                    script.set(v, other)
            script.set(known, x)
        readings = [script.read(unknowns) for script in scripts]
        probe.play_each(scripts)
        for v in unknowns if all(script.succeeded for script in scripts) else ():
            a, b, c, d, e = (reading.values[v.name] for reading in readings)
            changes, scale = [b - a, c - b, e - d], max(map(abs, (a, b, c, d, e)))
            if (
                math.isfinite(scale)
                and max(changes) - min(changes) > 1e-6 * max(map(abs, changes)) + 1e-12 * scale
            ):
                yield f"the factor of {known.name} in {v.name} is not constant: its dependenciesKind is"


def _constant_factors(probe: Probe) -> list[tuple[Variable, list[Variable]]]:
    """Returns settable Real knowns, each with the Real unknowns that list it with the kind constant."""
    settable = {v.index: v for v in settable_in_initialization(probe.fmu) if v.kind == "Real"}
    initial = {v.index for v in _unknowns(probe)}
    result: dict[int, list[Variable]] = {}
    for section in ("InitialUnknowns", "Outputs"):
        for unknown, knowns, kinds in probe.fmu.dependencies[section]:
            judged = unknown.kind == "Real" and unknown.index in initial
            for known, kind in zip(knowns or () if judged else (), kinds, strict=False):
                if known in settable and kind == "constant" and unknown not in result.setdefault(known, []):
                    result[known].append(unknown)
    return [(settable[known], unknowns) for known, unknowns in result.items()]
