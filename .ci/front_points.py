"""Points of Pareto fronts: which are on a front, its size, whether it is converged, and the figure."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from orchestration.results.figures import GREY, LINES, MARKERS, WIDTH_IN, figure_style, write_figure
from orchestration.results.formats import FigureFormat
from orchestration.studies.score.tune_problem import LARGEST, beyond

LARGEST_SPREAD = 0.05
"""Of the least error within each bound: where half of the seeds, as in a tuning, and half of the evaluations
come that near, a front is converged."""
VARIATION = "total_variation"
Row = Mapping[str, Any]


class Point(NamedTuple):
    """A trade-off: error [cm], total variation of u [N], and the gains that have it."""

    error: float
    variation: float
    gains: Mapping[str, float] = {}


def nondominated(points: Iterable[Point]) -> list[Point]:
    """Returns the points that no other one betters in both, by their total variation."""
    front: list[Point] = []
    for point in sorted(points, key=lambda point: (point.variation, point.error)):
        if not front or point.error < front[-1].error:
            front.append(point)
    return front


def hypervolume(points: Iterable[Point], reference: Point, least: float = 0.0) -> float:
    """Returns the area between a front and a reference point, in decades of both: what the front betters.

    least: variation [N] that lower ones count as
    """
    within = [p._replace(variation=max(p.variation, least)) for p in points]
    front = [
        p for p in nondominated(within) if p.error < reference.error and p.variation < reference.variation
    ]
    edges = [*(p.variation for p in front), reference.variation]
    widths = (math.log10(right / left) for left, right in pairwise(edges))
    return sum(w * math.log10(reference.error / p.error) for w, p in zip(widths, front, strict=True))


def spread(hypervolumes: Sequence[float]) -> float:
    """Returns the range of the hypervolumes of the seeds, of their median; not a number of one seed."""
    middle = median(hypervolumes) if len(hypervolumes) > 1 else 0.0
    return (max(hypervolumes) - min(hypervolumes)) / middle if middle else math.nan


def least_errors(front: Iterable[Point], bounds: Sequence[float]) -> list[float]:
    """Returns the least error [cm] of a front within each bound; infinite without a point."""
    points = [*front]
    return [min((p.error for p in points if p.variation <= bound), default=math.inf) for bound in bounds]


def is_converged(half: Sequence[Sequence[float]], errors: Sequence[Sequence[float]]) -> bool:
    """Whether half of the seeds, and half of the evaluations, come near the least error within every bound.

    half, errors: of each seed within each bound [cm], at half of the evaluations and at all
    """
    largest = (1.0 + LARGEST_SPREAD) * np.min(errors, axis=0)
    at_half, most_seeds = np.min(half, axis=0) <= largest, np.median(errors, axis=0) <= largest
    return bool(len(errors) > 1 and np.isfinite(largest).all() and at_half.all() and most_seeds.all())


def variation_of(row: Row) -> float:
    """Returns the largest total variation [N] of the cases of an evaluation; infinite if one failed to run.

    It is the number that `tune` bounds.
    """
    cases = row.get("metrics", {}).values()
    return max((case.get(VARIATION, math.inf) for case in cases), default=math.inf)


def bounded_cost(row: Row, bound: float) -> float:
    """Returns the cost that `tune` has for an evaluation with a bound on its total variation."""
    cases = row.get("metrics", {}).values()
    excess = [beyond(case.get(VARIATION, math.inf), bound) for case in cases]
    return min(row["cost"] + (sum(excess) / len(excess) if excess else 0.0), LARGEST)


def is_admitted(row: Row, largest: float) -> bool:
    """Whether an evaluation keeps every bound of the search and none of its runs failed."""
    return variation_of(row) <= largest and row["cost"] == row["error"] and not row["failed"]


def points_of(rows: Iterable[Row], largest: float) -> list[Point]:
    """Returns the evaluations that are admitted."""
    return [Point(row["error"], variation_of(row), row["gains"]) for row in rows if is_admitted(row, largest)]


def with_margin(points: Iterable[Point], has_margin: Callable[[Mapping[str, float]], bool]) -> list[Point]:
    """Returns the front of the points that have the delay margin: those without it hide no others."""
    left = [*points]
    while True:
        front = nondominated(left)
        lacking = [point for point in front if not has_margin(point.gains)]
        if not lacking:
            return front
        left = [point for point in left if point not in lacking]


def front_figure(
    fronts: Mapping[str, Sequence[Mapping[str, Any]]],
    path: Path,
    formats: Sequence[FigureFormat] = (FigureFormat.SVG,),
) -> list[Path]:
    """Draws the fronts of all laws on each vehicle: error against total variation, delay margin as colour.

    fronts: vehicle -> laws, each as `fronts.json` has it
    """
    drawn = {vehicle: [law for law in laws if law["points"]] for vehicle, laws in fronts.items()}
    names = list(dict.fromkeys(law["name"] for laws in drawn.values() for law in laws))
    margins = [point["delay_margin"] for laws in drawn.values() for law in laws for point in law["points"]]
    with figure_style():
        figure = Figure(figsize=(WIDTH_IN, WIDTH_IN), layout="constrained")
        panels = list(figure.subplots(1, len(fronts), squeeze=False)[0])
        shown: dict[str, Any] = {}
        for panel, (vehicle, laws) in zip(panels, drawn.items(), strict=True):
            panel.set(xscale="log", yscale="log", xlabel="Total variation [N]", title=vehicle)
            for law in laws:
                index, columns = names.index(law["name"]), ("total_variation", "error", "delay_margin")
                x, y, colour = ([point[column] for point in law["points"]] for column in columns)
                panel.plot(x, y, color=GREY, linestyle=LINES[index % len(LINES)], linewidth=0.5)
                dots = panel.scatter(x, y, s=14.0, c=colour, marker=MARKERS[index % len(MARKERS)])
                dots.set_clim(min(margins), max(margins))
                share = law["spread"] if len(fronts) == 1 else None
                apart = "" if share is None else f", seeds {100.0 * share:.2g} % apart"
                shown[f"{law['title']}{apart}"] = dots
        panels[0].set_ylabel("RMSE [cm]")
        if shown:
            label = "Delay margin [s]"
            figure.colorbar(shown[next(iter(shown))], ax=panels, label=label, location="top", shrink=0.5)
            figure.legend([*shown.values()], [*shown], loc="outside lower center", ncols=2)
        return write_figure(figure, path, formats)
