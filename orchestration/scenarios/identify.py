"""Fitting the gains that the paper does not publish to the nominal row of its Table 1.

Least squares on settling time and RMSE of plain and extended L1, each residual in units of the
tolerance that the target allows, with overshoot above 1 % as a penalty. The gains are searched in
their logarithms, between limits, from the best of a few points drawn with the seed. Everything runs
through the FMUs and the master; the buoyancy row is never looked at.
"""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tomli_w

from fmus.files import write_text_atomically
from orchestration.errors import OrchestrationError
from orchestration.many.job import Failure
from orchestration.many.run_many import run_many
from orchestration.results import metrics
from orchestration.results.metric_units import metric_units, with_units
from orchestration.scenarios import scenario
from orchestration.scenarios.published import PUBLISHED, Published
from orchestration.system.prepared_run import prepare

SCENARIOS = ("nominal-l1", "nominal-extended")

# How far a fit may end from each figure of the nominal row: plain L1, extended L1
TOLERANCES = {"settling_time": (3.0, 3.0), "rmse": (0.6, 0.25)}
TARGETS = tuple(figure for figure in PUBLISHED if figure.where == "Table 1")
AT_A_LIMIT = 1.05  # a gain this near to a limit of its search was stopped by it
LARGEST_OVERSHOOT_PCT = 1.0  # "no significant overshoot", section 5.2
OVERSHOOT_TOLERANCE_PCT = 0.25
_NOT_SETTLED = 40.0  # tolerances: more than a run that settles can be away


@dataclass(frozen=True)
class Gain:
    """An unpublished gain, the limits of its search and why they are where they are."""

    name: str
    unit: str
    low: float
    high: float
    reason: str


GAINS = (
    Gain("controller.depth_feedback_gain", "N/m", 1.0, 10.0, "restoring force of 0.1 N to 1 N at 0.1 m"),
    Gain("controller.rate_feedback_gain", "N.s/m", 10.0, 25.0, "2 to 5 rad/s, below the observer's 8 rad/s"),
    Gain("controller.filter_bandwidth", "rad/s", 0.05, 1.0, "below the velocity loop"),
    Gain("controller.proportional_gain", "N/m", 2.0, 20.0, "of the order of the depth feedback"),
    Gain("controller.integral_gain", "N/(m.s)", 0.003, 0.03, "small: sigma_hat integrates already"),
)


@dataclass(frozen=True)
class Fit:
    """Fit of a search: gains, the metrics they give, and how often the loop was run."""

    gains: dict[str, float]
    metrics: dict[str, dict[str, float]]
    metric_units: dict[str, str]
    cost: float
    evaluations: int
    seed: int


def tolerance(target: Published) -> float:
    """Returns the deviation from a published figure that counts as 1."""
    return TOLERANCES[target.metric][SCENARIOS.index(target.scenario)]


def residuals(measured: Mapping[str, Mapping[str, float]]) -> np.ndarray:
    """Returns the deviation of each target over its tolerance, then the excess overshoot of each scenario.

    A run that does not settle counts as far from its target.
    """
    fit = [(measured[t.scenario][t.metric] - t.value) / tolerance(t) for t in TARGETS]
    excess = [
        max(0.0, measured[name]["overshoot"] - LARGEST_OVERSHOOT_PCT) / OVERSHOOT_TOLERANCE_PCT
        for name in SCENARIOS
    ]
    return np.nan_to_num(np.array(fit + excess), nan=_NOT_SETTLED)


def measure(gains: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Returns the metrics of each shipped scenario with these gains laid over it.

    Raises OrchestrationError for a run that fails.
    """
    loaded = [scenario.load(scenario.find(name), {"parameters": dict(gains)}) for name in SCENARIOS]
    runs = run_many(loaded[0].system, [one.experiment for one in loaded])
    measured = {}
    for one, run in zip(loaded, runs, strict=True):
        if isinstance(run, Failure):
            raise OrchestrationError(f"{one.name}: {run.reason}")
        measured[one.name] = metrics.evaluate(run, one.metrics)
    return measured


def _units() -> dict[str, str]:
    """Returns the unit of each metric; both scenarios have the same metrics."""
    loaded = scenario.load(scenario.find(SCENARIOS[0]))
    ports = prepare(loaded.system, loaded.experiment).system.ports
    return metric_units(loaded.metrics, {name: port.variable.unit or "" for name, port in ports.items()})


def identify(
    seed: int = 1,
    evaluations: int = 80,
    starts: int = 10,
    progress: Callable[[float], None] = lambda cost: None,
) -> Fit:
    """Searches the gains; the same seed gives the same fit.

    evaluations: how often the pair of scenarios may be run in all
    starts: how many of them go to points drawn over the whole range
    progress: called with the lowest cost (half the sum of squares) after every evaluation
    """
    from scipy.optimize import least_squares  # of this command alone, and slow to import
    from scipy.stats import qmc

    if not 1 <= starts < evaluations:
        raise OrchestrationError(f"evaluations {evaluations}: expected more than the {starts} starts")
    search = _Objective(seed, evaluations, progress)
    drawn = _SCALED_LOW + qmc.LatinHypercube(len(GAINS), rng=seed).random(starts)
    begin = min(drawn, key=lambda point: float(np.sum(search(point) ** 2)))
    with suppress(_OutOfEvaluations):
        least_squares(search, begin, bounds=(_SCALED_LOW, _SCALED_HIGH), diff_step=_STEP, ftol=1e-3)
    return search.best


# A gain is searched as the position of its logarithm between its limits, scaled to 1..2: SciPy's finite
# differences take a step relative to the value, which must therefore stay away from 0.
_SCALED_LOW, _SCALED_HIGH = 1.0, 2.0
_STEP = 0.01  # 1 to 2 % of the range of each gain


def _unscaled(gain: Gain, scaled: float) -> float:
    value = gain.low * (gain.high / gain.low) ** (scaled - _SCALED_LOW)
    return float(f"{value:.4g}")  # what is written is what was run


class _OutOfEvaluations(Exception):  # noqa: N818  (a signal to stop, not an error)
    pass


class _Objective:
    """The objective, remembering the best point that it was asked for."""

    def __init__(self, seed: int, evaluations: int, progress: Callable[[float], None]) -> None:
        self._evaluations, self._progress = evaluations, progress
        self.best = Fit({}, {}, _units(), cost=math.inf, evaluations=0, seed=seed)

    def __call__(self, scaled_gains: np.ndarray) -> np.ndarray:
        if self.best.evaluations >= self._evaluations:
            raise _OutOfEvaluations
        gains = {g.name: _unscaled(g, float(x)) for g, x in zip(GAINS, scaled_gains, strict=True)}
        measured = measure(gains)
        deviations = residuals(measured)
        cost = 0.5 * float(deviations @ deviations)
        if cost < self.best.cost:
            self.best = replace(self.best, gains=gains, metrics=measured, cost=cost)
        self.best = replace(self.best, evaluations=self.best.evaluations + 1)
        self._progress(self.best.cost)
        return deviations


def write(fit: Fit, path: Path) -> None:
    """Writes the parameter file that the scenarios use, provenance and limits beside each value."""
    source = (
        "identified: least squares on the nominal row of Table 1 of Maalouf et al. (2013), "
        f"seed {fit.seed}, {fit.evaluations} evaluations; not a published value"
    )
    parameters = {
        gain.name: {
            "value": fit.gains[gain.name],
            "unit": gain.unit,
            "limits": [gain.low, gain.high],
            "at_a_limit": min(fit.gains[gain.name] / gain.low, gain.high / fit.gains[gain.name]) < AT_A_LIMIT,
            "why_these_limits": gain.reason,
            "source": source,
        }
        for gain in GAINS
    }
    document = {
        "identification": {
            "seed": fit.seed,
            "evaluations": fit.evaluations,
            "cost": fit.cost,
            "metrics": {
                name: with_units(values, fit.metric_units, math.nan) for name, values in fit.metrics.items()
            },
        },
        "parameters": parameters,
    }
    write_text_atomically(path, tomli_w.dumps(document))
