"""The recording of a run: its recorded values, and the provenance that follows from the prepared run."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fmus.fmi.description import start_value
from orchestration.results.recording import Recording
from orchestration.system.prepared_run import PreparedRun


def make_recording(
    prepared: PreparedRun,
    rows: np.ndarray,
    count: int,
    texts: Sequence[str] = (),
    more: Mapping[str, Any] = {},
    is_final: bool = False,
) -> Recording:
    """The recorded values at the first `count` communication points.

    rows: shape `prepared.shape`, of many runs with a first axis of runs
    texts: of Strings, by their numbers; without them Strings are empty
    more: further entries of the provenance; is_final: all rows become those of the recording, without a copy
    """
    ports = prepared.system.ports
    values, time = rows[..., :count, :], prepared.points[:count]
    if not (is_final and count == rows.shape[-2]):
        values, time = values.copy(), time.copy()
    is_string = np.array([ports[name].variable.type == "String" for name in prepared.recorded], bool)
    if not texts:
        values[..., is_string] = 0.0
    return Recording(
        names=prepared.recorded,
        units=tuple(ports[name].variable.unit or "" for name in prepared.recorded),
        time=time,
        values=values,
        provenance=_provenance(prepared) | dict(more),
        texts={prepared.recorded[i]: tuple(texts or ("",)) for i in np.flatnonzero(is_string)},
    )


def _provenance(prepared: PreparedRun) -> dict[str, Any]:
    """The FMUs and the settings of the run, as plain data."""
    experiment = prepared.experiment
    open_inputs = {port.name: start_value(port.variable) for port in prepared.system.open_inputs}
    return {
        "fmus": {
            name: {"guid": d.guid, "model": d.modelName, "tool": d.generationTool}
            for name, d in prepared.system.descriptions.items()
        },
        "algorithm": str(experiment.algorithm),
        "communication_step_size_s": experiment.step_size,
        "extrapolation": experiment.extrapolation,
        **({"tolerance": experiment.tolerance} if experiment.tolerance else {}),
        **({"fmu_tolerance": experiment.fmu_tolerance} if experiment.fmu_tolerance else {}),
        **({"step_sizes_s": dict(experiment.step_sizes)} if experiment.step_sizes else {}),
        **({"open_inputs": open_inputs} if open_inputs else {}),
        **({"faults": [repr(fault) for fault in experiment.faults]} if experiment.faults else {}),
    }
