"""Pareto fronts: the error of a law against the total variation of u, within a bound on the delay margin.

Each seed searches the least error under a bound on the total variation, then under half of that bound, and
so on: the epsilon constraint (Haimes, Lasdon and Wismer, IEEE Trans. SMC 1(3), 1971). The first search begins
at the tuned gains, each other one at the best gains that the seed has evaluated until then. The front is of
all evaluations of all seeds that keep the other bounds of the cost and do not fail.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from orchestration.errors import ScenarioError
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.score import tune_problem
from orchestration.studies.score.closed_loop import ClosedLoop, tuned
from orchestration.studies.score.protocol import Protocol, with_cost
from orchestration.studies.score.protocol_format import DELAY_MARGIN
from orchestration.studies.score.score_rows import delay_margin_of
from orchestration.studies.score.tune import Evaluate, Problem, SeedSearch, searching
from orchestration.studies.score.tune_problem import LARGEST, beyond

LEVELS = 6
"""Bounds on the total variation, each half of the one before: from that of the protocol to a 32nd of it."""
LARGEST_ERROR = 10.0
"""RMSE [cm] of the point from which hypervolumes are measured: that of the paper's L1, untuned.

Below it what is beyond a bound costs more than the error falls with the variation (`tune_problem.beyond`).
"""
LARGEST_SPREAD = 0.05
"""Of the hypervolumes of the seeds, of their median: where it is less, the seeds found one front."""
_MOST_POINTS = 16  # of a front that is written: each is checked by some twenty runs
_APART = 1000  # of the seeds of searches that follow one another
_ANY = 1e12  # N, above every total variation: it is measured, and bounded by `bounded_cost`
_VARIATION = "total_variation"
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


def hypervolume(points: Iterable[Point], reference: Point) -> float:
    """Returns the area between a front and a reference point, in decades of both: what the front betters."""
    front = [
        p for p in nondominated(points) if p.error < reference.error and p.variation < reference.variation
    ]
    edges = [*(p.variation for p in front), reference.variation]
    widths = (math.log10(right / left) for left, right in pairwise(edges))
    return sum(w * math.log10(reference.error / p.error) for w, p in zip(widths, front, strict=True))


def spread(hypervolumes: Sequence[float]) -> float:
    """Returns the range of the hypervolumes of the seeds, of their median; not a number of one seed."""
    middle = median(hypervolumes) if len(hypervolumes) > 1 else 0.0
    return (max(hypervolumes) - min(hypervolumes)) / middle if middle else math.nan


def variation_of(row: Row) -> float:
    """Returns the mean total variation [N] over the cases of an evaluation; infinite if one failed to run."""
    cases = row.get("metrics", {}).values()
    return sum(case.get(_VARIATION, math.inf) for case in cases) / len(cases) if cases else math.inf


def bounded_cost(row: Row, bound: float) -> float:
    """Returns the cost of an evaluation with a bound on its total variation."""
    return min(row["cost"] + beyond(variation_of(row), bound), LARGEST)


def admitted(rows: Iterable[Row], largest: float) -> list[Point]:
    """Returns the evaluations that keep every bound, no run of which failed."""
    return [
        Point(row["error"], variation, row["gains"])
        for row in rows
        if (variation := variation_of(row)) <= largest and row["cost"] == row["error"] and not row["failed"]
    ]


def search_front(
    problem: Problem,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    largest: float,
    path: Path,
    evaluate: Evaluate,
    progress: Callable[[int, float], None] = lambda done, cost: None,
    begin: Mapping[str, float] | None = None,
) -> list[list[Point]]:
    """Returns the front of each seed; interrupted or not, the same.

    largest: total variation [N] that is admitted; path: of the journal, which holds what is done
    begin: the gains that all seeds begin at, by default anywhere
    """
    bounds = [largest * 0.5**level for level in range(LEVELS)]
    evaluations, rows = evaluations_per_gain * len(problem.gains), {seed: list[Row]() for seed in seeds}
    problem = replace(problem, tuned={**problem.tuned, _VARIATION: bounds, "begin": begin})
    with searching(problem, evaluations, path, evaluate, progress) as run_searches:
        for level, bound in enumerate(bounds):
            cost, searches = partial(bounded_cost, bound=bound), list[SeedSearch]()
            for seed, found in rows.items():
                start = min(found, key=cost)["gains"] if found else begin
                searches.append(SeedSearch(problem, seed + _APART * level, evaluations, start, cost))
            run_searches(searches)
            for seed, search in zip(rows, searches, strict=True):
                rows[seed] += search.rows
    return [nondominated(admitted(found, largest)) for found in rows.values()]


def tuned_for(protocol: Protocol, name: str, gains: Sequence[FreeParameter]) -> dict[str, float] | None:
    """Returns the tuned gains of a controller for the vehicle, within their ranges; None if it has none."""
    found: Mapping[str, Any] = tuned(protocol, name).parameters
    if not all(gain.name in found for gain in gains):
        return None
    return {gain.name: gain.limited(float(found[gain.name])) for gain in gains}


def front_of_law(
    protocol: Protocol,
    name: str,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    workers: int,
    path: Path,
    progress: Callable[[int, float], None] = lambda done, cost: None,
) -> dict[str, Any]:
    """Returns the front of a controller of the protocol as plain data, at the step that its tuned gains need.

    Each point has its delay margin; one that is not quiet with a shorter delay than the bound is left out.
    """
    largest = protocol.tables.cost.bounds.get(_VARIATION, math.inf)
    if not math.isfinite(largest):
        raise ScenarioError(
            f"--fronts: the cost bounds no {_VARIATION}: expected --bound {_VARIATION}=NUMBER"
        )
    protocol = with_cost(protocol, {"bounds": {_VARIATION: _ANY}})
    controller = replace(tuned(protocol, name), parameters=protocol.controllers[name].parameters)
    problem = tune_problem.problem_of(controller, protocol)
    total = LEVELS * len(seeds) * evaluations_per_gain * len(problem.gains)
    with tune_problem.evaluations(controller, protocol, workers, total) as evaluate:
        how = largest, path, evaluate, progress, tuned_for(protocol, name, problem.gains)
        fronts = search_front(problem, seeds, evaluations_per_gain, *how)
    volumes = [hypervolume(front, Point(LARGEST_ERROR, largest)) for front in fronts]
    front, points = nondominated(point for front in fronts for point in front), list[dict[str, Any]]()
    for i in sorted({*np.linspace(0, len(front) - 1, min(len(front), _MOST_POINTS)).round().astype(int)}):
        error, variation, gains = front[i]
        at_gains = replace(controller, parameters={**controller.parameters, **gains})
        with ClosedLoop(at_gains, protocol) as loop:
            margin = delay_margin_of(loop, protocol.nominal)
        if margin >= protocol.tables.cost.bounds.get(DELAY_MARGIN, 0.0):
            point = {"error": error, _VARIATION: variation, DELAY_MARGIN: margin, "gains": gains}
            change = tune_problem.change_at_half_the_step(gains, controller, protocol)
            points.append({**point, "change_at_half_the_step": change})
    return {
        "name": name,
        "title": controller.title,
        "step": tune_problem.step_of(controller, protocol),
        "hypervolumes": volumes,
        "spread": None if math.isnan(spread(volumes)) else spread(volumes),
        "points": points,
    }
