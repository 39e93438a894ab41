"""Mechanisms that may explain the row with added buoyancy, each weighed by how well and how finely it fits.

    python docs/explanation/identification/mechanisms.py identification.json

Each mechanism leaves some numbers of the law free and shares all others. Least squares from several starts
meets the eight figures; a standard deviation is 1 % of an RMSE and 0.5 s of a settling time. The evidence is
that of Laplace: the likelihood of the best fit, times the share of the ranges that fits as well, from the
derivatives there. It takes one summit as linear: only differences of several units of its logarithm count.
The sensor has neither noise nor resolution here. Fits in the file are kept.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from fits import NOT_SETTLED, OVERSHOOT_TOLERANCE_PCT
from scipy.optimize import least_squares
from scipy.stats import qmc
from vehicle import (
    BY_NAME,
    CHANGE,
    FREQUENCY,
    LARGEST_OVERSHOOT_PCT,
    SCENARIOS,
    VALUES,
    Columns,
    Free,
    Vehicle,
)

SHIPPED_BOUNDS = {"controller.sigma_bound": 10.0, "controller.theta_bound[1]": 5.0}
_START = {kind: f"{kind}: u_a at the start" for kind in ("nominal", "buoyancy")}
_SHARED = tuple(
    replace(free, high=35.0) if free.name == "controller.rate_feedback_gain" else free
    for name, free in BY_NAME.items()
    if name not in (FREQUENCY, *SHIPPED_BOUNDS)
)
_FAST, _SLOW = (replace(BY_NAME[FREQUENCY], low=low, high=high) for low, high in ((2.0, 6.0), (0.1, 2.0)))
# from a quarter of the buoyancy, as both add up, to the force of both thrusters
_BOUNDS = tuple(replace(BY_NAME[name], low=0.3, high=6.0) for name in SHIPPED_BOUNDS)
# from nothing to all of the buoyancy
_STARTS = tuple(Free(name, "N", 0.0, 1.2, logarithmic=False) for name in _START.values())
MECHANISMS: Mapping[str, tuple[Free, ...]] = {
    "fast, nothing else": (*_SHARED, _FAST),
    "fast, bounds near the buoyancy": (*_SHARED, _FAST, *_BOUNDS),
    "fast, start partly learnt": (*_SHARED, _FAST, *_STARTS),
    "slow, nothing else": (*_SHARED, _SLOW),
    "slow, bounds near the buoyancy": (*_SHARED, _SLOW, *_BOUNDS),
}
# of the reader who found that small bounds explain the row; other starts are drawn
KNOWN = {
    "controller.depth_feedback_gain": 2.9589,
    "controller.rate_feedback_gain": 31.3885,
    "controller.filter_bandwidth": 0.2401,
    "controller.proportional_gain": 6.1757,
    "controller.integral_gain": 0.0009,
    "controller.sigma_bound": 1.1638,
    "controller.theta_bound[1]": 0.3443,
    "plant.inertia": 5.5,
    "plant.linear_damping": 2.5,
    "plant.quadratic_damping": 7.0,
    "plant.net_weight": -1.2,
    CHANGE: 0.2,
    **dict(zip(_START.values(), (0.55, 0.05), strict=True)),
}
WINDOWS = {"first 10 s": (0.0, 10.0), "hold at 0.4 m": (230.0, 250.0)}
DRAWN, STARTS, STEPS = 128, 3, 25


def given(free: tuple[Free, ...], shares: np.ndarray) -> tuple[list[str], Columns]:
    """Returns scenarios and values of four runs for each row of shares of the ranges, (rows, numbers)."""
    rows = np.repeat(np.atleast_2d(shares), len(SCENARIOS), axis=0)
    names = [*SCENARIOS] * (len(rows) // len(SCENARIOS))
    values: Columns = {name: np.full(len(rows), bound) for name, bound in SHIPPED_BOUNDS.items()}
    values |= {number.name: number.value(share) for number, share in zip(free, rows.T, strict=True)}
    starts = {kind: values.pop(name, np.zeros(len(rows))) for kind, name in _START.items()}
    is_nominal = [name.startswith("nominal") for name in names]
    return names, values | {"controller.initial_u_a": np.where(is_nominal, *starts.values())}


def residuals(vehicle: Vehicle, free: tuple[Free, ...], shares: np.ndarray) -> np.ndarray:
    """Returns what the likelihood squares, shape (rows, 12): deviations of the figures, excess overshoots."""
    measured = vehicle.figures(*given(free, shares))
    columns = {metric: column.reshape(-1, len(SCENARIOS)) for metric, column in measured.items()}
    settled = [columns["settling_time"][:, i] for i in range(len(SCENARIOS))]
    rmse = [columns["rmse"][:, i] for i in range(len(SCENARIOS))]
    excess = np.maximum(0.0, columns["overshoot"] - LARGEST_OVERSHOOT_PCT) / OVERSHOOT_TOLERANCE_PCT
    deviations = [
        *((settled[i] - VALUES[name, "settling_time"]) / 0.5 for i, name in enumerate(SCENARIOS)),
        *((rmse[i] / VALUES[name, "rmse"] - 1.0) / 0.01 for i, name in enumerate(SCENARIOS)),
        *excess.T,
    ]
    return np.clip(np.nan_to_num(np.array(deviations).T, nan=NOT_SETTLED), -NOT_SETTLED, NOT_SETTLED)


def jacobian(vehicle: Vehicle, free: tuple[Free, ...], shares: np.ndarray, step: float) -> np.ndarray:
    """Returns derivatives of the residuals by the shares, from central differences within the ranges."""
    ahead, behind = (np.clip(shares + sign * step * np.eye(len(free)), 0.0, 1.0) for sign in (1.0, -1.0))
    after, before = np.split(residuals(vehicle, free, np.concatenate([ahead, behind])), 2)
    return (after - before).T / np.diag(ahead - behind)


def fitted(vehicle: Vehicle, free: tuple[Free, ...], start: np.ndarray) -> tuple[float, np.ndarray]:
    """Returns half the sum of squares and the shares at which least squares from a start end."""
    # figures change in steps of a communication point: long differences and short ones take turns
    for step in (0.03, 0.01):
        slopes: Any = partial(jacobian, vehicle, free, step=step)
        start = least_squares(
            lambda shares: residuals(vehicle, free, shares)[0],
            np.clip(start, 1e-3, 1.0 - 1e-3),
            slopes,
            bounds=(0.0, 1.0),
            max_nfev=STEPS,
            ftol=1e-3,
        ).x
    return 0.5 * float(np.sum(residuals(vehicle, free, start) ** 2)), start


def log_share(derivatives: np.ndarray) -> float:
    """Returns the logarithm of the share of the ranges that fits as well as the best (Laplace).

    A direction on which the figures do not depend is as wide as its range.
    """
    curvatures = np.linalg.eigvalsh(derivatives.T @ derivatives)
    return float(np.sum(np.minimum(0.0, 0.5 * np.log(2.0 * np.pi / np.maximum(curvatures, 1e-12)))))


def weigh(vehicle: Vehicle, free: tuple[Free, ...], seed: int = 1) -> dict[str, Any]:
    """Returns the best fit of a mechanism, its evidence, and what another measurement would show."""
    drawn = qmc.LatinHypercube(len(free), rng=seed).random(DRAWN)
    order = np.argsort(np.sum(residuals(vehicle, free, drawn) ** 2, axis=1))
    middle = {FREQUENCY: free[[number.name for number in free].index(FREQUENCY)].value(0.6)}
    known = np.array([number.position((KNOWN | middle)[number.name]) for number in free])
    ends = [fitted(vehicle, free, start) for start in (known, *drawn[order[:STARTS]])]
    cost, best = min(ends, key=lambda end: end[0])
    share = log_share(jacobian(vehicle, free, best, 0.01))
    names, values = given(free, best)
    before = vehicle.figures(names, values)
    half = vehicle.figures(names, values | {CHANGE: 0.5 * values[CHANGE]})
    return {
        "costs": [float(f"{end[0]:.4g}") for end in ends],
        "log_share": float(f"{share:.4g}"),
        "log_evidence": float(f"{share - cost:.4g}"),
        "values": {n.name: float(f"{n.value(x):.4g}") for n, x in zip(free, best, strict=True)},
        "figures": {name: by_scenario(column) for name, column in before.items()},
        "with half of the added buoyancy": {
            name: by_scenario(half[name]) for name in ("settling_time", "rmse")
        },
    }


def by_scenario(column: np.ndarray) -> dict[str, float]:
    """Returns the value of each scenario."""
    return {name: float(f"{value:.4g}") for name, value in zip(SCENARIOS, column, strict=True)}


def main(path: Path) -> None:
    """Weighs each mechanism that the file of results does not have yet, in a minute of one core."""
    document = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
    done = document.setdefault("mechanisms", {})
    with Vehicle(noise=False, windows=WINDOWS) as vehicle:
        for name in (name for name in MECHANISMS if name not in done):
            done[name] = weigh(vehicle, MECHANISMS[name])
            path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
