"""Fits of the gains to the eight figures, to seven of them and to one seed, and what else could explain them.

Every figure is the mean over several seeds of the sensor's noise. A set of gains whose depth does not rest in
the hold, or whose runs overshoot, is penalised: a fit to one seed can meet all eight figures by a limit
cycle.
"""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from typing import Any

import numpy as np
from scipy.optimize import brentq, differential_evolution, least_squares
from vehicle import (
    BY_NAME,
    CHANGE,
    FREE,
    FREQUENCY,
    LARGEST_OVERSHOOT_PCT,
    SCENARIOS,
    SEEDS,
    VALUES,
    Columns,
    Figure,
    Free,
    Vehicle,
)

LARGEST_SPREAD_MM, SPREAD_TOLERANCE_MM, OVERSHOOT_TOLERANCE_PCT = 3.0, 0.5, 0.25
NOT_SETTLED = 40.0  # tolerances: more than a run that settles can be away

_IDENTIFIED = tomllib.loads(
    (files("orchestration.scenarios") / "parameters" / "identified.toml").read_text(encoding="utf-8")
)["parameters"]
SHIPPED_RANGES = (
    *(BY_NAME[f"plant.{kind}_damping"] for kind in ("linear", "quadratic")),
    *(Free(name, entry["unit"], *entry["limits"]) for name, entry in _IDENTIFIED.items()),
)
SHIPPED_START = {"plant.linear_damping": 2.5, "plant.quadratic_damping": 7.0} | {
    name: entry["value"] for name, entry in _IDENTIFIED.items()
}
WIDE = tuple(free for free in FREE if free.name not in ("plant.net_weight", CHANGE))
# the vehicle as shipped; a fast adaptation; bounds from a quarter of the buoyancy to the thrusters' force
SMALL_BOUNDS = (
    *(replace(BY_NAME[name], high=35.0) if "rate" in name else BY_NAME[name] for name in _IDENTIFIED),
    replace(BY_NAME[FREQUENCY], low=2.0),
    *(replace(BY_NAME[f"controller.{bound}"], high=6.0) for bound in ("sigma_bound", "theta_bound[1]")),
)
# found by a reader
SMALL_BOUNDS_START = {
    "controller.depth_feedback_gain": 2.9589,
    "controller.rate_feedback_gain": 31.3885,
    "controller.filter_bandwidth": 0.2401,
    "controller.proportional_gain": 6.1757,
    "controller.integral_gain": 0.0009,
    FREQUENCY: 3.6,
    "controller.sigma_bound": 1.1638,
    "controller.theta_bound[1]": 0.3443,
}
_RATE_FEEDBACK = "controller.rate_feedback_gain"
# With a rate feedback that the observer is too slow for: 8 to 11 rad/s, against its 8 rad/s.
FAST_RATE_FEEDBACK = tuple(
    replace(free, low=40.0, high=60.0) if free.name == _RATE_FEEDBACK else free for free in SHIPPED_RANGES
)


def tolerance(figure: Figure) -> float:
    """Returns the deviation from a published figure that counts as 1."""
    name, metric = figure
    return 3.0 if metric == "settling_time" else 0.6 if name.endswith("-l1") else 0.25


def residuals(measured: Columns, left_out: Figure | None = None, bounded: bool = True) -> np.ndarray:
    """Returns the deviation of the mean of each figure over its tolerance, then what exceeds the bounds.

    left_out: a figure that is not looked at; bounded: whether overshoot and spread in hold are looked at
    """
    looked_at = [figure for figure in VALUES if figure != left_out]
    deviations = [
        float(np.mean(measured[" ".join(figure)]) - VALUES[figure]) / tolerance(figure)
        for figure in looked_at
    ]
    for name in SCENARIOS if bounded else ():
        excess = float(np.mean(measured[f"{name} overshoot"])) - LARGEST_OVERSHOOT_PCT
        spread = float(np.max(measured[f"{name} hold_spread"])) - LARGEST_SPREAD_MM
        deviations += [max(0.0, excess) / OVERSHOOT_TOLERANCE_PCT, max(0.0, spread) / SPREAD_TOLERANCE_MM]
    return np.clip(np.nan_to_num(np.array(deviations), nan=NOT_SETTLED), -NOT_SETTLED, NOT_SETTLED)


def values_at(free: Sequence[Free], scaled: np.ndarray) -> dict[str, float]:
    """Returns the values at positions 1..2 of the ranges, rounded: what is written is what was run."""
    return {
        number.name: float(f"{number.value(x - 1.0):.4g}") for number, x in zip(free, scaled, strict=True)
    }


def fit(
    vehicle: Vehicle,
    exact: Vehicle,
    free: Sequence[Free],
    start: Mapping[str, float],
    left_out: Figure | None = None,
) -> dict[str, float]:
    """Returns the values at which least squares from a start end.

    exact: without noise, where long differences and short ones take turns: the figures change in steps of a
    communication point, in which short ones alone stop too early; the last two steps are with noise
    """
    scaled = np.array([1.0 + number.position(start[number.name]) for number in free])
    without_noise = [(exact, SEEDS[:1], difference, 40) for difference in (0.1, 0.03, 0.1, 0.03)]
    for runs, seeds, difference, steps in (*without_noise, (vehicle, SEEDS, 0.01, 2)):

        def deviations(
            scaled: np.ndarray, runs: Vehicle = runs, seeds: tuple[int, ...] = seeds
        ) -> np.ndarray:
            return residuals(runs.of_all_seeds(values_at(free, scaled), seeds), left_out)

        options: dict[str, Any] = {"diff_step": difference, "ftol": 1e-6, "xtol": 1e-6, "max_nfev": steps}
        scaled = least_squares(deviations, np.clip(scaled, 1.001, 1.999), bounds=(1.0, 2.0), **options).x
    return values_at(free, scaled)


def document(values: Mapping[str, float], measured: Columns, cost: float) -> dict[str, Any]:
    """Returns a fit as plain data: mean, least and largest of each figure over the seeds."""
    return {
        "values": dict(values),
        "cost": float(f"{cost:.4g}"),
        "figures": {
            name: [float(f"{x:.5g}") for x in (np.mean(v), np.min(v), np.max(v))]
            for name, v in measured.items()
        },
    }


def fits(
    vehicle: Vehicle, exact: Vehicle, free: Sequence[Free], start: Mapping[str, float]
) -> dict[str, Any]:
    """Returns a fit to all eight figures, and to each seven of them, which begin where the first ended."""

    def fitted(begin: Mapping[str, float], left_out: Figure | None) -> dict[str, Any]:
        values = fit(vehicle, exact, free, begin, left_out)
        measured = vehicle.of_all_seeds(values)
        return document(values, measured, 0.5 * float(np.sum(residuals(measured, left_out) ** 2)))

    fit_to_all = fitted(start, None)
    others = {" ".join(figure): fitted(fit_to_all["values"], figure) for figure in VALUES}
    return {"all": fit_to_all, "left_out": others}


def one_seed(vehicle: Vehicle, generations: int = 11) -> dict[str, Any]:
    """Returns the end of a search that looks at the figures of one seed alone, with one seed and five."""

    def cost(measured: Columns) -> float:
        return 0.5 * float(np.sum(residuals(measured, bounded=False) ** 2))

    ended = differential_evolution(
        lambda scaled: cost(vehicle.of_all_seeds(values_at(FAST_RATE_FEEDBACK, scaled), SEEDS[:1])),
        [(1.0, 2.0)] * len(FAST_RATE_FEEDBACK),
        popsize=10,
        maxiter=generations,
        polish=False,
        rng=1,
    )
    values = values_at(FAST_RATE_FEEDBACK, ended.x)
    measured = {
        name: vehicle.of_all_seeds(values, s) for name, s in (("seed 1", SEEDS[:1]), ("five seeds", SEEDS))
    }
    return {name: document(values, figures, cost(figures)) for name, figures in measured.items()}


# What may differ in the run with added buoyancy: unit, largest size, variables, their value without it.
# A variable that loses a share has that value times what is left.
EFFECTS: dict[str, tuple[str, float, tuple[str, ...], float]] = {
    "added buoyancy": ("N", 2.0, (CHANGE,), 0.2),
    "thrust lost": ("%", 70.0, ("plant.thruster_gain[1]", "plant.thruster_gain[2]"), 0.25),
    "dead zone of the thrusters": (
        "V", 4.0, ("plant.thruster_dead_zone[1]", "plant.thruster_dead_zone[2]"), 0.0,
    ),
    "inertia": ("kg", 100.0, ("plant.inertia",), 5.5),
    "linear damping": ("N.s/m", 60.0, ("plant.linear_damping",), 2.5),
    "quadratic damping": ("N.s2/m2", 2000.0, ("plant.quadratic_damping",), 7.0),
    "depth feedback lost": ("%", 40.0, ("controller.depth_feedback_gain",), 1.895),
    "filter bandwidth lost": ("%", 80.0, ("controller.filter_bandwidth",), 0.3017),
    "bound of sigma_hat": ("N", 0.6, ("controller.sigma_bound",), 10.0),
}  # fmt: skip


def sets(effect: str, size: float) -> dict[str, float]:
    """Returns the values of the variables of an effect of that size."""
    unit, _, names, without = EFFECTS[effect]
    return dict.fromkeys(names, without * (1.0 - size / 100.0) if unit == "%" else size)


def needed(vehicle: Vehicle, effect: str) -> dict[str, Any]:
    """Returns the size of an effect that gives the published RMSE of plain L1 with added buoyancy.

    size: the largest if none up to it does, with `reached` False; then the figures with that size
    """
    unit, largest, _, without = EFFECTS[effect]
    none = 0.0 if unit == "%" else without

    def excess(size: float) -> float:
        rmse = vehicle.figures("buoyancy-l1", sets(effect, size))["rmse"][0]
        return float(np.nan_to_num(rmse, nan=100.0)) - VALUES["buoyancy-l1", "rmse"]

    reached = excess(largest) > 0.0
    size = brentq(excess, none, largest, xtol=1e-3 * abs(largest - none)) if reached else largest
    names = ["buoyancy-l1", "buoyancy-extended"]
    measured = vehicle.figures(names, sets(effect, float(size)))  # pyright: ignore[reportArgumentType]
    figures = {f"{name} {m}": column[i] for i, name in enumerate(names) for m, column in measured.items()}
    finite = {key: float(value) if np.isfinite(value) else None for key, value in figures.items()}
    return {"effect": effect, "unit": unit, "size": float(size), "reached": reached, **finite}  # pyright: ignore[reportArgumentType]
