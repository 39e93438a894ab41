"""Search of the Pareto front of a law, in two budgets, as `fronts.py` explains it."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from front_points import (
    VARIATION,
    Point,
    Row,
    bounded_cost,
    hypervolume,
    is_converged,
    least_errors,
    nondominated,
    points_of,
    spread,
    with_margin,
)

from fmus.fmi.description import describe, start_value
from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.margins.fmu_margins import DELAYS
from orchestration.studies.score import tune_problem
from orchestration.studies.score.closed_loop import ClosedLoop, built_in, tuned
from orchestration.studies.score.protocol import Protocol, with_cost
from orchestration.studies.score.protocol_format import DELAY_MARGIN
from orchestration.studies.score.score_rows import delay_margin_of
from orchestration.studies.score.tune import Evaluate, Problem, SeedSearch, searching
from orchestration.studies.vehicle import built

LEVELS = 5
"""Bounds on the total variation, each half of the one before: from that of the protocol to a 16th of it.

Gains as identified from the paper have 460 to 545 N in the nominal case. What is below the least bound counts
as that bound: nobody flies errors of centimetres for less.
"""
LARGEST_ERROR = 4.35
"""RMSE [cm] of the point from which hypervolumes are measured: published, of the paper's L1 with PI."""
_BOUNDS = {"theta_bound[1]": (0.01, 100.0), "sigma_bound": (0.1, 100.0)}  # N, of the unknown
ALSO_FREE = {
    "adaptation_gain": _BOUNDS,
    "estimate_gain": _BOUNDS,
    "observer_bandwidth": {"disturbance_ratio": (0.01, 10.0)},
}
"""Gain of a law -> further ones, which are then free too; `tune` leaves them as they are."""
_MOST_POINTS = 16  # of a front that is written: each is checked by some twenty runs
_APART = 1000  # of the seeds of searches that follow one another
_ANY = 1e12  # N, above every total variation: it is measured, and bounded by `bounded_cost`


class _Begin(SeedSearch):
    """The evaluations of the gains that searches begin at, which CMA-ES itself never evaluates."""

    def __init__(self, problem: Problem, begin: Sequence[Mapping[str, float]]) -> None:
        super().__init__(problem, 0, len(begin))
        self._begin_at = begin

    def ask(self) -> list[dict[str, Any]]:
        if self.rows:
            return []
        self.rows = [
            {"seed": 0, "evaluation": number, "gains": {**gains}}
            for number, gains in enumerate(self._begin_at)
        ]
        return self.rows

    def tell(self) -> None:
        """Learns nothing of them."""


def search_fronts(
    problem: Problem,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    largest: float,
    path: Path,
    evaluate: Evaluate,
    progress: Callable[[int, float], None] = lambda done, cost: None,
    begin: Sequence[Mapping[str, float]] = (),
) -> list[tuple[list[Row], list[Row]]]:
    """Returns of each seed its evaluations at half of the budget and at all of it.

    Interrupted or not, they are the same.

    largest: total variation [N] that is admitted; path: of the journal, which holds what is done
    begin: gains, at the best of which all seeds begin, also outside the ranges; by default anywhere
    """
    bounds = [largest * 0.5**level for level in range(LEVELS)]
    evaluations = evaluations_per_gain * len(problem.gains)
    rows, half = {seed: list[Row]() for seed in seeds}, list[list[Row]]()
    problem = replace(problem, tuned={**problem.tuned, VARIATION: bounds, "begin": [*begin]})

    def started(row: Row) -> dict[str, float]:
        return {gain.name: gain.limited(row["gains"][gain.name]) for gain in problem.gains}

    with searching(problem, evaluations, path, evaluate, progress) as run_searches:
        if begin:
            first = _Begin(problem, begin)
            run_searches([first])
            rows = {seed: [*first.rows] for seed in seeds}
        for level, bound in enumerate([*bounds, *reversed(bounds)]):
            cost, searches = partial(bounded_cost, bound=bound), list[SeedSearch]()
            if level == LEVELS:
                half = [[*known] for known in rows.values()]
            for seed, of_seed in rows.items():
                start = started(min(of_seed, key=cost)) if of_seed else None
                searches.append(SeedSearch(problem, seed + _APART * level, evaluations, start, cost))
            run_searches(searches)
            for seed, search in zip(rows, searches, strict=True):
                rows[seed] += search.rows
    return list(zip(half, rows.values(), strict=True))


def known_gains(protocol: Protocol, name: str, gains: Sequence[FreeParameter]) -> list[dict[str, float]]:
    """Returns gains within their ranges: those tuned for the vehicle, and the start values of the FMU."""
    start = {v.name: start_value(v) for v in describe(built(protocol.controllers[name].fmu)).modelVariables}
    found: Any = [{**start, **tuned(protocol, name).parameters}, start]
    return [{gain.name: gain.limited(float(values[gain.name])) for gain in gains} for values in found]


def free_gains(protocol: Protocol, name: str) -> list[FreeParameter]:
    """Returns the gains of a controller of the protocol, and those that are free with them."""
    table = protocol.controllers[name]
    gains = [FreeParameter(gain, range.low, range.high) for gain, range in table.gains.items()]
    further = {n: ends for gain in table.gains for n, ends in ALSO_FREE.get(gain, {}).items()}
    known = {v.name for v in describe(built(table.fmu)).modelVariables}
    # a bound has two numbers or one
    names = {n if n in known else n.partition("[")[0]: ends for n, ends in further.items()}
    return [*gains, *(FreeParameter(gain, *ends) for gain, ends in names.items())]


def front_of_law(
    protocol: Protocol,
    name: str,
    seeds: Sequence[int],
    evaluations_per_gain: int,
    workers: int,
    path: Path,
    progress: Callable[[int, float], None] = lambda done, cost: None,
    special: Sequence[Mapping[str, float]] = (),
) -> dict[str, Any]:
    """Returns the front of a controller of the protocol as plain data.

    Its step is that of the protocol, as of every law. Each point has its delay margin.

    special: gains that make the law one of its special cases; the searches begin at these, too
    """
    largest = protocol.tables.cost.bounds.get(VARIATION, math.inf)
    if not math.isfinite(largest):
        raise ScenarioError(f"the cost bounds no {VARIATION}: expected --bound {VARIATION}=NUMBER")
    protocol = with_cost(protocol, {"bounds": {VARIATION: _ANY}})
    parameters = {**built_in(protocol, name).parameters, **protocol.controllers[name].parameters}
    controller = replace(tuned(protocol, name), parameters=parameters, step=0.0)
    problem = tune_problem.problem_of(controller, protocol, free_gains(protocol, name))
    total = 2 * LEVELS * len(seeds) * evaluations_per_gain * len(problem.gains)
    with tune_problem.evaluations(controller, protocol, workers, total) as evaluate:
        begin = [*known_gains(protocol, name, problem.gains), *special]
        how = largest, path, evaluate, progress, begin
        budgets = search_fronts(problem, seeds, evaluations_per_gain, *how)
    reference, bounds = Point(LARGEST_ERROR, largest), [largest * 0.5**level for level in range(LEVELS)]
    bound = protocol.tables.cost.bounds.get(DELAY_MARGIN, 0.0)
    with ClosedLoop(controller, protocol) as loop:
        margins = dict[str, float]()

        def has_margin(gains: Mapping[str, float]) -> bool:
            key = repr(gains)
            if bound and key not in margins:
                margins[key] = margin_of(loop, gains, bound)
            return not bound or margins[key] >= bound

        fronts = [[with_margin(points_of(rows, largest), has_margin) for rows in both] for both in budgets]
        half, errors = (
            [least_errors(front, bounds) for front in of_budget] for of_budget in zip(*fronts, strict=True)
        )
        volumes = [hypervolume(front, reference, bounds[-1]) for _, front in fronts]
        front, points = nondominated(point for both in fronts for point in both[1]), list[dict[str, Any]]()
        for i in sorted({*np.linspace(0, len(front) - 1, min(len(front), _MOST_POINTS)).round().astype(int)}):
            error, variation, gains = front[i]
            point = {"error": error, VARIATION: variation, DELAY_MARGIN: margin_of(loop, gains)}
            change = tune_problem.change_at_half_the_step(gains, controller, protocol)
            points.append({**point, "gains": gains, "change_at_half_the_step": change})
    return {
        "name": name,
        "title": controller.title,
        "gains": len(problem.gains),
        "hypervolumes": volumes,
        "spread": None if math.isnan(spread(volumes)) else spread(volumes),
        "least_errors_at_half": half,
        "least_errors": errors,
        "is_converged": is_converged(half, errors),
        "points": points,
    }


def margin_of(loop: ClosedLoop, gains: Mapping[str, float], largest: float = DELAYS.largest) -> float:
    """Returns the delay margin [s] in the nominal case, as far as the largest delay; nan of a failed run."""
    try:
        return delay_margin_of(loop, loop.protocol.nominal, gains, largest)
    except OrchestrationError:
        return math.nan
