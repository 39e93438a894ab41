"""What a set of weighted points tells: ranges, what the nominal row narrows, what depends on what."""

from typing import Any

import numpy as np
from posterior import effective_draws, positions
from vehicle import BY_NAME, FREQUENCY, VALUES, Columns

FAST_RAD_PER_S, LARGE_BOUND_N = 2.0, 1.5


def summary(points: Columns) -> dict[str, Any]:
    """Returns ranges of all points and of those that adapt fast, and what the nominal row narrows."""
    fast = is_fast(points)
    return {
        "points": len(points["draw"]),
        "draws": len(np.unique(points["draw"])),
        "effective_draws": round(effective_draws(points), 1),
        "all": ranges(points),
        "fast_share": round(float(np.sum(points["density"][fast]) / np.sum(points["density"])), 4),
        "fast": ranges({name: column[fast] for name, column in points.items()}),
        **dependences(points),
    }


def is_fast(points: Columns) -> np.ndarray:
    """Returns where adaptation is fast, as the paper describes it, and its bounds are beyond B - W."""
    large = np.minimum(points["controller.sigma_bound"], points["controller.theta_bound[1]"]) >= LARGE_BOUND_N
    return large & (points[FREQUENCY] >= FAST_RAD_PER_S)


def ranges(points: Columns) -> dict[str, list[float]]:
    """Returns least, 2.5 %, median, 97.5 % and largest of numbers, figures and changes with buoyancy."""
    columns = {name: points[name] for name in BY_NAME}
    for name, metric in VALUES:
        columns[f"{name} {metric}"] = points[f"{name} {metric}"]
        if name.startswith("nominal"):
            after = name.replace("nominal", "buoyancy")
            change = points[f"{after} {metric}"] - points[f"{name} {metric}"]
            columns[f"change-{name.partition('-')[2]} {metric}"] = change
    return {name: _quantiles(column, points["density"]) for name, column in columns.items()}


def _quantiles(column: np.ndarray, density: np.ndarray) -> list[float]:
    """Returns those of the runs that settle; nothing if none does."""
    settled = np.isfinite(column)
    if not settled.any():
        return []
    levels = (0.0, 0.025, 0.5, 0.975, 1.0)
    quantiles = np.quantile(column[settled], levels, weights=density[settled], method="inverted_cdf")
    return [float(f"{x:.4g}") for x in quantiles]


def dependences(points: Columns) -> dict[str, Any]:
    """Returns how far each number is narrowed, and the pairs that depend on each other, the strongest first.

    narrowed: standard deviation over that of its range, 1 where the nominal row tells nothing
    """
    names = tuple(BY_NAME)
    matrix = np.cov(positions(points, names).T, ddof=0, aweights=points["density"])
    deviation = np.sqrt(np.diag(matrix))
    with np.errstate(invalid="ignore"):  # of a number that is the same in all points
        correlation = matrix / np.outer(deviation, deviation)
    pairs = [
        (names[i], names[j], round(float(correlation[i, j]), 2))
        for i in range(len(names))
        for j in range(i)
        if abs(correlation[i, j]) >= 0.5
    ]
    return {
        "narrowed": {
            name: round(float(np.sqrt(12.0) * d), 3) for name, d in zip(names, deviation, strict=True)
        },
        "correlations": sorted(pairs, key=lambda pair: -abs(pair[2])),
    }


def nearest(points: Columns, tolerance: Any) -> dict[str, float]:
    """Returns the point whose eight figures are nearest to the published ones, in tolerances."""
    deviations = [(points[" ".join(figure)] - value) / tolerance(figure) for figure, value in VALUES.items()]
    row = int(np.argmin(np.nan_to_num(np.sum(np.square(deviations), axis=0), nan=np.inf)))
    return {name: float(points[name][row]) for name in BY_NAME}
