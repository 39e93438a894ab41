"""The gains that ship: fitted to the nominal row, Table 1 of Maalouf et al. (2013), which publishes none.

    l1-depth build --cache
    python docs/explanation/identification/identify.py --out identified.toml

Least squares on settling time and RMSE of plain and extended L1, each residual in units of its tolerance,
with overshoot above 1 % as a penalty. The gains are searched in their logarithms, between limits, from the
best of a few points drawn with the seed. The buoyancy row is never looked at.
"""

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from fits import NOT_SETTLED, OVERSHOOT_TOLERANCE_PCT, tolerance, values_at
from scipy.optimize import least_squares
from scipy.stats import qmc
from vehicle import LARGEST_OVERSHOOT_PCT, VALUES, Columns, Free, Vehicle

NOMINAL = ["nominal-l1", "nominal-extended"]
UNITS = {"settling_time": "s", "rmse": "cm", "overshoot": "%"}
WHY_THESE_LIMITS = {
    Free("controller.depth_feedback_gain", "N/m", 1.0, 10.0): "restoring force of 0.1 N to 1 N at 0.1 m",
    Free("controller.rate_feedback_gain", "N.s/m", 10.0, 25.0): "2 to 5 rad/s, below the observer's 8 rad/s",
    Free("controller.filter_bandwidth", "rad/s", 0.05, 1.0): "below the velocity loop",
    Free("controller.proportional_gain", "N/m", 2.0, 20.0): "of the order of the depth feedback",
    Free("controller.integral_gain", "N/(m.s)", 0.003, 0.03): "small: sigma_hat integrates already",
}
GAINS = tuple(WHY_THESE_LIMITS)


def residuals(measured: Columns) -> np.ndarray:
    """Returns the deviations of settling times and RMSE over their tolerances, then the excess overshoots.

    measured: metric -> value of plain and of extended L1; a run that does not settle is far from its target
    """
    figures = [(name, metric) for metric in ("settling_time", "rmse") for name in NOMINAL]
    values = np.concatenate([measured["settling_time"], measured["rmse"]])
    deviations = (values - [VALUES[figure] for figure in figures]) / [*map(tolerance, figures)]
    excess = np.maximum(0.0, measured["overshoot"] - LARGEST_OVERSHOOT_PCT) / OVERSHOOT_TOLERANCE_PCT
    return np.nan_to_num(np.concatenate([deviations, excess]), nan=NOT_SETTLED)


def identify(vehicle: Vehicle, seed: int, starts: int = 10, steps: int = 12) -> dict[str, Any]:
    """Returns the parameter file of a fit as plain data; the same seed gives the same fit.

    starts: points drawn over the whole range; steps: of the search from the best of them, at most
    """
    evaluated: list[tuple[float, list[float]]] = []

    def deviations(scaled: np.ndarray) -> np.ndarray:
        given = residuals(vehicle.figures(NOMINAL, values_at(GAINS, scaled)))
        evaluated.append((0.5 * float(given @ given), scaled.tolist()))
        return given

    for point in 1.0 + qmc.LatinHypercube(len(GAINS), rng=seed).random(starts):
        deviations(point)
    least_squares(deviations, min(evaluated)[1], bounds=(1.0, 2.0), diff_step=0.01, ftol=1e-3, max_nfev=steps)
    cost, best = min(evaluated)
    gains = values_at(GAINS, np.array(best))
    search = {"seed": seed, "evaluations": len(evaluated), "cost": cost}
    return document(search, gains, vehicle.figures(NOMINAL, gains))


def document(search: Mapping[str, Any], gains: Mapping[str, float], measured: Columns) -> dict[str, Any]:
    """Returns the parameter file that the scenarios use, provenance and limits beside each value."""
    source = (
        "identified: least squares on the nominal row of Table 1 of Maalouf et al. (2013), "
        f"seed {search['seed']}, {search['evaluations']} evaluations; not a published value"
    )
    metrics = {
        name: {metric: {"value": float(measured[metric][i]), "unit": unit} for metric, unit in UNITS.items()}
        for i, name in enumerate(NOMINAL)
    }
    parameters = {
        gain.name: {
            "value": gains[gain.name],
            "unit": gain.unit,
            "limits": [gain.low, gain.high],
            "at_a_limit": not 0.01 < gain.position(gains[gain.name]) < 0.99,
            "why_these_limits": why,
            "source": source,
        }
        for gain, why in WHY_THESE_LIMITS.items()
    }
    return {"identification": {**search, "metrics": metrics}, "parameters": parameters}


def main(arguments: Sequence[str] | None = None) -> None:
    """Writes the parameter file of a fit."""
    parser = argparse.ArgumentParser(description="Fit five gains to the nominal row of the paper.")
    parser.add_argument("--seed", type=int, default=1, help="of the points that the search begins with")
    parser.add_argument("--out", type=Path, required=True, help="parameter file to write")
    given = parser.parse_args(arguments)
    with Vehicle() as vehicle:
        fit = identify(vehicle, given.seed)
    given.out.write_text(tomli_w.dumps(fit), encoding="utf-8")
    print(given.out)


if __name__ == "__main__":
    main()
