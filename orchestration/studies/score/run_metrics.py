"""Metrics of a run, of its depth, its reference and its voltages, and whether it failed."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np

from orchestration.results.metrics import evaluate
from orchestration.results.recording import Recording
from orchestration.scenarios.actuators import Actuators
from orchestration.studies.score.protocol import Case, Protocol, metric_of
from orchestration.studies.score.protocol_format import SIGNALS

_TRACED = ("depth", "reference", "u")
_TRACE_PERIOD_S = 0.5

Trace = dict[str, list[float]]
"""time [s], depth [m], reference [m] and u [N] of a run, every half second."""


def judged(runs: Recording, compute: Callable[[Recording], Any], **of_signals: Any) -> list[Any]:
    """Returns what a function computes of the `judged_signals` of each run; of_signals: their arguments."""
    return [compute(judged_signals(runs.run(i), **of_signals)) for i in range(len(runs.values))]


def judged_signals(
    recording: Recording, columns: Sequence[str], actuators: Actuators, stride: int = 1
) -> Recording:
    """Returns the recording with the signals that metrics use (`SIGNALS`) in place of its signals.

    columns: names of reference, depth and actuators. Of actuators that take a force, voltage and power are
    not a number. stride: of the communication points that are judged
    """
    reference, depth, *inputs = (recording[name] for name in columns)
    given = np.column_stack(inputs)
    delivered, is_limited = actuators.delivered(given), np.isfinite(actuators.ranges).all()
    unknown = np.full_like(depth, math.nan)
    values = {
        "depth": depth,
        "reference": reference,
        "u": actuators.force(delivered),
        "voltage": np.abs(given).max(axis=1) if actuators.in_volts else unknown,
        "power": (delivered**2).sum(axis=1) if actuators.in_volts else unknown,
        "saturated": 100.0 * actuators.is_saturated(given) if is_limited else unknown,
    }
    table = np.column_stack([values[name] for name in SIGNALS])
    time, table = recording.time[::stride], table[::stride]
    return Recording(tuple(SIGNALS), tuple(SIGNALS.values()), time, table, recording.provenance)


def all_signals(signals: Recording) -> Recording:
    """Returns the signals, of which nothing is computed where the run is made."""
    return signals


def declared(case: Case, protocol: Protocol, names: Collection[str] = ()) -> dict[str, dict[str, Any] | None]:
    """Returns name -> declaration of the metrics of a case, all or those named; None if it cannot happen."""
    return {
        name: metric_of(table, case) if case.target.moves or not table.of_motion else None
        for name, table in protocol.metrics.items()
        if not names or name in names
    }


def metrics_of(signals: Recording, metrics: Mapping[str, Mapping[str, Any] | None]) -> dict[str, float]:
    """Returns name -> metric of a run; not a number for what did not happen.

    signals: as `judged_signals` gives them; metrics: as `declared` gives them
    """
    values = evaluate(signals, {name: metric for name, metric in metrics.items() if metric})
    return {name: values.get(name, math.nan) for name in metrics}


def traced_metrics(
    signals: Recording, metrics: Mapping[str, Mapping[str, Any] | None], traced: bool
) -> tuple[dict[str, float], Trace]:
    """Returns the metrics of a run, and its trace if it is traced."""
    stride = max(1, round(_TRACE_PERIOD_S / (signals.time[1] - signals.time[0])))
    columns = {name: signals[name][::stride] for name in ("time", *_TRACED)} if traced else {}
    return metrics_of(signals, metrics), {n: np.round(column, 5).tolist() for n, column in columns.items()}


def failures(metrics: Mapping[str, float], protocol: Protocol) -> list[str]:
    """Returns why a run failed: not settled, or a metric above its limit; empty if it did not."""
    reasons = ["not settled"] if math.isnan(metrics.get("settling_time", 0.0)) else []
    for name, limit in protocol.tables.failure.items():
        if metrics.get(name, 0.0) > limit:
            table = protocol.metrics[name]
            reasons.append(f"{table.title.lower()} {metrics[name]:.3g} {table.unit}")
    return reasons
