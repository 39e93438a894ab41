"""The tuning of one controller: its free gains, their cost, and the file of those found.

The cost is the mean RMSE over some cases, each with another seed of noise, with bounds; or over the worst of
some plants. An excess over a bound costs `_SLOPE` for each time that the bound fits into it. That
is steeper than the RMSE falls with total variation, so that the least cost is at a bound or within it. The
bound on the delay margin is one more run, in which the measured depth is late by that much, as `scan` makes
it late: it is to be quiet in hold.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fmus.files import write_text_atomically
from fmus.fmi.description import describe
from fmus.store import digest
from orchestration.errors import OrchestrationError
from orchestration.many.job import Failure
from orchestration.many.lane_library import LANES
from orchestration.many.local_runs import LocalRuns
from orchestration.many.run_many import in_order
from orchestration.results.recording import Recording
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.margins.hold import QUIET, last_part
from orchestration.studies.score import tune
from orchestration.studies.score.closed_loop import ClosedLoop, ClosedLoopRun, Controller
from orchestration.studies.score.draws import plants
from orchestration.studies.score.protocol import Case, Protocol
from orchestration.studies.score.protocol_format import DELAY_MARGIN
from orchestration.studies.score.run_metrics import declared, failures, metrics_of
from orchestration.studies.score.tune import Evaluate, Problem, SearchResult, Tuning, with_units
from orchestration.system.prepared_run import prepare

# cost of a run that ends early; finite, so that the search goes on
LARGEST = 1000.0
_SLOPE = 10.0
# share of the plants whose costs are averaged: CVaR of 5 % of 20 plants would be the cost of a single one
WORST = 0.2
LARGEST_CHANGE = 0.02  # of the error, when the step is halved
SHORTEST_STEP = 1.25e-3  # s, that a tuning goes to

Metrics = Mapping[str, float]
Gains = Mapping[str, float]


def problem_of(controller: Controller, protocol: Protocol, free: Iterable[FreeParameter] = ()) -> Problem:
    """Returns the tuning of a controller, by default of the gains that the protocol has for it.

    Raises OrchestrationError for a controller that does not fit the vehicle, a value or a gain that its FMU
    cannot take, or a gain that is given a value for all evaluations.
    """
    case = practice_cases(protocol)[0]
    with ClosedLoop(controller, protocol) as loop:
        system = loop.scenario(case).system
        prepare(system, loop.experiment(case))
    components = system.components
    gains = with_units(list(free) or _of_protocol(controller, protocol), describe(components["controller"]))
    for gain in gains:
        if gain.name in controller.parameters:
            raise OrchestrationError(f"{gain.name}: it is set, and free: expected one of them")
    tuned = {
        "controller": repr(controller),
        "fmus": {name: digest(path.read_bytes()) for name, path in components.items()},
        "protocol": _what_costs(protocol),
    }
    return Problem(gains, tuned)


def cost_of_options(bounds: Iterable[str], cases: str, plant_count: int = 0) -> dict[str, Any]:
    """Returns entries of a cost: of METRIC=NUMBER of --bound, NAME,... of --cases, and --plants."""
    cost: dict[str, Any] = {"bounds": {}}
    for option in bounds:
        name, _, number = option.rpartition("=")
        try:
            cost["bounds"][name.strip()] = float(number)
        except ValueError:
            expected = "METRIC=NUMBER, such as delay_margin=0.1"
            raise OrchestrationError(f"--bound {option}: expected {expected}") from None
    chosen = {"cases": listed(cases), "plants": plant_count}
    return cost | {name: value for name, value in chosen.items() if value}


def listed(names: str) -> list[str]:
    """Returns the names of an option NAME,..."""
    return [name.strip() for name in names.split(",") if name.strip()]


def step_of(controller: Controller, protocol: Protocol) -> float:
    """Returns the communication step [s] of a controller's runs."""
    with ClosedLoop(controller, protocol) as loop:
        return loop.experiment(protocol.nominal).step_size


def at_enough_steps(gains: Gains, controller: Controller, protocol: Protocol) -> Controller:
    """Returns the controller with its step halved until half of it changes the error of gains little.

    That is by at most `LARGEST_CHANGE`, or the step is `SHORTEST_STEP`.
    """
    # "not <=" rather than ">": a change that is not a number halves the step, too
    while (
        step_of(controller, protocol) > SHORTEST_STEP
        and not abs(change_at_half_the_step(gains, controller, protocol)) <= LARGEST_CHANGE
    ):
        controller = halved(controller, protocol)
    return controller


def halved(controller: Controller, protocol: Protocol) -> Controller:
    """Returns the controller with half the communication step."""
    return replace(controller, step=0.5 * step_of(controller, protocol))


def change_at_half_the_step(gains: Gains, controller: Controller, protocol: Protocol) -> float:
    """Returns the relative change of the error of gains when the communication step is halved.

    The cost would mislead: the best gains only just keep their bounds, and a value beyond one costs much.
    """
    with (
        ClosedLoop(controller, protocol) as coarse,
        ClosedLoop(halved(controller, protocol), protocol) as fine,
    ):
        before, after = (next(costs(loop, [gains])).get("error", math.nan) for loop in (coarse, fine))
    return after / before - 1.0


def _of_protocol(controller: Controller, protocol: Protocol) -> list[FreeParameter]:
    table = protocol.controllers.get(controller.name)
    if table is None or table.fmu != controller.fmu:
        return []
    return [FreeParameter(name, gain.low, gain.high) for name, gain in table.gains.items()]


def _what_costs(protocol: Protocol) -> dict[str, Any]:
    """Returns the part of the protocol that the cost depends on, as plain data."""
    data = protocol.file.data
    return {
        "version": protocol.version,
        "cost": data["cost"],
        "cases": {name: data["cases"][name] for name in data["cost"]["cases"]},
        "vehicle": protocol.vehicle.key,
        **{key: data[key] for key in ("base", "trajectory", "practice_seeds", "plants")},
    }


@contextmanager
def evaluations(
    controller: Controller, protocol: Protocol, workers: int = 1, count: int = 1
) -> Iterator[Evaluate]:
    """Opens so many processes, which evaluate gains side by side, in vectors where that pays.

    count: of all evaluations
    Gains whose runs fail, crash or take too long have the largest cost.
    """
    runs = count * (len(practice_cases(protocol)) + 1)
    with LocalRuns(workers, isolate=True, expected=runs) as local:
        loop = ClosedLoop(controller, protocol, partial(in_order, local), protocol.tables.time_limit)
        yield partial(costs, loop)


def costs(loop: ClosedLoop, gains: Sequence[Gains], every_seed: bool = False) -> Iterator[dict[str, Any]]:
    """Yields the cost of gains, laid over the gains of the controller, with the mean metrics of each case.

    every_seed: each case with every practice seed, not with one
    """
    protocol, table = loop.protocol, loop.protocol.tables.cost
    cases = practice_cases(protocol, every_seed)
    names = {table.metric, *_metric_bounds(protocol), "settling_time", *protocol.tables.failure}
    computed = [(case, partial(metrics_of, metrics=declared(case, protocol, names))) for case in cases]
    late = [_late_run(loop, table.bounds[DELAY_MARGIN])] if DELAY_MARGIN in table.bounds else []
    groups = [gains[first : first + LANES] for first in range(0, len(gains), LANES)]
    # the gains of a group follow each other in every case, so that their runs step together in vectors
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
    # the result of the late run, if there is one, comes after the cases
    for case, of_run in zip(cases, results, strict=False):
        metrics.setdefault(case.name, []).append(of_run)
    unrest = results[len(cases)] if len(results) > len(cases) else 0.0
    bounds, table = _metric_bounds(protocol), protocol.tables.cost
    runs, share = results[: len(cases)], WORST if table.plants else 1.0
    cost = mean_of_worst([run_cost(run, table.metric, bounds) for run in runs], share)
    return {
        "cost": min(cost + beyond(unrest, QUIET), LARGEST),
        "error": mean_of_worst([run[table.metric] for run in runs], share),
        "metrics": {case: _mean(measured) for case, measured in metrics.items()},
        "unrest": unrest,
        "failed": sum(bool(failures(run, protocol)) for run in runs),
    }


def mean_of_worst(costs: Sequence[float], share: float) -> float:
    """Returns the mean of the largest costs, so many of them or one more: CVaR if the share is below 1."""
    worst = sorted(costs)[-math.ceil(share * len(costs)) :]
    return sum(worst) / len(worst)


def beyond(value: float, bound: float) -> float:
    """Returns what a value costs that is beyond its bound."""
    return _SLOPE * max(0.0, value / bound - 1.0)


def _metric_bounds(protocol: Protocol) -> dict[str, float]:
    bounds = protocol.tables.cost.bounds
    return {name: bound for name, bound in bounds.items() if name != DELAY_MARGIN}


def practice_cases(protocol: Protocol, every_seed: bool = False) -> list[Case]:
    """Returns the cases of the cost, each with another practice seed in turn, or with every one.

    Plants, if the cost is over some, have their seeds.
    """
    if count := protocol.tables.cost.plants:
        return plants(protocol, protocol.tables.plants.practice_seed, count)
    cases = [protocol.cases[name] for name in protocol.tables.cost.cases if name not in protocol.left_out]
    if not cases:
        reasons = "; ".join(protocol.left_out[name] for name in protocol.tables.cost.cases)
        raise OrchestrationError(f"no case of the cost can be run: {reasons}")
    seeds = protocol.tables.practice_seeds
    if every_seed:
        return [case.with_seed(seed) for case in cases for seed in seeds]
    return [case.with_seed(seeds[i % len(seeds)]) for i, case in enumerate(cases)]


def run_cost(metrics: Metrics, objective: str, bounds: Mapping[str, float]) -> float:
    """Returns the cost of one run: its objective, and the excess of its metrics over their bounds.

    A bound on a metric that is not a number does not apply: there is no overshoot where nothing moves.
    """
    cost = metrics[objective] + sum(beyond(metrics[name], bound) for name, bound in bounds.items())
    return min(cost, LARGEST) if math.isfinite(cost) else LARGEST


def delayed(case: Case, delay: float, variable: str) -> Case:
    """Returns the case until its target is left, with an input that is late by so many seconds."""
    fault = {"input": variable, "kind": "interpolated-delay", "delay": delay}
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


def provenance(tuning: Tuning, controller: Controller, protocol: Protocol) -> dict[str, Any]:
    """Returns the entries of a tuning's file on the controller, the protocol and the cost.

    Raises OrchestrationError if every evaluation failed: then there are no gains to write.
    """
    best = tuning.best
    if best.cost >= LARGEST:
        raise OrchestrationError(
            f"{controller.name}: none of {tuning.evaluations} evaluations ran to its end: expected one that "
            f"does; the last failure: {best.metrics.get('failure', 'a cost that is not finite')}"
        )
    with ClosedLoop(controller, protocol) as loop:
        (every_seed,) = costs(loop, [best.gains], every_seed=True)
    table, cases = protocol.tables.cost, dict.fromkeys(case.name for case in practice_cases(protocol))
    of = f"the worst {100 * WORST:g} % of {table.plants} practice plants"
    of = of if table.plants else f"{', '.join(cases)}, practice seeds"
    return {
        "controller": controller.name,
        "fmu": Path(controller.fmu).name,
        "reference_rates": controller.reference_rates,
        "protocol": protocol.version,
        "vehicle": protocol.vehicle.name,
        "step": step_of(controller, protocol),
        "change_at_half_the_step": change_at_half_the_step(best.gains, controller, protocol),
        "objective": f"mean {table.metric} over {of}",
        "bounds": dict(table.bounds),
        "error_of_every_practice_seed": every_seed["error"],
    }


_CRITERION = (
    f"flat: the last {100 * tune.LAST_PART:g} % of the last search that begins at the best gains of all "
    f"lower the cost by at most {100 * tune.LARGEST_IMPROVEMENT:g} %; the seeds agree: most of them come "
    f"within {100 * tune.LARGEST_SPREAD:g} % of the lowest"
)


def write(tuning: Tuning, fixed: Mapping[str, Any], provenance: Mapping[str, Any], path: Path) -> None:
    """Writes the gains of the best seed, and where the searches of all seeds ended.

    fixed: parameters that the tuning did not change, which belong to the law -> value
    provenance: plain data about the controller, the protocol and the cost
    """
    best = tuning.best
    unchanged = {
        f"controller.{name}": {"value": value, "source": "fixed: part of the law, not tuned"}
        for name, value in fixed.items()
    }
    document = {
        "tuning": {
            **provenance,
            "cost": best.cost,
            "is_flat": tuning.is_flat,
            "seeds_agree": tuning.seeds_agree,
            "criterion": _CRITERION,
            "flattening": list(tuning.flattening),
            "improvement_in_the_last_part": tuning.improvement,
            "median_seed_above_the_lowest": tuning.spread,
            "optimiser": tune.optimiser(),
            "evaluations": tuning.evaluations,
            "metrics": dict(best.metrics),
            "seeds": [_seed(search) for search in tuning.searches],
            "refinements": [_seed(search) for search in tuning.refinements],
        },
        "parameters": {**unchanged, **_tuned_gains(tuning, str(provenance.get("protocol")))},
    }
    write_text_atomically(path, tomli_w.dumps(document))


def _tuned_gains(tuning: Tuning, protocol: str) -> dict[str, Any]:
    """Returns a table for each gain that was free."""
    best = tuning.best
    source = (
        f"tuned: cost {best.cost:.4g} cm of protocol {protocol}, {len(best.curve)} evaluations of each of "
        f"{len(tuning.searches)} seeds and {len(tuning.refinements)} times from the best; not published"
    )
    return {
        f"controller.{gain.name}": {
            "value": best.gains[gain.name],
            "unit": gain.unit,
            "limits": [gain.low, gain.high],
            "at_a_limit": gain.is_at_a_limit(best.gains[gain.name]),
            "source": source,
        }
        for gain in tuning.problem.gains
    }


def _seed(search: SearchResult) -> dict[str, Any]:
    """Returns what a search ended at."""
    return {
        "seed": search.seed,
        "cost": search.cost,
        "evaluations": len(search.curve),
        "gains": dict(search.gains),
    }
