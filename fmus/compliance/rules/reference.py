"""Reference results that an FMU carries as FMI-LS-REF describes: its experiments are run again."""

import csv
import io
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fmus.build.documentation.reference_results import LS_REF
from fmus.compliance.fmu_file import BrokenMemberError, FmuFile
from fmus.compliance.probe import Probe
from fmus.compliance.rule import behaviour_rule
from fmus.compliance.variable import Variable, number

_FOLDER = f"extra/{LS_REF}/"
_UNDERSTOOD = {"TransientSimulation", "Stimuli", "References"}
_MOST_BYTES = 100_000_000  # of a file; a hundred times what the FMI cross-check allows
# Relative to an output's largest value. Results on another platform differ by rounding, 1e-16 of a value,
# which loops amplify. An experiment may state more, up to what still shows a wrong result.
_TOLERANCE, _MOST_TOLERANCE = 1e-6, 1e-3
_ROWS_AT_ONCE = 100
_MOST_STEPS = 1_000_000
_NEAR = 1e-6  # of a step: times are written with as few as seven digits

Columns = dict[str, list[float]]


@dataclass(frozen=True)
class _Experiment:
    """Experiment: times in s, inputs and outputs by name, each with a column "time"."""

    start: float
    stop: float
    step_size: float
    tolerance: float
    inputs: Columns
    outputs: Columns


def _no_references(fmu: FmuFile) -> str:
    return "" if _files(fmu) else "no experiment with reference results is inside"


def _files(fmu: FmuFile) -> list[str]:
    return [path for path in fmu.names if path.startswith(_FOLDER) and path.endswith(".exp")]


@behaviour_rule("not FMI: FMI-LS-REF 1.0.0-alpha.1", condition=_no_references)
def reference_results_are_reproduced(probe: Probe) -> Iterator[str]:
    """Experiments inside the FMU give their reference results again, up to the stated tolerance."""
    for path in _files(probe.fmu):
        for element in probe.fmu.parsed(path, _MOST_BYTES).iterfind("Experiment"):
            if {str(child.tag) for child in element} <= _UNDERSTOOD:  # with parameters it is another's
                yield from (f"{path}: {message}" for message in _differences(probe, element))


def _differences(probe: Probe, element: Any) -> Iterator[str]:
    """Yields the first difference of each output."""
    experiment = _experiment(probe.fmu, element)
    chosen = {v.name: v for v in probe.fmu.variables}
    unknown = sorted((experiment.inputs.keys() | experiment.outputs.keys()) - chosen.keys() - {"time"})
    if unknown:
        yield f"{', '.join(unknown)}: expected names of variables"
        return
    outputs = [chosen[name] for name in experiment.outputs if name != "time"]
    scales = {
        v.name: max(map(abs, experiment.outputs[v.name])) or v.number("nominal") or 1.0 for v in outputs
    }
    for i, row in enumerate(_replayed(probe, experiment, chosen, outputs)):
        for name in [name for name in row if name in scales]:
            expected = experiment.outputs[name][i]
            if not abs(row[name] - expected) <= experiment.tolerance * scales[name]:
                del scales[name]
                t = experiment.outputs["time"][i]
                yield f"{name} is {row[name]:.9g} at {t:g} s: expected {expected:.9g}, the reference result"


def _experiment(fmu: FmuFile, element: Any) -> _Experiment:
    times = element.find("TransientSimulation")
    references, stimuli = element.find("References"), element.find("Stimuli")
    start, stop, step_size = (
        number(times.get(name)) if times is not None else None
        for name in ("startTime", "stopTime", "stepSize")
    )
    if stop is None or step_size is None or step_size <= 0 or references is None:
        raise BrokenMemberError("experiment without stopTime, stepSize or References: expected all of them")
    tolerance = min(number(element.get("tolerance")) or _TOLERANCE, _MOST_TOLERANCE)
    inputs = _table(fmu, stimuli.get("source")) if stimuli is not None else {}
    return _Experiment(
        start or 0.0, stop, step_size, tolerance, inputs, _table(fmu, references.get("source"))
    )


def _table(fmu: FmuFile, source: str) -> Columns:
    content = fmu.read(f"{_FOLDER}{source}", _MOST_BYTES)
    try:
        names, *rows = csv.reader(io.StringIO(content.decode("utf-8")))
        columns = [list(map(float, column)) for column in zip(*rows, strict=True)]
        table = dict(zip(names, columns, strict=True))
    except ValueError:
        table = {}
    if next(iter(table), "") != "time":
        raise BrokenMemberError(f"{source}: expected rows of numbers below names, the first of them time")
    return table


def _replayed(
    probe: Probe, experiment: _Experiment, chosen: dict[str, Variable], outputs: Sequence[Variable]
) -> Iterator[dict[str, Any]]:
    """Outputs at the times of the reference results, before the inputs of those times are set."""
    indices = _indices(experiment)
    points = experiment.start + experiment.step_size * np.arange(indices[-1] + 1)
    columns = [
        (chosen[name], _at(points, experiment.inputs, chosen[name])) for name in list(experiment.inputs)[1:]
    ]

    script = probe.script().initialise(experiment.start)
    for v, values in columns:
        script.set(v, values[0])
    script.exit_initialization_mode()
    readings = []
    for first, last in itertools.pairwise([0, *indices]):
        for i in range(first, last):
            for v, values in columns:
                if i == 0 or values[i] != values[i - 1]:
                    script.set(v, values[i])
            script.call("do_step", float(points[i]), experiment.step_size)
        readings.append(script.read(outputs))
        if len(readings) % _ROWS_AT_ONCE == 0:
            script.pause()
    script.play()
    yield from (reading.values for reading in readings)


def _indices(experiment: _Experiment) -> list[int]:
    """Returns the communication points at which there are reference results."""
    steps = (np.array(experiment.outputs["time"]) - experiment.start) / experiment.step_size
    indices = np.rint(steps)
    if not np.all(np.abs(steps - indices) < _NEAR) or np.any(np.diff(indices, prepend=-1) <= 0):
        raise BrokenMemberError("times of the reference results: expected increasing multiples of stepSize")
    if indices[-1] > _MOST_STEPS:
        raise BrokenMemberError(f"{indices[-1]:g} steps: expected at most {_MOST_STEPS}")
    return indices.astype(int).tolist()


def _at(points: np.ndarray, inputs: Columns, variable: Variable) -> list[Any]:
    """Returns values of an input: on straight lines between its rows if it is continuous, held otherwise."""
    times, values = np.array(inputs["time"]), np.array(inputs[variable.name])
    if variable.kind == "Real" and variable.variability == "continuous":
        return np.interp(points, times, values).tolist()
    held = values[np.clip(np.searchsorted(times, points, "right") - 1, 0, None)]
    return held.tolist() if variable.kind == "Real" else held.astype(int).tolist()
