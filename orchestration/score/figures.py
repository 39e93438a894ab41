"""The figures of one run: metrics of its depth, its reference and its voltages, and whether it failed."""

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.score.protocol import Case, Protocol, metric_of
from orchestration.score.protocol_format import SIGNALS


def judged_signals(
    recording: Recording, columns: Sequence[str], limits: Sequence[float], gains: Sequence[float]
) -> Recording:
    """The recording with the signals that figures are computed of (`SIGNALS`) in place of its own.

    columns: names of reference, depth and both voltages; limits [V], gains [N/V]: of both thrusters
    """
    reference, depth, *voltages = (recording[name] for name in columns)
    first, second = np.abs(voltages)
    delivered = np.clip(np.column_stack(voltages), -np.asarray(limits), limits)
    values = {
        "depth": depth,
        "reference": reference,
        "u": delivered @ np.asarray(gains),
        "voltage": np.maximum(first, second),
        "power": delivered[:, 0] ** 2 + delivered[:, 1] ** 2,
        "saturated": 100.0 * ((first >= limits[0]) | (second >= limits[1])),
    }
    table = np.column_stack([values[name] for name in SIGNALS])
    return Recording(tuple(SIGNALS), tuple(SIGNALS.values()), recording.time, table, recording.provenance)


def figures_of(
    signals: Recording, case: Case, protocol: Protocol, names: Collection[str] = ()
) -> dict[str, float]:
    """Name -> figure of a run of a case, of all or of those named; not a number for what did not happen.

    signals: as `judged_signals` gives them
    """
    tables = {name: table for name, table in protocol.figures.items() if not names or name in names}
    declared = {
        name: metric_of(table, case)
        for name, table in tables.items()
        if case.target.moves or not table.of_motion
    }
    values = metrics.evaluate(signals, declared)
    return {name: values.get(name, math.nan) for name in tables}


def failures(figures: Mapping[str, float], protocol: Protocol) -> list[str]:
    """Why a run failed: what did not happen, and what is above its limit; empty if it did not."""
    reasons = ["not settled"] if math.isnan(figures.get("settling_time", 0.0)) else []
    for name, limit in protocol.tables.failure.items():
        if figures.get(name, 0.0) > limit:
            table = protocol.figures[name]
            reasons.append(f"{table.title.lower()} {figures[name]:.3g} {table.unit}")
    return reasons
