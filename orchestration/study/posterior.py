"""The sets of gains that agree with the nominal row of the paper in every printed digit.

Every number that the paper leaves open has a range (`FREE`) and, before the figures are looked at, a uniform
density in it. Two gains are solved for in place of being drawn: the depth feedback such that the RMSE of
plain L1, then K_P such that the RMSE of the extension is a value drawn within its printed digits. Such a
point has the density of the ranges times |d ln gain / d ln RMSE| (change of variables). It agrees if both
settling times lie within their printed digits and no run overshoots by more than 1 %. So this is rejection
sampling in which the two narrow windows are met by construction, and needs no chain that converges.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from orchestration.scenarios.identify import LARGEST_OVERSHOOT_PCT
from orchestration.scenarios.published import PUBLISHED
from orchestration.study.depth_loop_model import SHIPPED, adaptation_vector, depth_task, figures

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
DRAWN = tuple(free for free in FREE if free.name not in (K_Z, K_P))
"""What a point gives; its last two coordinates are shares of the RMSE windows of plain and extended L1."""
DIMENSIONS = len(DRAWN) + 2
_OF_THE_EXTENSION = [*(i for i, free in enumerate(DRAWN) if free.name == K_I), DIMENSIONS - 1]

Columns = dict[str, np.ndarray]


@dataclass(frozen=True)
class Variant:
    """One reading of what the paper does not state.

    scenario: that has the shape of the ramps; initial_depth: [m] at t = 0
    settling: [s] how far a settling time may be from the printed one; the text has "around 65 seconds"
    """

    name: str
    scenario: str = "nominal-extended"
    initial_depth: float = 0.0
    settling: float = HALF_A_DIGIT["nominal-l1", "settling_time"]


VARIANTS = (
    Variant("straight ramps, top at the surface"),
    Variant("settling times within 2 s", settling=2.0),
    Variant("smooth ramps, top at the surface", "nominal-extended-smooth"),
    Variant("straight ramps, afloat at rest", initial_depth=-0.0055),
    Variant("straight ramps, start at 0.1 m", initial_depth=0.1),
)


def with_adaptation_gain(columns: Mapping[str, Any]) -> dict[str, Any]:
    """The variables of the loop: the adaptation gain in place of the frequency that it gives at phi = 0.

    Gamma = frequency^2 / (B_m' P B_m)
    """
    variables = {name: column for name, column in columns.items() if name != FREQUENCY}
    if FREQUENCY in columns:
        square = columns[FREQUENCY] ** 2
        design = {name: SHIPPED[name] for name in ("controller.model_inertia", "controller.model_damping")}
        p_b = adaptation_vector({**design, **variables})[1]
        variables["controller.adaptation_gain"] = square * design["controller.model_inertia"] / p_b
    return variables


class Points:
    """Points of the unit cube, shape (n, DIMENSIONS); those that disagree with a window are dropped.

    rows: which of the points given are left; columns: their values; density: of each, relative
    """

    def __init__(self, variant: Variant, shares: np.ndarray) -> None:
        self._variant, self._task, self.runs = variant, depth_task(variant.scenario), 0
        self.shares, self.rows, self.density = shares, np.arange(len(shares)), np.ones(len(shares))
        self.columns = self._columns()

    def agree(self) -> "Points":
        """Keep the points that agree with the nominal row."""
        self.agree_with("nominal-l1")
        self.agree_with("nominal-extended")
        return self

    def agree_with(self, scenario: str) -> None:
        """Solve for the gain that gives the RMSE; keep the points whose settling time and overshoot agree."""
        if scenario == "nominal-l1":
            self._solve(scenario, K_Z, self.shares[:, -2])
        else:
            self._solve(scenario, K_P, self.shares[:, -1])
        measured = self.measure(scenario)
        settled = within(measured["settling_time"], (scenario, "settling_time"), self._variant.settling)
        self._take(np.flatnonzero(settled & (measured["overshoot"] <= LARGEST_OVERSHOOT_PCT)))

    def redraw_extension(self, shares: np.ndarray) -> None:
        """Every point several times, with other K_I and extended RMSE: shares of shape (points, times, 2)."""
        self._take(np.repeat(np.arange(len(self.rows)), shares.shape[1]))
        self.shares[:, _OF_THE_EXTENSION] = shares.reshape(-1, 2)
        self.columns |= {K_I: self._columns()[K_I]}

    def measure(self, scenario: str, columns: Columns | None = None) -> Columns:
        """The figures of every point in a scenario."""
        variables = with_adaptation_gain(self.columns if columns is None else columns)
        variables["plant.initial_depth"] = self._variant.initial_depth
        if scenario.endswith("-l1"):
            variables |= {K_P: 0.0, K_I: 0.0}
        if scenario.startswith("nominal"):
            variables["plant.buoyancy_change"] = 0.0
        measured = figures(self._task, variables)
        self.runs += len(measured["rmse"])
        return measured

    def _columns(self) -> Columns:
        return {free.name: free.value(share) for free, share in zip(DRAWN, self.shares.T, strict=False)}

    def _solve(self, scenario: str, gain: str, shares: np.ndarray) -> None:
        """Set the gain that puts the RMSE `shares` of the way through its window; drop points without."""
        from scipy.optimize.elementwise import find_root  # takes a second to import

        value, half = VALUES[scenario, "rmse"], HALF_A_DIGIT[scenario, "rmse"]
        target, columns = value + half * (2.0 * shares - 1.0), self.columns

        def excess(logarithm: np.ndarray, row: np.ndarray) -> np.ndarray:
            rows = row.astype(int)
            chosen = {name: column[rows] for name, column in columns.items()} | {gain: np.exp(logarithm)}
            rmse = np.nan_to_num(self.measure(scenario, chosen)["rmse"], nan=_DIVERGED, posinf=_DIVERGED)
            return np.log(rmse / target[rows])

        every = np.arange(len(target), dtype=float)
        limits = (np.full(len(target), np.log(limit)) for limit in (BY_NAME[gain].low, BY_NAME[gain].high))
        tolerances = {"xatol": 0.0, "xrtol": 0.0, "fatol": _TOLERANCE * half / value, "frtol": 0.0}
        root = find_root(excess, tuple(limits), args=(every,), tolerances=tolerances, maxiter=40)
        self.columns = {**columns, gain: np.exp(root.x)}
        solved = np.flatnonzero(root.success)
        if len(solved):
            slope = (excess(root.x[solved] + _DIFFERENCE, every[solved]) - root.f_x[solved]) / _DIFFERENCE
            self.density[solved] /= np.abs(slope)
        self._take(solved)

    def _take(self, chosen: np.ndarray) -> None:
        self.columns = {name: column[chosen] for name, column in self.columns.items()}
        self.shares, self.rows, self.density = self.shares[chosen], self.rows[chosen], self.density[chosen]


_DIVERGED = 1e3  # cm, in place of what is not a number
_DIFFERENCE = 0.02  # of a logarithm: 2 % of a gain
_TOLERANCE = 0.3  # of half a digit: how near to the value that was drawn an RMSE comes


def within(values: np.ndarray, figure: tuple[str, str], half_width: float | None = None) -> np.ndarray:
    """Where a figure agrees with the printed one in every digit, or within a half-width."""
    return np.abs(values - VALUES[figure]) <= (HALF_A_DIGIT[figure] if half_width is None else half_width)


def drawn_points(variant: Variant, seed: int, count: int, of_the_extension: int) -> Points:
    """The points that agree, of `count` drawn evenly; what agrees with plain L1 gets so many extensions."""
    from scipy.stats import qmc

    points = Points(variant, qmc.LatinHypercube(DIMENSIONS, rng=seed).random(count))
    points.agree_with("nominal-l1")
    again = np.random.default_rng(seed).random((len(points.rows), of_the_extension, 2))
    points.redraw_extension(again)
    points.agree_with("nominal-extended")
    return points


def predicted(variant: Variant, shares: np.ndarray) -> Columns:
    """Points that agree, as columns: names of `FREE`, "SCENARIO METRIC", density and the number of the draw.

    Points with the same draw differ in K_P and K_I alone.
    """
    points = Points(variant, shares).agree()
    columns = points.columns
    for scenario in ("nominal-l1", "nominal-extended", "buoyancy-l1", "buoyancy-extended"):
        columns = columns | {
            f"{scenario} {name}": values for name, values in points.measure(scenario).items()
        }
    _, draw = np.unique(columns[K_Z], return_inverse=True)
    return columns | {"density": points.density, "draw": draw}
