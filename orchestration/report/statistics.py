"""Sweeps in numbers: how metrics are distributed, and what they depend on. Failed samples are left out."""

from typing import Any

import numpy as np
from scipy.stats import rankdata

from orchestration.report.result import SweepResult

_PERCENTS = (0, 5, 50, 95, 100)

Correlations = dict[str, dict[str, float | None]]


def distributions(sweep: SweepResult) -> list[dict[str, Any]]:
    """For each metric: mean, standard deviation (n - 1), least, 5 %, median, 95 % and largest value."""
    rows = []
    for name, values in sweep.metrics.items():
        good = values[np.isfinite(values)]
        if len(good):
            spread = float(np.std(good, ddof=1)) if len(good) > 1 else 0.0
            row = [float(np.mean(good)), spread, *np.percentile(good, _PERCENTS).tolist()]
            rows.append({"name": name, "unit": sweep.units.get(name, ""), "values": row})
    return rows


def correlations(sweep: SweepResult) -> Correlations:
    """varied number -> metric -> Spearman's rank correlation; None where one of them does not vary."""
    return {
        name: {metric: _rank_correlation(values, of) for metric, of in sweep.metrics.items()}
        for name, values in sweep.varied.items()
        if np.issubdtype(values.dtype, np.number)
    }


def _rank_correlation(values: np.ndarray, metric: np.ndarray) -> float | None:
    good = np.isfinite(metric)
    if len(np.unique(values[good])) < 2 or len(np.unique(metric[good])) < 2:
        return None
    return float(np.corrcoef(rankdata(values[good]), rankdata(metric[good]))[0, 1])


def strongest(coefficients: Correlations) -> tuple[str, str] | None:
    """The varied number and the metric with the largest correlation."""
    strength = {
        (name, metric): abs(value)
        for name, row in coefficients.items()
        for metric, value in row.items()
        if value is not None
    }
    return max(strength, key=lambda pair: strength[pair]) if strength else None
