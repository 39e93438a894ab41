"""What a set of weighted points says: ranges, what they narrow, what depends on what."""

from typing import Any

import numpy as np

from orchestration.study.open_numbers import FREE, FREQUENCY, Columns

FAST_RAD_PER_S, LARGE_BOUND_N = 2.0, 1.5


def summary(points: Columns) -> dict[str, Any]:
    """Of all points, and of those that adapt fast."""
    fast = is_fast(points)
    return {
        "all": ranges(points),
        "fast_share": round(share_of(points, fast), 4),
        "fast": ranges({name: column[fast] for name, column in points.items()}),
        "narrowed": narrowed(points),
        "correlations": correlations(points),
    }


def ranges(points: Columns) -> dict[str, list[float]]:
    """Least, 2.5 %, median, 97.5 % and largest of every column, and of what added buoyancy changes."""
    columns = {name: column for name, column in points.items() if name not in ("density", "draw")}
    for controller in ("l1", "extended"):
        for metric in ("settling_time", "rmse"):
            change = points[f"buoyancy-{controller} {metric}"] - points[f"nominal-{controller} {metric}"]
            columns[f"change-{controller} {metric}"] = change
    return {
        name: _quantiles(column, points["density"])
        for name, column in columns.items()
        if not name.endswith("overshoot")
    }


def _quantiles(column: np.ndarray, density: np.ndarray) -> list[float]:
    """Of the runs that settle; nothing if none does."""
    settled = np.isfinite(column)
    if not settled.any():
        return []
    levels = (0.0, 0.025, 0.5, 0.975, 1.0)
    quantiles = np.quantile(column[settled], levels, weights=density[settled], method="inverted_cdf")
    return [float(f"{x:.4g}") for x in quantiles]


def is_fast(points: Columns) -> np.ndarray:
    """Where adaptation is fast, as the paper describes it, and its bounds are beyond B - W."""
    large = np.minimum(points["controller.sigma_bound"], points["controller.theta_bound[1]"]) >= LARGE_BOUND_N
    return large & (points[FREQUENCY] >= FAST_RAD_PER_S)


def share_of(points: Columns, chosen: np.ndarray) -> float:
    """How much of the density the chosen points have."""
    return float(np.sum(points["density"][chosen]) / np.sum(points["density"]))


def narrowed(points: Columns) -> dict[str, float]:
    """Standard deviation of each number over that of its range, 1 where the nominal row says nothing."""
    matrix = np.cov(_positions(points), ddof=0, aweights=points["density"])
    return {free.name: round(float(np.sqrt(12.0 * matrix[i, i])), 3) for i, free in enumerate(FREE)}


def correlations(points: Columns, least: float = 0.5) -> list[tuple[str, str, float]]:
    """The pairs of numbers that depend on each other, the strongest first."""
    matrix = np.cov(_positions(points), ddof=0, aweights=points["density"])
    deviation = np.sqrt(np.diag(matrix))
    pairs = [
        (FREE[i].name, FREE[j].name, round(float(matrix[i, j] / deviation[i] / deviation[j]), 2))
        for i in range(len(FREE))
        for j in range(i)
        if abs(matrix[i, j]) >= least * deviation[i] * deviation[j]
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def _positions(points: Columns) -> np.ndarray:
    """Where the numbers lie in their ranges, 0..1; shape (numbers, points)."""
    return np.array([free.position(points[free.name]) for free in FREE])
