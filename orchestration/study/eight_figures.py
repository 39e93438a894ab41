"""Fits of the gains to the eight figures of Tables 1 and 2, or to seven of them, through the FMUs.

Every figure is the mean over several seeds of the sensor's noise. A set of gains whose depth does not rest in
the hold, or whose four runs overshoot, is penalised: a fit to one realisation of the noise can meet all eight
figures by a limit cycle.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orchestration.scenarios.identify import LARGEST_OVERSHOOT_PCT, OVERSHOOT_TOLERANCE_PCT
from orchestration.study.open_numbers import VALUES, Free, with_adaptation_gain
from orchestration.study.vehicle_runs import SCENARIOS, SEEDS, Figure, Runs

LARGEST_SPREAD_MM = 3.0
SPREAD_TOLERANCE_MM = 0.5
TOLERANCES = {"settling_time": {"l1": 3.0, "extended": 3.0}, "rmse": {"l1": 0.6, "extended": 0.25}}
_NOT_SETTLED = 40.0  # tolerances: more than a run that settles can be away


def tolerance(figure: Figure) -> float:
    """The deviation from a published figure that counts as 1."""
    name, metric = figure
    return TOLERANCES[metric][name.partition("-")[2]]


def residuals(
    measured: Mapping[Figure, np.ndarray], left_out: Figure | None = None, bounded: bool = True
) -> np.ndarray:
    """Deviation of the mean of each figure over its tolerance, then what exceeds the bounds.

    left_out: a figure that is not looked at; bounded: whether overshoot and spread in hold are looked at
    """
    looked_at = [figure for figure in VALUES if figure != left_out]
    fit = [float(np.mean(measured[figure]) - VALUES[figure]) / tolerance(figure) for figure in looked_at]
    for name in SCENARIOS if bounded else ():
        excess = float(np.mean(measured[name, "overshoot"])) - LARGEST_OVERSHOOT_PCT
        fit.append(max(0.0, excess) / OVERSHOOT_TOLERANCE_PCT)
        spread = float(np.max(measured[name, "hold_spread"])) - LARGEST_SPREAD_MM
        fit.append(max(0.0, spread) / SPREAD_TOLERANCE_MM)
    return np.clip(np.nan_to_num(np.array(fit), nan=_NOT_SETTLED), -_NOT_SETTLED, _NOT_SETTLED)


@dataclass(frozen=True)
class Fit:
    """What a search ended at: values by name, the figures of each seed, half the sum of squares."""

    values: dict[str, float]
    measured: dict[Figure, np.ndarray]
    cost: float
    left_out: Figure | None = None


class _OutOfEvaluationsError(Exception):
    pass


class Search:
    """The objective in the logarithms of the free numbers, 1..2 between their limits, with the best point."""

    def __init__(
        self,
        runs: Runs,
        free: Sequence[Free],
        *,
        left_out: Figure | None = None,
        seeds: Sequence[int] = SEEDS,
        bounded: bool = True,
        evaluations: int = 100,
        progress: Callable[[float], None] = lambda cost: None,
    ) -> None:
        self._runs, self._free, self._seeds, self._bounded = runs, free, seeds, bounded
        self._left, self._progress = evaluations, progress
        self.best = Fit({}, {}, np.inf, left_out)

    def __call__(self, scaled: np.ndarray) -> np.ndarray:
        if self._left <= 0:
            raise _OutOfEvaluationsError
        self._left -= 1
        values = {free.name: rounded(free, x) for free, x in zip(self._free, scaled, strict=True)}
        measured = self._runs.figures(variables(values), self._seeds)
        deviations = residuals(measured, self.best.left_out, self._bounded)
        cost = 0.5 * float(deviations @ deviations)
        if cost < self.best.cost:
            self.best = replace(self.best, values=values, measured=measured, cost=cost)
        self._progress(self.best.cost)
        return deviations


def rounded(free: Free, scaled: float) -> float:
    """The value at a position 1..2 of the range; what is written is what was run."""
    return float(f"{free.value(scaled - 1.0):.4g}")


def variables(values: Mapping[str, float]) -> dict[str, Any]:
    """What the FMUs are given for these values."""
    return {name: float(value) for name, value in with_adaptation_gain(values).items()}


def fit(search: Search, free: Sequence[Free], start: Mapping[str, float]) -> Fit:
    """Least squares from a start until nothing improves or the evaluations are spent."""
    from scipy.optimize import least_squares

    begin = np.clip([1.0 + number.position(start[number.name]) for number in free], 1.001, 1.999)
    with suppress(_OutOfEvaluationsError):
        least_squares(search, begin, bounds=(1.0, 2.0), diff_step=0.01, ftol=1e-4)
    return search.best
