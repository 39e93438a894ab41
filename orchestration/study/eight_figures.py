"""Fits of the gains to the eight figures of Tables 1 and 2, or to seven of them, through the FMUs.

Every figure is the mean over several seeds of the sensor's noise. A set of gains whose depth does not rest in
the hold, or whose four runs overshoot, is penalised: a fit to one realisation of the noise can meet all eight
figures by a limit cycle.
"""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from orchestration.master import Simulator
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.scenarios.identify import LARGEST_OVERSHOOT_PCT, OVERSHOOT_TOLERANCE_PCT
from orchestration.study.depth_loop_model import depth_task, figures
from orchestration.study.posterior import K_I, K_P, VALUES, Free, with_adaptation_gain

SEEDS = (1, 2, 3, 4, 5)
LARGEST_SPREAD_MM = 3.0
SPREAD_TOLERANCE_MM = 0.5
HOLD = (100.0, 140.0)  # s, at 0.8 m
TOLERANCES = {"settling_time": {"l1": 3.0, "extended": 3.0}, "rmse": {"l1": 0.6, "extended": 0.25}}
_EXTENSION = (K_P, K_I)
_NOT_SETTLED = 40.0  # tolerances: more than a run that settles can be away

Figure = tuple[str, str]
"""(scenario, metric)"""
SCENARIOS = tuple(dict.fromkeys(name for name, _ in VALUES))


class Runs(Protocol):
    """What gives the figures of all four scenarios, one value for each seed."""

    def figures(self, values: Mapping[str, float], seeds: Sequence[int]) -> dict[Figure, np.ndarray]: ...


class VehicleRuns:
    """The four scenarios of the tables on FMUs that stay loaded; a context manager."""

    def __init__(self) -> None:
        loaded = {name: scenario.load(scenario.find(name)) for name in SCENARIOS}
        declared = loaded[SCENARIOS[0]].metrics
        self._metrics = {name: declared[name] for name in ("settling_time", "rmse", "overshoot")}
        self._experiments = {
            name: replace(each.experiment, record=("plant.depth", "controller.depth_reference"))
            for name, each in loaded.items()
        }
        self._simulator = Simulator(loaded[SCENARIOS[0]].system)

    def __enter__(self) -> "VehicleRuns":
        return self

    def __exit__(self, *error: object) -> None:
        self._simulator.close()

    def one(self, name: str, values: Mapping[str, float], seed: int = 1) -> dict[str, float]:
        """Settling time, RMSE, overshoot and spread of depth in hold [mm] of one run.

        values: of parameters, and of the buoyancy change, which counts in the scenarios of that name
        """
        before, values = self._experiments[name], dict(values)
        change = values.pop("plant.buoyancy_change", 0.2)
        inputs = dict(before.inputs)
        if name.startswith("buoyancy"):
            inputs["plant.buoyancy_change"] = float(change)
        parameters = {**before.parameters, **values, "plant.sensor_seed": seed}
        recording = self._simulator.run(replace(before, inputs=inputs, parameters=parameters))
        return metrics.evaluate(recording, self._metrics) | {"hold_spread": hold_spread(recording)}

    def figures(self, values: Mapping[str, float], seeds: Sequence[int] = SEEDS) -> dict[Figure, np.ndarray]:
        """The same of all four scenarios, one value for each seed."""
        return {
            (name, metric): np.array([run[metric] for run in runs])
            for name in SCENARIOS
            for runs in [[self.one(name, values, seed) for seed in seeds]]
            for metric in runs[0]
        }


class ModelRuns:
    """The same of the continuous model, which needs no seeds and rests in the hold: for a first approach."""

    def figures(self, values: Mapping[str, float], seeds: Sequence[int] = SEEDS) -> dict[Figure, np.ndarray]:
        plain = dict.fromkeys(_EXTENSION, 0.0)
        changes = {name: 0.2 if name.startswith("buoyancy") else 0.0 for name in SCENARIOS}
        runs = [
            {**values, "plant.buoyancy_change": changes[name], **(plain if name.endswith("-l1") else {})}
            for name in SCENARIOS
        ]
        measured = figures(depth_task(), {key: np.array([run[key] for run in runs]) for key in runs[0]})
        measured["hold_spread"] = np.zeros(len(SCENARIOS))
        return {
            (name, metric): column[i : i + 1]
            for i, name in enumerate(SCENARIOS)
            for metric, column in measured.items()
        }


def hold_spread(recording: Recording) -> float:
    """Standard deviation of the depth in the hold at 0.8 m [mm]."""
    held = (recording.time >= HOLD[0]) & (recording.time <= HOLD[1])
    return 1e3 * float(np.std(recording["plant.depth"][held]))


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

    begin = np.clip([1.0 + each.position(start[each.name]) for each in free], 1.001, 1.999)
    with suppress(_OutOfEvaluationsError):
        least_squares(search, begin, bounds=(1.0, 2.0), diff_step=0.01, ftol=1e-4)
    return search.best
