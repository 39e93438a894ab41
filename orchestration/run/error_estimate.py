"""The error that exchanging at communication points leaves in a run, estimated by a run at twice the step.

Richardson's estimate: an exchange of order p leaves the error C h^p; at twice the step it is 2^p times as
large, so that the two runs differ by d = (2^p - 1) C h^p. The second run follows, from the start time on: no
FMU has to go back in time, to give derivatives, or to be loaded twice. With a tolerance, the second run has a
tolerance 2^p times as large. A component that takes one internal step for each communication step does so in
both runs: its parameter `internal_step` [s] becomes longer too.

The recording holds a bound: a multiple of the largest d of the last three common points. d / (2^p - 1) itself
is no bound, because d may pass through 0 where the error does not.

    held inputs, p = 1           3 d: three times the estimate, Roache's factor for two grids
    extrapolated inputs, p = 2   2 d: six times the estimate, twice the multiple of p = 1, to which the
                                 order falls where an input jumps

Source: P. J. Roache, Perspective: a method for uniform reporting of grid refinement studies, J. Fluids Eng.
116 (1994). tests/orchestration/run/test_error_estimate.py compares it with the true error.
"""

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from orchestration.errors import FmuWarning, OrchestrationError, SimulationError
from orchestration.results.files import ERROR_ESTIMATE
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment, double_step
from orchestration.system.prepared_run import PreparedRun, values_of
from orchestration.system.time_grid import GRID_TOLERANCE

_FACTORS = (3.0, 2.0)  # by the order of the extrapolation


def with_error_estimate(
    recording: Recording, prepared: PreparedRun, run: Callable[[Experiment], Recording]
) -> Recording:
    """Returns the recording with `error_estimate.NAME` for each recorded Real output and connected input.

    run: makes the run at twice the step. Where that fails, the estimate is not a number from there on, and a
    warning is issued. SimulationError, with the recording, if it is interrupted.
    """
    longer = longer_internal_steps(prepared)
    experiment = double_step(prepared.experiment)
    experiment = replace(experiment, parameters={**experiment.parameters, **longer})
    failure = ""
    try:
        coarse = run(experiment)
    except OrchestrationError as error:
        if isinstance(error.__cause__, KeyboardInterrupt):
            raise SimulationError(str(error), recording) from error.__cause__
        nothing = replace(recording, time=recording.time[:0], values=recording.values[:0])
        failure, coarse = str(error), getattr(error, "recording", nothing)
        message = f"no error estimate: the run at twice the step: {failure}; half the step_size may give one"
        warnings.warn(message, FmuWarning, stacklevel=3)
    names = estimated_names(prepared)
    columns = [recording.names.index(name) for name in names]
    is_complete = not (failure or "terminated" in coarse.provenance)
    resolution = prepared.experiment.time_resolution()
    fine, rough = recording.values[:, columns], coarse.values[:, columns]
    largest = _largest_differences(recording.time, fine, coarse.time, rough, resolution, is_complete)
    bounds = _FACTORS[experiment.extrapolation] * largest
    entry = {
        "step_size_of_second_run_s": experiment.step_size,
        **({"parameters_of_second_run": longer} if longer else {}),
        **({"failure": failure} if failure else {}),
        "quantities": {
            name: {"maximum": _number(values.max()), "at_end": _number(values[-1])}
            for name, values in zip(names, bounds.T, strict=True)
        },
    }
    return replace(
        recording,
        names=(*recording.names, *(f"{ERROR_ESTIMATE}{name}" for name in names)),
        units=(*recording.units, *(recording.units[column] for column in columns)),
        values=np.column_stack([recording.values, bounds]),
        provenance={**recording.provenance, "error_estimate": entry},
    )


def longer_internal_steps(prepared: PreparedRun) -> dict[str, float]:
    """Returns "component.internal_step" -> twice its value [s], where only a step twice as long is divided.

    A controller that takes its own output as delivered needs one internal step for each communication step.
    """
    longer = {}
    for name in prepared.system.components:
        port = prepared.system.ports.get(f"{name}.internal_step")
        if port and (port.variable.causality, port.variable.unit) == ("parameter", "s"):
            step = prepared.periods[name] * prepared.experiment.step_size
            internal_step = values_of(prepared, name)["internal_step"]
            if step * (1.0 - GRID_TOLERANCE) <= internal_step < 2.0 * step:
                longer[port.name] = 2.0 * internal_step
    return longer


def estimated_names(prepared: PreparedRun) -> list[str]:
    """Returns the recorded Real outputs, and inputs that an output drives."""
    connected = {target.name for _, target in prepared.system.connections}
    ports = prepared.system.ports
    return [
        name
        for name in prepared.recorded
        if ports[name].variable.type == "Real"
        and (name in connected or ports[name].variable.causality in ("output", "local"))
    ]


def _largest_differences(
    fine_time: np.ndarray,
    fine: np.ndarray,
    coarse_time: np.ndarray,
    coarse: np.ndarray,
    resolution: float,
    is_complete: bool,
) -> np.ndarray:
    """Returns the largest difference of the two runs at three common points, shape of `fine`.

    They are the first common point that is not before a point of the fine run, and the two before that.
    Behind the last common point the last value holds, or is NaN if the coarse run is not complete.
    """
    index = np.searchsorted(fine_time, coarse_time - resolution).clip(0, len(fine_time) - 1)
    is_common = np.abs(fine_time[index] - coarse_time) <= resolution
    index = index[is_common]
    if not len(index):
        return np.full(fine.shape, np.nan)
    difference = np.abs(fine[index] - coarse[is_common])
    largest = difference.copy()
    for back in (1, 2):
        largest[back:] = np.maximum(largest[back:], difference[:-back])
    following = np.searchsorted(fine_time[index], fine_time)
    result = largest[following.clip(0, len(largest) - 1)]
    if not is_complete:
        result[following == len(largest)] = np.nan
    return result


def _number(value: Any) -> float | None:
    """Returns a number for a file, None for one that is not finite."""
    return float(value) if math.isfinite(value) else None
