"""What must differ in the experiment with added buoyancy, if the shipped gains are those of the paper.

In the limit of fast adaptation the law holds u_a' = -w (u_a + sigma - k_z r) with sigma = M v' + D v - u,
whatever the vehicle. On a ramp r' = V the thrust tends to a constant, so that u_a' = k_z V, and the tracking
error to V times

    lag = (k_z / w + D + k_v) / (k_z + K_P)        (K_I = 0)

which holds no number of the vehicle, neither inertia nor drag nor thrust nor buoyancy: M and D are those of
the design. A constant force dF is cancelled once w (k_z + K_P) int dz dt = -dF, so that it changes the
RMSE over the time T of the run by about

    d RMSE = lag V dF / (w (k_z + K_P) T RMSE)

Each of `EFFECTS` is then laid over the scenario with added buoyancy, as large as its published RMSE needs.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestration.study.eight_figures import Figure, VehicleRuns
from orchestration.study.posterior import VALUES

Sized = Callable[[float], dict[str, float]]


def ramp_lag(k_z: float, k_v: float, w: float, k_p: float = 0.0, damping: float = 2.5) -> float:
    """The time [s] by which the depth follows a ramp, in the limit of fast adaptation and K_I = 0."""
    return (k_z / w + damping + k_v) / (k_z + k_p)


def change_of_rmse(
    force: float, k_z: float, k_v: float, w: float, rmse: float, k_p: float = 0.0, ramp: float = 0.02
) -> float:
    """By how much [cm] a constant force [N], there from the start, raises an RMSE [cm], to first order."""
    lost = ramp_lag(k_z, k_v, w, k_p) * ramp * force / (w * (k_z + k_p))  # m2.s, half the change of int e^2
    return 100.0 * lost / (310.0 * rmse / 100.0)


@dataclass(frozen=True)
class Effect:
    """Something that may differ between the two experiments: its unit, its range and what it sets."""

    name: str
    unit: str
    none: float
    largest: float
    sets: Sized


def _thrusters(name: str, value: float) -> dict[str, float]:
    return {f"plant.thruster_{name}[{i}]": value for i in (1, 2)}


EFFECTS = (
    Effect("added buoyancy", "N", 0.2, 2.0, lambda size: {"plant.buoyancy_change": size}),
    Effect("thrust lost", "%", 0.0, 70.0, lambda size: _thrusters("gain", 0.25 * (1.0 - size / 100.0))),
    Effect("dead zone of the thrusters", "V", 0.0, 4.0, lambda size: _thrusters("dead_zone", size)),
    Effect("inertia", "kg", 5.5, 100.0, lambda size: {"plant.inertia": size}),
    Effect("linear damping", "N.s/m", 2.5, 60.0, lambda size: {"plant.linear_damping": size}),
    Effect("quadratic damping", "N.s2/m2", 7.0, 2000.0, lambda size: {"plant.quadratic_damping": size}),
    Effect(
        "depth feedback lost", "%", 0.0, 40.0,
        lambda size: {"controller.depth_feedback_gain": 1.895 * (1.0 - size / 100.0)},
    ),
    Effect(
        "filter bandwidth lost", "%", 0.0, 80.0,
        lambda size: {"controller.filter_bandwidth": 0.3017 * (1.0 - size / 100.0)},
    ),
    Effect(
        "bound of sigma_hat", "N", 10.0, 0.6,
        lambda size: {"controller.sigma_bound": size},
    ),
)  # fmt: skip
_TARGET: Figure = ("buoyancy-l1", "rmse")


def needed(runs: VehicleRuns, effect: Effect) -> dict[str, Any]:
    """The size of an effect that gives the published RMSE of plain L1 with added buoyancy, and the figures.

    size: the largest if none up to it does, with `reached` False; figures: with that size
    """
    from scipy.optimize import brentq

    def excess(size: float) -> float:
        measured = runs.one(_TARGET[0], _with(effect, size))["rmse"]
        return float(np.nan_to_num(measured, nan=100.0)) - VALUES[_TARGET]

    size, reached = effect.largest, excess(effect.largest) > 0.0
    if reached:
        root: Any = brentq(excess, effect.none, effect.largest, xtol=1e-3 * abs(effect.largest - effect.none))
        size = root
    measured = {
        f"{name} {metric}": value if math.isfinite(value) else None
        for name in ("buoyancy-l1", "buoyancy-extended")
        for metric, value in runs.one(name, _with(effect, size)).items()
    }
    return {"effect": effect.name, "unit": effect.unit, "size": float(size), "reached": reached, **measured}


def _with(effect: Effect, size: float) -> Mapping[str, float]:
    return {"plant.buoyancy_change": 0.2} | effect.sets(size)
