"""Data of runs and sweeps that a page embeds for its scripts to draw."""

from typing import Any

import numpy as np

from orchestration.report.result import RunResult, SweepResult, correlations, groups_of, strongest
from orchestration.results.metrics import SIGNALS
from orchestration.results.page import packed
from orchestration.results.panels import drawn_points, points_down
from orchestration.sweep.table import categorical, grid

COLUMNS = 2000
"""Columns of pixels of a chart."""


def tracking_errors(run: RunResult) -> dict[str, tuple[str, str, np.ndarray]]:
    """Returns signal -> name, unit and values of its tracking error, scaled as the metric of the run."""
    errors: dict[str, tuple[str, str, np.ndarray]] = {}
    for metric, call in run.scenario.get("metrics", {}).items():
        signal, reference = call.get("signal"), call.get("reference")
        is_error = call.get("function") in ("rmse", "peak_error")
        if is_error and {signal, reference} <= set(run.recording.numbers) and signal not in errors:
            values = call.get("scale", 1.0) * (run.recording[signal] - run.recording[reference])
            errors[signal] = f"{signal} - {reference}", run.metric_units.get(metric, ""), values
    return errors


def _signal_data(
    name: str, unit: str, time: np.ndarray, values: np.ndarray, error_of: str = ""
) -> dict[str, Any]:
    """Returns the data of a line; error_of: the unit of the signal if the line is its tracking error."""
    kept = drawn_points(time, values, COLUMNS)
    return {
        "name": name,
        "unit": unit or "1",
        "error_of": error_of,
        "down": not error_of and points_down(name, unit),
        "values": packed(values[kept]),
        "steps": packed(np.diff(kept, prepend=0)) if len(kept) < len(time) else "",
    }


def run_data(run: RunResult) -> dict[str, Any]:
    """Returns the data of a run for the script of the page."""
    recording = run.recording
    signals = [
        _signal_data(name, recording.unit(name), recording.time, recording[name])
        for name in recording.numbers
    ]
    errors = tracking_errors(run)
    for of, (name, unit, values) in errors.items():
        at = recording.numbers.index(of) + 1  # after its signal
        signals.insert(at, _signal_data(name, unit, recording.time, values, recording.unit(of) or "1"))
    calls = run.scenario.get("metrics", {}).values()
    scored = {str(call[key]) for call in calls for key in SIGNALS if key in call}
    scored |= {name for name, _, _ in errors.values()}
    if run.is_measured:
        scored.update(recording.numbers)
    return {
        "name": run.name,
        "time": packed(recording.time),
        "is_measured": run.is_measured,
        "signals": signals,
        "in_metrics": sorted(scored),
    }


def sweep_data(sweep: SweepResult) -> dict[str, Any]:
    """Returns the data of a sweep for the script of the page."""
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
        "grid": grid(sweep.varied),
        "first": strongest(correlations(sweep)),
        "command": sweep.command,
    }
