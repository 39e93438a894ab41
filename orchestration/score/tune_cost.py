"""The cost of gains: mean RMSE over the cases of the cost, each with another seed of noise, with bounds.

What is beyond its bound costs `_SLOPE` for each time that the bound fits into the excess. That is steeper
than the RMSE falls with total variation, so that the least cost is at a bound or within it. The bound on the
delay margin is one more run, in which the measured depth is late by that much: it is to be quiet in hold.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from orchestration.errors import SimulationError
from orchestration.margins.hold import QUIET, last_part
from orchestration.score.loop import Loop
from orchestration.score.protocol import Case, Protocol
from orchestration.score.protocol_format import DELAY_MARGIN

LARGEST = 1000.0  # cost of a run that ends early; finite, so that the search goes on
_SLOPE = 10.0

Figures = Mapping[str, float]
Gains = Mapping[str, float]


def cost_of(loop: Loop, gains: Gains, every_seed: bool = False) -> dict[str, Any]:
    """The cost of gains over those of the controller, with the mean figures of each case.

    every_seed: each case with every practice seed, not with one
    """
    names, cases = figure_names(loop.protocol), practice_cases(loop.protocol, every_seed)
    return cost_of_runs(loop, gains, ((case.name, loop.figures(case, gains, names)) for case in cases))


def cost_of_runs(loop: Loop, gains: Gains, measured: Iterable[tuple[str, Figures]]) -> dict[str, Any]:
    """The same of the figures of the runs, each with the name of its case."""
    table = loop.protocol.tables.cost
    figures: dict[str, list[Figures]] = {}
    try:
        for case, of_run in measured:
            figures.setdefault(case, []).append(of_run)
        unrest = _unrest(loop, gains, table.bounds[DELAY_MARGIN]) if DELAY_MARGIN in table.bounds else 0.0
    except SimulationError as error:
        return {"cost": LARGEST, "failure": str(error)}
    bounds = _figure_bounds(loop.protocol)
    runs = [run_cost(run, table.figure, bounds) for case in figures.values() for run in case]
    return {
        "cost": min(sum(runs) / len(runs) + _SLOPE * max(0.0, unrest / QUIET - 1.0), LARGEST),
        "figures": {case: _mean(measured) for case, measured in figures.items()},
        "unrest": unrest,
    }


def figure_names(protocol: Protocol) -> set[str]:
    """The figures of a run that the cost depends on."""
    return {protocol.tables.cost.figure, *_figure_bounds(protocol)}


def _figure_bounds(protocol: Protocol) -> dict[str, float]:
    bounds = protocol.tables.cost.bounds
    return {name: bound for name, bound in bounds.items() if name != DELAY_MARGIN}


def practice_cases(protocol: Protocol, every_seed: bool = False) -> list[Case]:
    """The cases of the cost, each with another practice seed in turn, or with every one."""
    cases = [protocol.cases[name] for name in protocol.tables.cost.cases]
    seeds = protocol.tables.practice_seeds
    if every_seed:
        return [case.with_seed(seed) for case in cases for seed in seeds]
    return [case.with_seed(seeds[i % len(seeds)]) for i, case in enumerate(cases)]


def run_cost(figures: Figures, objective: str, bounds: Mapping[str, float]) -> float:
    """The cost of one run: its objective, and what its figures are beyond their bounds.

    A bound on a figure that is not a number does not apply: there is no overshoot where nothing moves.
    """
    excess = (figures[name] / bound - 1.0 for name, bound in bounds.items())
    cost = figures[objective] + _SLOPE * sum(x for x in excess if x > 0.0)
    return min(cost, LARGEST) if math.isfinite(cost) else LARGEST


def delayed(case: Case, delay: float, variable: str) -> Case:
    """The case until its target is left, with an input that is late by so many seconds."""
    fault = {"input": variable, "kind": "delay", "delay": delay}
    faults = [*case.layer.get("faults", []), fault]
    experiment = {**case.layer.get("experiment", {}), "stop_time": case.target.window[1]}
    return replace(case, layer={**case.layer, "faults": faults, "experiment": experiment})


def _unrest(loop: Loop, gains: Gains, delay: float) -> float:
    """Standard deviation [m] of the depth at the end of the nominal hold, the measurement being late."""
    nominal = next(iter(loop.protocol.cases.values()))
    signals = loop.run(delayed(nominal, delay, loop.controller.variable("measured_depth")), gains)
    if "terminated" in signals.provenance:
        return math.inf
    hold = last_part("depth", nominal.target.window[1])
    return float(np.std(signals[hold.signal][signals.time >= hold.start]))


def _mean(runs: Sequence[Figures]) -> dict[str, float]:
    """The mean of each figure that is a number in every run."""
    means = {name: float(np.mean([run[name] for run in runs])) for name in runs[0]}
    return {name: mean for name, mean in means.items() if math.isfinite(mean)}
