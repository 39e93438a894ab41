"""Pareto fronts: the error of a law against the total variation of u, within a bound on the delay margin.

Each seed searches the least error under a bound on the total variation, then under half of that bound, and
so on: the epsilon constraint (Haimes, Lasdon and Wismer, IEEE Trans. SMC 1(3), 1971). Each search begins at
the best gains that the seed has evaluated until then. The front is of all evaluations of all seeds that keep
the other bounds of the cost and do not fail.
"""

import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fmus.files import write_text_atomically
from orchestration.errors import ScenarioError
from orchestration.score import tune_problem
from orchestration.score.closed_loop import ClosedLoop, Controller, tuned
from orchestration.score.protocol import Protocol
from orchestration.score.protocol_format import DELAY_MARGIN
from orchestration.score.score_rows import delay_margin_of
from orchestration.score.tune import Evaluate, Problem, SeedSearch, searching
from orchestration.score.tune_problem import LARGEST, beyond

LEVELS = 6
"""Bounds on the total variation, each half of the one before: from that of the protocol to a 32nd of it."""
LARGEST_ERROR = 10.0
"""RMSE [cm] of the point from which hypervolumes are measured: that of the paper's L1, untuned."""
LARGEST_SPREAD = 0.05
"""Of the hypervolumes of the seeds, of their median: where it is less, the seeds found one front."""
_MOST_POINTS = 16  # of a front that is written: each is checked by some twenty runs
_VARIATION = "total_variation"


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
    median = float(np.median(hypervolumes))
    return (max(hypervolumes) - min(hypervolumes)) / median if len(hypervolumes) > 1 and median else math.nan


def variation_of(row: Mapping[str, Any]) -> float:
    """Returns the mean total variation [N] over the cases of an evaluation; infinite if one failed to run."""
    cases = row.get("metrics", {}).values()
    return sum(case.get(_VARIATION, math.inf) for case in cases) / len(cases) if cases else math.inf


def bounded_cost(row: Mapping[str, Any], bound: float) -> float:
    """Returns the cost of an evaluation with a bound on its total variation."""
    return min(row["cost"] + beyond(variation_of(row), bound), LARGEST)


def admitted(rows: Iterable[Mapping[str, Any]], largest: float) -> list[Point]:
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
    restart: bool = False,
) -> list[list[Point]]:
    """Returns the front of each seed; interrupted or not, the same.

    largest: total variation [N] that is admitted; path: of the journal, which holds what is done
    """
    bounds = [largest * 0.5**level for level in range(LEVELS)]
    costs = [partial(bounded_cost, bound=bound) for bound in bounds]
    evaluations = evaluations_per_gain * len(problem.gains)
    problem = replace(problem, tuned={**problem.tuned, _VARIATION: bounds})
    searches = [SeedSearch(problem, seed, evaluations, costs=costs) for seed in seeds]
    with searching(problem, evaluations, path, evaluate, progress, restart) as run_searches:
        run_searches(searches)
    return [nondominated(admitted(search.rows, largest)) for search in searches]


def evaluations_of(problem: Problem, seeds: int, evaluations_per_gain: int) -> int:
    """Returns the number of evaluations of a front."""
    return evaluations_per_gain * len(problem.gains) * LEVELS * seeds


class Law(NamedTuple):
    """A controller whose front is searched, and the protocol of its cost, which leaves the variation free."""

    controller: Controller
    protocol: Protocol
    largest: float
    problem: Problem


def law_of(protocol: Protocol, name: str) -> Law:
    """Returns a controller of the protocol, at the step that its tuned gains need."""
    largest = protocol.tables.cost.bounds.get(_VARIATION, math.inf)
    if not math.isfinite(largest):
        raise ScenarioError(
            f"--fronts: the cost bounds no {_VARIATION}: expected --bound {_VARIATION}=NUMBER"
        )
    free = tune_problem.with_cost(protocol, {_VARIATION: math.inf})
    table = protocol.controllers[name]
    controller = replace(tuned(protocol, name), parameters=table.parameters)
    return Law(controller, free, largest, tune_problem.problem_of(controller, free))


def document_of(law: Law, fronts: Sequence[Sequence[Point]]) -> dict[str, Any]:
    """Returns the front of a law as plain data, each point with its delay margin.

    A point that loses its quiet with a shorter delay than its bound is left out.
    """
    controller, protocol = law.controller, law.protocol
    reference = Point(LARGEST_ERROR, law.largest)
    hypervolumes = [hypervolume(front, reference) for front in fronts]
    front = nondominated(point for front in fronts for point in front)
    chosen = np.unique(np.linspace(0, len(front) - 1, min(len(front), _MOST_POINTS)).round().astype(int))
    measured = [_measured(controller, protocol, front[i]) for i in chosen]
    least = protocol.tables.cost.bounds.get(DELAY_MARGIN, 0.0)
    points = [point for point in measured if point[DELAY_MARGIN] >= least]
    with ClosedLoop(controller, protocol) as loop:
        connected = loop.connected()
    with ClosedLoop(tune_problem.halved(controller, protocol), protocol) as fine:
        at_half = tune_problem.costs(fine, [point["gains"] for point in points])
        changes = [abs(half["cost"] / p["error"] - 1.0) for half, p in zip(at_half, points, strict=True)]
    return {
        "name": controller.name,
        "title": controller.title,
        "connected": connected,
        "gains": [gain.name for gain in law.problem.gains],
        "step": tune_problem.step_of(controller, protocol),
        "largest_change_at_half_the_step": max(changes, default=None),
        "hypervolumes": hypervolumes,
        "spread": None if math.isnan(spread(hypervolumes)) else spread(hypervolumes),
        "left_out": len(measured) - len(points),
        "points": points,
    }


def _measured(controller: Controller, protocol: Protocol, point: Point) -> dict[str, Any]:
    """Returns a point as plain data, with its delay margin [s]."""
    parameters = {**controller.parameters, **point.gains}
    with ClosedLoop(replace(controller, parameters=parameters), protocol) as loop:
        margin = delay_margin_of(loop, protocol.nominal)
    return {
        "error": point.error,
        _VARIATION: point.variation,
        DELAY_MARGIN: margin,
        "gains": dict(point.gains),
    }


def write(
    laws: Sequence[Mapping[str, Any]], protocol: Protocol, effort: Mapping[str, int], path: Path
) -> None:
    """Writes the fronts of laws, with the effort of their searches and the units of their numbers."""
    cost = protocol.tables.cost
    document = {
        "made_by": f"l1-depth {version('l1-depth')}",
        "protocol": protocol.version,
        "statement": protocol.statement,
        "vehicle": protocol.vehicle.name,
        "cost": cost.model_dump(),
        "effort": {**effort, "levels": LEVELS},
        "units": {"error": "cm", _VARIATION: "N", DELAY_MARGIN: "s", "step": "s", "hypervolumes": "decades2"},
        "reference": {"error": LARGEST_ERROR, _VARIATION: cost.bounds[_VARIATION]},
        "laws": list(laws),
    }
    write_text_atomically(path, json.dumps(document, indent=1) + "\n")
