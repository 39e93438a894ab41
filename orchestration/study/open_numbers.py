"""The eight figures of the paper's tables, and the numbers that it leaves open, each with a range."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestration.scenarios.published import PUBLISHED
from orchestration.study.depth_loop_model import adaptation_vector, shipped_values

Columns = dict[str, np.ndarray]
"""Name -> value of every point, shape (points,)."""

HALF_A_DIGIT = {
    ("nominal-l1", "settling_time"): 0.5,
    ("nominal-l1", "rmse"): 0.05,
    ("nominal-extended", "settling_time"): 0.5,
    ("nominal-extended", "rmse"): 0.005,
    ("buoyancy-l1", "settling_time"): 0.5,
    ("buoyancy-l1", "rmse"): 0.05,
    ("buoyancy-extended", "settling_time"): 0.5,
    ("buoyancy-extended", "rmse"): 0.005,
}
"""What rounding to the printed digits can hide: of 65 s, 0.5 s."""
VALUES = {
    (figure.scenario, figure.metric): figure.value
    for figure in PUBLISHED
    if (figure.scenario, figure.metric) in HALF_A_DIGIT
}
"""The eight figures of Tables 1 and 2."""


@dataclass(frozen=True)
class Free:
    """A number that the paper leaves open: its range, uniform in the logarithm or in the value, and why."""

    name: str
    unit: str
    low: float
    high: float
    logarithmic: bool
    reason: str

    def value(self, share: Any) -> Any:
        """The quantile of a share, 0..1, or of an array of them."""
        if self.logarithmic:
            return self.low * (self.high / self.low) ** share
        return self.low + (self.high - self.low) * share

    def position(self, value: Any) -> Any:
        """The share of which a value is the quantile."""
        if self.logarithmic:
            return np.log(value / self.low) / np.log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


FREQUENCY = "adaptation_frequency"
FREE = (
    Free("plant.inertia", "kg", 5.0, 7.0, False, "3 kg and the added mass of a box"),
    Free("plant.linear_damping", "N.s/m", 1.0, 10.0, True, "guess"),
    Free("plant.quadratic_damping", "N.s2/m2", 5.0, 20.0, True, "0.5 rho C_d A"),
    Free("plant.net_weight", "N", -1.25, -1.15, False, "published: -1.2"),
    Free("plant.buoyancy_change", "N", 0.15, 0.25, False, "published: +0.2"),
    Free("controller.depth_feedback_gain", "N/m", 0.05, 20.0, True, "solved for"),
    Free("controller.rate_feedback_gain", "N.s/m", 0.5, 30.0, True, "A_m below 6 rad/s"),
    Free("controller.filter_bandwidth", "rad/s", 0.05, 2.0, True, "not published"),
    Free(FREQUENCY, "rad/s", 0.1, 6.0, True, "of the adaptation loop at phi = 0"),
    Free("controller.sigma_bound", "N", 0.3, 10.0, True, "not published"),
    Free("controller.theta_bound[1]", "N", 0.3, 10.0, True, "not published"),
    Free("controller.proportional_gain", "N/m", 0.05, 50.0, True, "solved for"),
    Free("controller.integral_gain", "N/(m.s)", 1e-4, 0.1, True, "not published"),
)
K_Z, K_P, K_I = (f"controller.{name}_gain" for name in ("depth_feedback", "proportional", "integral"))
BY_NAME = {free.name: free for free in FREE}


def with_adaptation_gain(columns: Mapping[str, Any]) -> dict[str, Any]:
    """The variables of the loop: the adaptation gain in place of the frequency that it gives at phi = 0.

    Gamma = frequency^2 / (B_m' P B_m)
    """
    variables = {name: column for name, column in columns.items() if name != FREQUENCY}
    if FREQUENCY in columns:
        square = columns[FREQUENCY] ** 2
        shipped = shipped_values()
        design = {name: shipped[name] for name in ("controller.model_inertia", "controller.model_damping")}
        p_b = adaptation_vector({**design, **variables})[1]
        variables["controller.adaptation_gain"] = square * design["controller.model_inertia"] / p_b
    return variables
