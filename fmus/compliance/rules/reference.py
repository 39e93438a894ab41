"""Reference results that an FMU carries as FMI-LS-REF describes: its experiments are run again."""

import csv
import io
import itertools
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from fmus.build.documentation.reference_results import LS_REF
from fmus.compliance.fmu_file import CO_SIMULATION, BrokenMemberError, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.script import Reading
from fmus.compliance.variable import Variable, number

_FOLDER = f"extra/{LS_REF}/"
_UNDERSTOOD = ("TransientSimulation", "References", "Stimuli")
_MOST_BYTES = 100_000_000  # of a file; a hundred times what the FMI cross-check allows
# Relative to an output's largest value. Results on another platform differ by rounding, 1e-16 of a value,
# which loops amplify. An experiment may state more, up to what still shows a wrong result.
_TOLERANCE, _MOST_TOLERANCE = 1e-6, 1e-3
_ROWS_AT_ONCE = 100
_MOST_STEPS = 1_000_000
_NEAR = 1e-6  # of a step: times are written with as few as seven digits

Columns = dict[str, np.ndarray]


def _no_references(fmu: FmuFile) -> str:
    if fmu.is_model_exchange and CO_SIMULATION in fmu.interfaces:
        return "the experiments are replayed by co-simulation, whose step size they state"
    return "" if _files(fmu) else "no experiment with reference results is inside"


def _files(fmu: FmuFile) -> list[str]:
    return [path for path in fmu.names if path.startswith(_FOLDER) and path.endswith(".exp")]


@behaviour_rule("not FMI: FMI-LS-REF 1.0.0-alpha.1", condition=_no_references)
def reference_results_are_reproduced(probe: Probe) -> Iterator[str]:
    """Experiments inside the FMU give their reference results again, up to the stated tolerance."""
    for path in _files(probe.fmu):
        for element in probe.fmu.parsed(path, _MOST_BYTES).iterfind("Experiment"):
            if {str(child.tag) for child in element} <= {*_UNDERSTOOD}:  # with parameters it is another's
                yield from (f"{path}: {message}" for message in _differences(probe, element))


def _differences(probe: Probe, element: Any) -> Iterator[str]:
    """Yields the first difference of each output."""
    times, references, stimuli = (element.find(tag) for tag in _UNDERSTOOD)
    get = {}.get if times is None else times.get
    stop, h = (number(get(name)) for name in ("stopTime", "stepSize"))
    if stop is None or h is None or h <= 0 or references is None:
        raise BrokenMemberError("experiment without stopTime, stepSize or References: expected all of them")
    start = number(get("startTime")) or 0.0
    tolerance = min(number(element.get("tolerance")) or _TOLERANCE, _MOST_TOLERANCE)
    expected = _table(probe.fmu, references.get("source"))
    inputs = {} if stimuli is None else _table(probe.fmu, stimuli.get("source"))
    variables = {v.name: v for v in probe.fmu.variables}
    if unknown := sorted({*expected, *inputs} - {*variables, "time"}):
        yield f"{', '.join(unknown)}: expected names of variables"
        return
    ends = _numbers(expected["time"], start, h)
    points = start + h * np.arange(ends[-1] + 1)
    columns = [(variables[name], _at(points, inputs, variables[name])) for name in inputs if name != "time"]
    outputs = [variables[name] for name in expected if name != "time"]
    readings = _replayed(probe, points, h, ends, columns, outputs)
    for v in outputs:
        column, got = expected[v.name], np.array([reading.values[v.name] for reading in readings], float)
        scale = np.abs(column).max() or v.nominal or 1.0
        for i in np.flatnonzero(~(np.abs(got - column) <= tolerance * scale))[:1]:
            at = f"at {expected['time'][i]:g} s"
            yield f"{v.name} is {got[i]:.9g} {at}: expected {column[i]:.9g}, the reference result"


def _table(fmu: FmuFile, source: str) -> Columns:
    content = fmu.read(f"{_FOLDER}{source}", _MOST_BYTES)
    try:
        names, *rows = csv.reader(io.StringIO(content.decode("utf-8")))
        table = dict(zip(names, np.array(rows, float).T, strict=True))
    except ValueError:
        table = {}
    if next(iter(table), "") != "time":
        raise BrokenMemberError(f"{source}: expected rows of numbers below names, the first of them time")
    return table


def _replayed(
    probe: Probe, points: np.ndarray, h: float, ends: Sequence[int],
    columns: Sequence[tuple[Variable, list[Any]]], outputs: Sequence[Variable],
) -> list[Reading]:  # fmt: skip
    """Returns readings of outputs at the communication points whose numbers are ends, before inputs are set.

    columns: values of each input at all communication points
    """
    script = probe.script().initialise(float(points[0]))
    for v, values in columns:
        script.set(v, values[0])
    script.exit_initialization_mode()
    readings = []
    for first, last in itertools.pairwise([0, *ends]):
        for i in range(first, last):
            for v, values in columns:
                if i == 0 or values[i] != values[i - 1]:
                    script.set(v, values[i])
            script.call("do_step", float(points[i]), h)
        readings.append(script.read(outputs))
        if len(readings) % _ROWS_AT_ONCE == 0:
            script.pause()
    script.play()
    return readings


def _numbers(times: np.ndarray, start: float, step_size: float) -> list[int]:
    """Returns the numbers of the communication points at which there are reference results."""
    steps = (times - start) / step_size
    numbers = np.rint(steps)
    if not np.all(np.abs(steps - numbers) < _NEAR) or np.any(np.diff(numbers, prepend=-1) <= 0):
        raise BrokenMemberError("times of the reference results: expected increasing multiples of stepSize")
    if numbers[-1] > _MOST_STEPS:
        raise BrokenMemberError(f"{numbers[-1]:g} steps: expected at most {_MOST_STEPS}")
    return numbers.astype(int).tolist()


def _at(points: np.ndarray, inputs: Columns, variable: Variable) -> list[Any]:
    """Returns values of an input: on straight lines between its rows if it is continuous, held otherwise."""
    times, values = inputs["time"], inputs[variable.name]
    if variable.kind == "Real" and variable.variability == "continuous":
        return np.interp(points, times, values).tolist()
    held = values[np.clip(np.searchsorted(times, points, "right") - 1, 0, None)]
    return held.tolist() if variable.kind == "Real" else held.astype(int).tolist()
