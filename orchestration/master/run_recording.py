"""The recording of a run: its recorded values, and the provenance that follows from the prepared run."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from orchestration.results.recording import Recording
from orchestration.system.prepared_run import PreparedRun


def make_recording(
    prepared: PreparedRun, rows: np.ndarray, count: int, more: Mapping[str, Any] = {}
) -> Recording:
    """The recorded values at the first `count` communication points.

    rows: shape `prepared.shape`; more: further entries of the provenance
    """
    ports = prepared.system.ports
    return Recording(
        names=prepared.recorded,
        units=tuple(ports[name].variable.unit or "" for name in prepared.recorded),
        time=prepared.points[:count].copy(),
        values=np.array(rows[:count]),
        provenance=_provenance(prepared) | dict(more),
    )


def _provenance(prepared: PreparedRun) -> dict[str, Any]:
    """The FMUs and the settings of the run, as plain data."""
    experiment = prepared.experiment
    return {
        "fmus": {
            name: {"guid": d.guid, "model": d.modelName, "tool": d.generationTool}
            for name, d in prepared.system.descriptions.items()
        },
        "algorithm": str(experiment.algorithm),
        "communication_step_size_s": experiment.step_size,
        "extrapolation": experiment.extrapolation,
        **({"tolerance": experiment.tolerance} if experiment.tolerance else {}),
        **({"step_sizes_s": dict(experiment.step_sizes)} if experiment.step_sizes else {}),
        **({"faults": [repr(fault) for fault in experiment.faults]} if experiment.faults else {}),
    }
