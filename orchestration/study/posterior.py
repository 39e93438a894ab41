"""The sets of gains that agree with the nominal row of the paper in every printed digit.

Every number that the paper leaves open has a range (`FREE`) and, before the figures are looked at, a uniform
density in it. Two gains are solved for in place of being drawn: the depth feedback such that the RMSE of
plain L1, then K_P such that the RMSE of the extension is a value drawn within its printed digits. Such a
point has the density of the ranges times |d ln gain / d ln RMSE| (change of variables). It agrees if both
settling times lie within their printed digits and no run overshoots by more than 1 %. So this is rejection
sampling in which the two narrow windows are met by construction, and needs no chain that converges.

Few even draws agree. So a pilot gives a `Proposal` for the two numbers that the row narrows most: even draws
whose settling times may be 2 s away, and three more rounds, the first of them narrower, the last two as the
variant asks. The points are drawn from the proposal, and each has its density divided by that of the proposal
(importance sampling).
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from orchestration.scenarios.identify import LARGEST_OVERSHOOT_PCT
from orchestration.study.depth_loop_model import depth_task, figures
from orchestration.study.open_numbers import (
    BY_NAME,
    FREE,
    FREQUENCY,
    HALF_A_DIGIT,
    K_I,
    K_P,
    K_Z,
    VALUES,
    Columns,
    with_adaptation_gain,
)
from orchestration.study.proposal import Proposal

DRAWN = tuple(free for free in FREE if free.name not in (K_Z, K_P))
"""What a point gives; its last two coordinates are shares of the RMSE windows of plain and extended L1."""
DIMENSIONS = len(DRAWN) + 2
_OF_THE_EXTENSION = [*(i for i, free in enumerate(DRAWN) if free.name == K_I), DIMENSIONS - 1]
_GUIDED_NAMES = ("controller.filter_bandwidth", FREQUENCY)
"""What the row narrows most; more of them would make the weights uneven."""
_GUIDED = [i for i, free in enumerate(DRAWN) if free.name in _GUIDED_NAMES]
_PILOT_SETTLING = (2.0, 1.0, 0.0, 0.0)  # s, or that of the variant if it is more
_PILOT_EXTENSIONS = 10


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


class Points:
    """Points of the unit cube, shape (n, DIMENSIONS); those that disagree with a window are dropped.

    rows: which of the points given are left; columns: their values; density: of each, relative
    proposal: that the points were drawn from; None: evenly
    """

    def __init__(self, variant: Variant, shares: np.ndarray, proposal: Proposal | None = None) -> None:
        self._variant, self._task, self.runs = variant, depth_task(variant.scenario), 0
        self.shares, self.rows, self.density = shares, np.arange(len(shares)), np.ones(len(shares))
        if proposal:
            self.density /= proposal.density(shares[:, _GUIDED])
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


def drawn_points(
    variant: Variant, seed: int, count: int, of_the_extension: int, proposal: Proposal | None = None
) -> Points:
    """The points that agree, of `count` drawn; what agrees with plain L1 gets so many extensions."""
    from scipy.stats import qmc  # takes a second to import

    generator = np.random.default_rng(seed)
    shares = qmc.LatinHypercube(DIMENSIONS, rng=seed).random(count)
    if proposal:
        shares[:, _GUIDED] = proposal.draw(count, generator)
    points = Points(variant, shares, proposal)
    points.agree_with("nominal-l1")
    points.redraw_extension(generator.random((len(points.rows), of_the_extension, 2)))
    points.agree_with("nominal-extended")
    return points


def pilot(variant: Variant, count: int) -> dict[str, Any]:
    """Where draws agree: positions, one a draw, their weights, and the runs that it took.

    `count` even draws with wide settling times first, then rounds of as many, each guided by the one before.
    """
    runs, proposal, guide = 0, None, {}
    for seed, settling in enumerate(_PILOT_SETTLING, start=1):
        wide = replace(variant, settling=max(variant.settling, settling))
        points = drawn_points(wide, seed, count, _PILOT_EXTENSIONS, proposal)
        _, first, draw = np.unique(points.columns[K_Z], return_index=True, return_inverse=True)
        weights = np.bincount(draw, weights=points.density, minlength=len(first))
        guide = {"positions": points.shares[first][:, _GUIDED], "weights": weights}
        proposal, runs = Proposal(**guide), runs + points.runs
    return guide | {"runs": runs}


def predicted(variant: Variant, shares: np.ndarray, proposal: Proposal | None = None) -> Columns:
    """Points that agree, as columns: names of `FREE`, "SCENARIO METRIC", density and the number of the draw.

    Points with the same draw differ in K_P and K_I alone.
    """
    points = Points(variant, shares, proposal).agree()
    columns = points.columns
    for scenario in ("nominal-l1", "nominal-extended", "buoyancy-l1", "buoyancy-extended"):
        columns = columns | {
            f"{scenario} {name}": values for name, values in points.measure(scenario).items()
        }
    _, draw = np.unique(columns[K_Z], return_inverse=True)
    return columns | {"density": points.density, "draw": draw}


def guide_of(points: Columns) -> dict[str, np.ndarray]:
    """The arguments of the proposal that a set of points gives: its draws, and what they count."""
    _, first = np.unique(points["draw"], return_index=True)
    positions = [BY_NAME[name].position(points[name][first]) for name in _GUIDED_NAMES]
    weights = np.bincount(points["draw"], weights=points["density"])
    return {"positions": np.column_stack(positions), "weights": weights}


def joined(points: Columns, more: Columns) -> Columns:
    """The points of two sets, whose draws are different ones; the first may be empty."""
    if not points:
        return more
    offset = 1 + points["draw"].max(initial=-1)
    return {
        name: np.concatenate([column, more[name] + offset if name == "draw" else more[name]])
        for name, column in points.items()
    }


def by_worth(points: Columns) -> Columns:
    """The same with densities that sum to the effective draws, which of sets that are joined then add up."""
    if not len(points["density"]):
        return points
    return points | {"density": points["density"] * (effective_draws(points) / np.sum(points["density"]))}


def effective_draws(points: Columns) -> float:
    """The number of draws of equal density that would be worth as much: (sum w)^2 / sum w^2."""
    of_draws = np.bincount(points["draw"], weights=points["density"])
    if not of_draws.any():
        return 0.0
    return float(np.sum(of_draws) ** 2 / np.sum(of_draws**2))
