"""The cost of gains: mean RMSE over the cases of the cost, each with another seed of noise, with bounds.

What is beyond its bound costs `_SLOPE` for each time that the bound fits into the excess. That is steeper
than the RMSE falls with total variation, so that the least cost is at a bound or within it. The bound on the
delay margin is one more run, in which the measured depth is late by that much: it is to be quiet in hold.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from orchestration.many.job import Failure
from orchestration.many.lane_library import LANES
from orchestration.many.run_many import LocalRuns, in_order
from orchestration.margins.hold import QUIET, last_part
from orchestration.results.recording import Recording
from orchestration.score.closed_loop import ClosedLoop, ClosedLoopRun, Controller
from orchestration.score.protocol import Case, Protocol
from orchestration.score.protocol_format import DELAY_MARGIN
from orchestration.score.run_metrics import declared, metrics_of
from orchestration.score.tune import Evaluate

LARGEST = 1000.0  # cost of a run that ends early; finite, so that the search goes on
_SLOPE = 10.0

Metrics = Mapping[str, float]
Gains = Mapping[str, float]


@contextmanager
def evaluations(
    controller: Controller, protocol: Protocol, workers: int = 1, count: int = 1
) -> Iterator[Evaluate]:
    """Opens so many processes, which evaluate gains side by side, in vectors where that pays.

    count: of all evaluations. Gains whose runs fail, crash or take too long have the largest cost.
    """
    runs = count * (len(practice_cases(protocol)) + 1)
    with LocalRuns(workers, isolate=True, expected=runs) as place:
        loop = ClosedLoop(controller, protocol, partial(in_order, place), protocol.tables.time_limit)
        yield partial(costs, loop)


def costs(loop: ClosedLoop, gains: Sequence[Gains], every_seed: bool = False) -> Iterator[dict[str, Any]]:
    """Yields the cost of gains over those of the controller, with the mean metrics of each case.

    every_seed: each case with every practice seed, not with one
    """
    protocol, table = loop.protocol, loop.protocol.tables.cost
    cases, names = practice_cases(protocol, every_seed), {table.metric, *_metric_bounds(protocol)}
    computed = [(case, partial(metrics_of, metrics=declared(case, protocol, names))) for case in cases]
    late = [_late_run(loop, table.bounds[DELAY_MARGIN])] if DELAY_MARGIN in table.bounds else []
    groups = [gains[first : first + LANES] for first in range(0, len(gains), LANES)]
    pairs = [*computed, *late]
    runs = [ClosedLoopRun(case, how, one) for group in groups for case, how in pairs for one in group]
    results = loop.results(runs)
    for group in groups:
        of_group = [list(islice(results, len(group))) for _ in pairs]
        for of_one in zip(*of_group, strict=True):
            yield _cost(protocol, cases, of_one)


def _cost(protocol: Protocol, cases: Sequence[Case], results: Sequence[Any]) -> dict[str, Any]:
    """Returns the cost of the metrics of each case, and of the unrest of the late run, if it is bounded."""
    for result in results:
        if isinstance(result, Failure):
            return {"cost": LARGEST, "failure": result.reason}
    metrics: dict[str, list[Metrics]] = {}
    for case, of_run in zip(cases, results, strict=False):
        metrics.setdefault(case.name, []).append(of_run)
    unrest = results[len(cases)] if len(results) > len(cases) else 0.0
    bounds, table = _metric_bounds(protocol), protocol.tables.cost
    runs = [run_cost(run, table.metric, bounds) for case in metrics.values() for run in case]
    return {
        "cost": min(sum(runs) / len(runs) + _SLOPE * max(0.0, unrest / QUIET - 1.0), LARGEST),
        "metrics": {case: _mean(measured) for case, measured in metrics.items()},
        "unrest": unrest,
    }


def _metric_bounds(protocol: Protocol) -> dict[str, float]:
    bounds = protocol.tables.cost.bounds
    return {name: bound for name, bound in bounds.items() if name != DELAY_MARGIN}


def practice_cases(protocol: Protocol, every_seed: bool = False) -> list[Case]:
    """Returns the cases of the cost, each with another practice seed in turn, or with every one."""
    cases = [protocol.cases[name] for name in protocol.tables.cost.cases]
    seeds = protocol.tables.practice_seeds
    if every_seed:
        return [case.with_seed(seed) for case in cases for seed in seeds]
    return [case.with_seed(seeds[i % len(seeds)]) for i, case in enumerate(cases)]


def run_cost(metrics: Metrics, objective: str, bounds: Mapping[str, float]) -> float:
    """Returns the cost of one run: its objective, and what its metrics are beyond their bounds.

    A bound on a metric that is not a number does not apply: there is no overshoot where nothing moves.
    """
    excess = (metrics[name] / bound - 1.0 for name, bound in bounds.items())
    cost = metrics[objective] + _SLOPE * sum(x for x in excess if x > 0.0)
    return min(cost, LARGEST) if math.isfinite(cost) else LARGEST


def delayed(case: Case, delay: float, variable: str) -> Case:
    """Returns the case until its target is left, with an input that is late by so many seconds."""
    fault = {"input": variable, "kind": "delay", "delay": delay}
    faults = [*case.layer.get("faults", []), fault]
    experiment = {**case.layer.get("experiment", {}), "stop_time": case.target.window[1]}
    return replace(case, layer={**case.layer, "faults": faults, "experiment": experiment})


def _late_run(loop: ClosedLoop, delay: float) -> tuple[Case, Callable[[Recording], float]]:
    """Returns the nominal case with a late measurement, and what computes the unrest in its hold."""
    nominal = loop.protocol.nominal
    hold = last_part("depth", nominal.target.window[1])
    late = delayed(nominal, delay, loop.controller.variable("measured_depth"))
    return late, partial(unrest, start=hold.start)


def unrest(signals: Recording, start: float) -> float:
    """Returns the standard deviation [m] of the depth from a time on [s]; infinite if it was terminated."""
    if "terminated" in signals.provenance:
        return math.inf
    return float(np.std(signals["depth"][signals.time >= start]))


def _mean(runs: Sequence[Metrics]) -> dict[str, float]:
    """Returns the mean of each metric that is a number in every run."""
    means = {name: float(np.mean([run[name] for run in runs])) for name in runs[0]}
    return {name: mean for name, mean in means.items() if math.isfinite(mean)}
