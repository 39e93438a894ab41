"""Fitting the gains that the paper does not publish to the nominal row of its Table 1.

Least squares on settling time and RMSE of plain and extended L1, each residual in units of the
tolerance that the target allows, with overshoot above 1 % as a penalty. The gains are searched in
their logarithms, between limits, from the best of a few points drawn with the seed. Everything runs
through the FMUs and the master; the buoyancy row is never looked at.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tomli_w

from fmus.files import write_text_atomically
from orchestration.errors import OrchestrationError
from orchestration.fit.least_squares import LeastSquares, values_at
from orchestration.many.job import Failure
from orchestration.many.run_many import run_many
from orchestration.results import metrics
from orchestration.results.metric_units import metric_units, with_units
from orchestration.scenarios import scenario
from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.scenarios.published import PUBLISHED, Published
from orchestration.system.prepared_run import prepare

SCENARIOS = ("nominal-l1", "nominal-extended")

# How far a fit may end from each figure of the nominal row: plain L1, extended L1
TOLERANCES = {"settling_time": (3.0, 3.0), "rmse": (0.6, 0.25)}
TARGETS = tuple(figure for figure in PUBLISHED if figure.where == "Table 1")
LARGEST_OVERSHOOT_PCT = 1.0  # "no significant overshoot", section 5.2
OVERSHOOT_TOLERANCE_PCT = 0.25
_NOT_SETTLED = 40.0  # tolerances: more than a run that settles can be away


GAINS = (
    FreeParameter("controller.depth_feedback_gain", 1.0, 10.0, unit="N/m"),
    FreeParameter("controller.rate_feedback_gain", 10.0, 25.0, unit="N.s/m"),
    FreeParameter("controller.filter_bandwidth", 0.05, 1.0, unit="rad/s"),
    FreeParameter("controller.proportional_gain", 2.0, 20.0, unit="N/m"),
    FreeParameter("controller.integral_gain", 0.003, 0.03, unit="N/(m.s)"),
)
WHY_THESE_LIMITS = {
    "controller.depth_feedback_gain": "restoring force of 0.1 N to 1 N at 0.1 m",
    "controller.rate_feedback_gain": "2 to 5 rad/s, below the observer's 8 rad/s",
    "controller.filter_bandwidth": "below the velocity loop",
    "controller.proportional_gain": "of the order of the depth feedback",
    "controller.integral_gain": "small: sigma_hat integrates already",
}
_DIFFERENCE = 0.01  # of the coordinates: 1 to 2 % of the range of each gain


@dataclass(frozen=True)
class IdentifiedGains:
    """Identified gains, the metrics that they give, and how often the loop was run."""

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


def measure(points: Sequence[Mapping[str, float]]) -> list[dict[str, dict[str, float]]]:
    """Returns for each set of gains the metrics of each shipped scenario with these gains laid over it.

    Raises OrchestrationError for a run that fails.
    """
    measured = [dict[str, dict[str, float]]() for _ in points]
    loaded = [
        (one, scenario.load(scenario.find(name), {"parameters": dict(gains)}))
        for name in SCENARIOS
        for one, gains in zip(measured, points, strict=True)
    ]
    runs = run_many(loaded[0][1].system, [chosen.experiment for _, chosen in loaded])
    for (one, chosen), run in zip(loaded, runs, strict=True):
        if isinstance(run, Failure):
            raise OrchestrationError(f"{chosen.name}: {run.reason}")
        one[chosen.name] = metrics.evaluate(run, chosen.metrics)
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
) -> IdentifiedGains:
    """Searches the gains; the same seed gives the same fit.

    evaluations: how often the pair of scenarios may be run in all
    starts: how many of them go to points drawn over the whole range
    progress: called with the lowest cost (half the sum of squares) after every evaluation
    """
    from scipy.stats import qmc  # slow to import

    if not 1 <= starts < evaluations:
        raise OrchestrationError(f"evaluations {evaluations}: expected more than the {starts} starts")
    units = _units()
    search = LeastSquares(
        GAINS,
        lambda points: map(residuals, measure([*map(rounded, points)])),
        _DIFFERENCE,
        evaluations,
        progress,
    )
    search.at([*(1.0 + qmc.LatinHypercube(len(GAINS), rng=seed).random(starts))])
    search.run(search.best, ftol=1e-3)
    gains = rounded(values_at(GAINS, search.best))
    return IdentifiedGains(gains, measure([gains])[0], units, search.cost, search.count, seed)


def rounded(gains: Mapping[str, float]) -> dict[str, float]:
    """Returns the gains with four digits: what is written is what was run."""
    return {name: float(f"{value:.4g}") for name, value in gains.items()}


def write(fit: IdentifiedGains, path: Path) -> None:
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
            "at_a_limit": gain.is_at_a_limit(fit.gains[gain.name]),
            "why_these_limits": WHY_THESE_LIMITS[gain.name],
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
