"""Differences of two runs with the same inputs, in separate processes."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from fmus.errors import OrchestrationError
from fmus.fmi.description import describe, start_value
from fmus.fmi.model_description import ScalarVariable
from fmus.fmi.variable_types import FmiValue
from orchestration.cli.chosen_scenario import build_missing_fmus
from orchestration.diff.change import Change, Level
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.system.experiment import Event, Experiment
from orchestration.system.signals import Sines
from orchestration.system.system import System

_FMU = "fmu"  # name of the component that runs alone
# Of the largest value: another order of additions, a hundred thousand steps long, stays below.
_ROUNDING = 1e-9
_TIMES = {"startTime": 0.0, "stopTime": 1.0}
_STEPS = 500  # where the FMU suggests no step size


def behaviour_changes(
    old: Path, new: Path, timeout: float, name: str = "", component: str = ""
) -> list[Change]:
    """Returns how the results differ: where first, and by how much at most.

    timeout: longest time of a call of an FMU [s]
    name, component: of a scenario and of the component in it that each FMU replaces; alone by default
    """
    if name:
        runs = _in_scenario(name, component, (old, new))
    else:
        runs = [(System({_FMU: fmu}), _experiment(old, new)) for fmu in (old, new)]
    results = [_result(system, experiment, timeout) for system, experiment in runs]
    one, other = results
    if isinstance(one, Recording) and isinstance(other, Recording):
        return _of_recordings(one, other)
    texts = ["a whole run" if isinstance(result, Recording) else str(result) for result in results]
    if not any(isinstance(result, Recording) for result in results):
        return [Change(Level.PATCH, "behaviour", f"not compared, as neither runs: {texts[0]}")]
    level = Level.MAJOR if isinstance(one, Recording) else Level.MINOR
    return [Change(level, "behaviour", f"{texts[0]} -> {texts[1]}")]


def speed(old: Path, new: Path, timeout: float) -> str:
    """Returns the CPU times of a step of both, which take turns in one run, in words; arguments as above."""
    experiment = _experiment(old, new)
    signals = {name.replace(_FMU, "new", 1): signal for name, signal in experiment.signals.items()}
    both = replace(experiment, signals={**experiment.signals, **signals}, events=())
    try:
        run = simulate(System({_FMU: old, "new": new}), both, timeout=timeout, statistics=True)
    except OrchestrationError as error:
        return f"not compared: {error}"
    a, b = (1e6 * fmu["cpu_s"] / fmu["steps"] for fmu in run.provenance["statistics"]["fmus"].values())
    return f"a step takes {b / a:.3g} times the CPU time: {a:.3g} us -> {b:.3g} us"


def _result(system: System, experiment: Experiment, timeout: float) -> Recording | OrchestrationError:
    try:
        return simulate(system, experiment, timeout=timeout)
    except OrchestrationError as error:
        return error


def _in_scenario(name: str, component: str, fmus: Iterable[Path]) -> list[tuple[System, Experiment]]:
    chosen = [scenario.load(scenario.find(name), settings={component: str(fmu.absolute())}) for fmu in fmus]
    build_missing_fmus(chosen)
    return [(each.system, each.experiment) for each in chosen]


def _experiment(old: Path, new: Path) -> Experiment:
    """Returns a run with signals at the Real inputs of both FMUs; half-way, Booleans and items change."""
    one, others = describe(old), {(v.name, v.type, v.causality) for v in describe(new).modelVariables}
    shared = [v for v in one.modelVariables if (v.name, v.type, v.causality) in others]
    given = {name: getattr(one.defaultExperiment, name, None) for name in (*_TIMES, "stepSize")}
    start, stop = (float(given[name] or other) for name, other in _TIMES.items())
    stop = stop if stop > start else start + 1.0
    # a solver needs no small communication steps, at each of which it begins anew
    usual = (stop - start) / _STEPS
    step = max(float(given["stepSize"] or usual), usual if one.is_model_exchange else 0.0)
    real = [v for v in shared if v.causality == "input" and v.type == "Real"]
    signals = {f"{_FMU}.{v.name}": _signal(v, number, stop - start) for number, v in enumerate(real)}
    outputs = tuple(f"{_FMU}.{v.name}" for v in shared if v.causality == "output" and v.type != "String")
    discrete = [v for v in shared if v.causality == "input" and v.type in ("Boolean", "Enumeration")]
    half = Event((start + stop) / 2.0, {f"{_FMU}.{v.name}": _other_value(v) for v in discrete})
    events = [half] if discrete else []
    return Experiment(stop, step, start, signals=signals, events=events, record=outputs, open_inputs="start")


def _other_value(variable: ScalarVariable) -> FmiValue:
    """Returns another value than the start value, which an item without others is."""
    start = start_value(variable)
    if variable.type == "Boolean":
        return not start
    items = [int(item.value) for item in variable.declaredType.items] if variable.declaredType else []
    low, high = int(variable.min or min(items, default=0)), int(variable.max or max(items, default=0))
    return next((item for item in items if item != start and low <= item <= high), start)


def _signal(variable: ScalarVariable, number: int, duration: float) -> Sines:
    """Returns two sines inside the declared range, about the start value if that leaves room, by a number."""
    # not values of the check's random traces: to find those that an FMU takes, it makes trial runs
    low, high = float(variable.min or "-inf"), float(variable.max or "inf")
    size = min(float(variable.nominal or 1.0), (high - low) / 4.0)
    middle = float(np.clip(float(start_value(variable)), low + 1.5 * size, high - 1.5 * size))
    # no two are multiples of each other: a swap of two inputs shows
    rates = 2.0 * np.pi * np.array([1.0, 2.0**0.5 * 3.0]) * (1.0 + 0.618 * number) / duration
    return Sines([size, 0.5 * size], rates, [0.0, 1.0], middle)


def _of_recordings(one: Recording, other: Recording) -> list[Change]:
    ends = [float(run.time[-1]) for run in (one, other)]
    if ends[0] != ends[1]:
        level = Level.MAJOR if ends[1] < ends[0] else Level.MINOR
        return [Change(level, "behaviour", f"ends at t = {ends[0]:.6g} s -> {ends[1]:.6g} s")]
    names = [name for name in one.names if name in other.names]
    shape = len(names), min(one.time.size, other.time.size)
    a, b = (
        np.array([own[name][: shape[1]] for name in names], float).reshape(shape).T for own in (one, other)
    )
    differs = (a != b) & ~(np.isnan(a) & np.isnan(b))
    if not differs.any():
        return []
    row, column = np.argwhere(differs)[0]
    scale = np.max(np.nan_to_num(np.abs([a, b]), posinf=np.inf), axis=(0, 1))
    with np.errstate(invalid="ignore"):
        gap = np.where(differs, np.abs(a - b), 0.0)
        relative = np.nan_to_num(gap / np.where(scale, scale, 1.0), nan=np.inf)
    last, largest = np.unravel_index(np.argmax(relative), relative.shape)
    level = Level.PATCH if relative[last, largest] <= _ROUNDING else Level.MINOR
    text = (
        f"differs first at t = {one.time[row]:.6g} s in {names[column]}; at most by {gap[last, largest]:.3g}"
        f" of {names[largest]} at t = {one.time[last]:.6g} s, whose largest value is {scale[largest]:.3g}"
    )
    return [Change(level, "behaviour", text)]
