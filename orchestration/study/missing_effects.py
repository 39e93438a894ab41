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
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestration.study.depth_loop_model import shipped_values
from orchestration.study.open_numbers import VALUES
from orchestration.study.vehicle_runs import Figure, VehicleRuns

RAMP_M_PER_S, DURATION_S = 0.02, 310.0  # 0.8 m in 40 s: section 5.2
_TARGET: Figure = ("buoyancy-l1", "rmse")


def ramp_lag(k_z: float, k_v: float, w: float, damping: float, k_p: float = 0.0) -> float:
    """The time [s] by which the depth follows a ramp, in the limit of fast adaptation and K_I = 0."""
    return (k_z / w + damping + k_v) / (k_z + k_p)


def change_of_rmse(force: float, rmse: float, lag: float, w: float, stiffness: float) -> float:
    """By how much [cm] a constant force [N], there from the start, raises an RMSE [cm], to first order.

    lag: that of `ramp_lag`; stiffness: k_z + K_P
    """
    lost = lag * RAMP_M_PER_S * force / (w * stiffness)  # m2.s, half the change of int e^2
    return 100.0 * lost / (DURATION_S * rmse / 100.0)


@dataclass(frozen=True)
class Effect:
    """Something that may differ between the two experiments.

    variables: that it changes; is_loss: they lose its size [%], else they have it, up to the largest
    """

    name: str
    unit: str
    largest: float
    variables: tuple[str, ...]
    is_loss: bool = False

    @property
    def none(self) -> float:
        """The size that leaves the shipped scenario as it is."""
        return 0.0 if self.is_loss else shipped_values(_TARGET[0])[self.variables[0]]

    def sets(self, size: float) -> dict[str, float]:
        """The values of the variables."""
        left = 1.0 - size / 100.0
        shipped = shipped_values(_TARGET[0])
        return {name: shipped[name] * left if self.is_loss else size for name in self.variables}


def _thrusters(name: str) -> tuple[str, ...]:
    return tuple(f"plant.thruster_{name}[{i}]" for i in (1, 2))


EFFECTS = (
    Effect("added buoyancy", "N", 2.0, ("plant.buoyancy_change",)),
    Effect("thrust lost", "%", 70.0, _thrusters("gain"), is_loss=True),
    Effect("dead zone of the thrusters", "V", 4.0, _thrusters("dead_zone")),
    Effect("inertia", "kg", 100.0, ("plant.inertia",)),
    Effect("linear damping", "N.s/m", 60.0, ("plant.linear_damping",)),
    Effect("quadratic damping", "N.s2/m2", 2000.0, ("plant.quadratic_damping",)),
    Effect("depth feedback lost", "%", 40.0, ("controller.depth_feedback_gain",), is_loss=True),
    Effect("filter bandwidth lost", "%", 80.0, ("controller.filter_bandwidth",), is_loss=True),
    Effect("bound of sigma_hat", "N", 0.6, ("controller.sigma_bound",)),
)


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
    change = "plant.buoyancy_change"
    return {change: shipped_values(_TARGET[0])[change]} | effect.sets(size)
