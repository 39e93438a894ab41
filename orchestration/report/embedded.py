"""Numbers as text inside a page: exact, and small enough to send around."""

import base64
import zlib
from typing import Any

import numpy as np

from orchestration.report.result import RunResult, SweepResult
from orchestration.report.sweeps import correlations, groups_of, strongest
from orchestration.results.metrics import SIGNALS
from orchestration.results.recording import points_down
from orchestration.sweep.summary import categorical


def packed(values: np.ndarray) -> str:
    """Doubles -> base64 of zlib of their bytes, all first bytes before all second ones and so on.

    Neighbours in time share sign and exponent, so that these bytes compress well side by side.
    """
    bytes_of_values = np.ascontiguousarray(values, dtype="<f8").view(np.uint8).reshape(-1, 8)
    return base64.b64encode(zlib.compress(bytes_of_values.T.tobytes())).decode("ascii")


def run_data(run: RunResult) -> dict[str, Any]:
    """The data that the page's script draws of a run."""
    recording = run.recording
    columns = ((name, recording.unit(name), recording[name]) for name in recording.numbers)
    return {
        "name": run.name,
        "time": packed(recording.time),
        "signals": [
            {"name": name, "unit": unit or "1", "down": points_down(name, unit), "values": packed(column)}
            for name, unit, column in columns
        ],
        "in_metrics": sorted(
            {
                str(call[key])
                for call in run.scenario.get("metrics", {}).values()
                for key in SIGNALS
                if key in call
            }
        ),
    }


def sweep_data(sweep: SweepResult) -> dict[str, Any]:
    """The data that the page's script draws of a sweep."""
    categories = categorical(sweep.varied)
    return {
        "name": sweep.name,
        "samples": packed(sweep.samples),
        "errors": {int(n): error for n, error in zip(sweep.samples, sweep.errors, strict=True) if error},
        "columns": [
            {
                "name": name,
                "unit": sweep.units.get(name, ""),
                "kind": kind,
                "values": list(map(str, values)) if name in categories else packed(np.asarray(values)),
                "absent": sweep.absent.get(name, ""),
            }
            for kind, columns in (("varied", sweep.varied), ("metric", sweep.metrics))
            for name, values in columns.items()
        ],
        "groups": [
            {"name": ", ".join(group), "members": indices.tolist()}
            for group, indices in groups_of(sweep).items()
        ],
        "first": strongest(correlations(sweep)),
        "command": sweep.command,
    }
