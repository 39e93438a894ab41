"""The sets of gains that agree with the nominal row of the paper in every printed digit.

Every number that the paper leaves open has a range (`FREE`) and, before the figures are looked at, an even
density in it. Two gains are solved for in place of being drawn: the depth feedback such that the RMSE of
plain L1, then K_P such that the RMSE of the extension is a value drawn within its printed digits. Such a
point has the density of the ranges times |d ln gain / d ln RMSE| (change of variables). It agrees if both
settling times lie within their printed digits and no run overshoots by more than 1 %. So this is rejection
sampling in which the two narrow windows are met by construction, and needs no chain that converges.

Few even draws agree. So a pilot gives a `Proposal` for the two numbers that the row narrows most: even draws
whose settling times may be 2 s away, and three more rounds. The points are drawn from the proposal, and each
has its density divided by that of the proposal (importance sampling). The sensor has neither noise nor
resolution here.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize.elementwise import find_root
from scipy.stats import gaussian_kde, qmc
from vehicle import (
    BY_NAME,
    FREE,
    FREQUENCY,
    K_I,
    K_P,
    K_Z,
    LARGEST_OVERSHOOT_PCT,
    VALUES,
    Columns,
    Vehicle,
    half_a_digit,
)

DRAWN = tuple(free for free in FREE if free.name not in (K_Z, K_P))
"""What a point gives; its last two coordinates are shares of the RMSE windows of plain and extended L1."""
SHARES = {"nominal-l1": "share of plain L1", "nominal-extended": "share of the extension"}
GUIDED = ("controller.filter_bandwidth", FREQUENCY)
"""What the row narrows most; more of them would make the weights uneven."""


@dataclass(frozen=True)
class Variant:
    """One reading of what the paper does not state.

    task: scenario with the shape of the ramps; initial_depth: [m] at t = 0
    settling: [s] how far a settling time may be from the printed one; the text has "around 65 seconds"
    """

    name: str
    task: str = "nominal-extended"
    initial_depth: float = 0.0
    settling: float = 0.5


VARIANTS = (
    Variant("straight ramps, top at the surface"),
    Variant("settling times within 2 s", settling=2.0),
    Variant("smooth ramps, top at the surface", "nominal-extended-smooth"),
    Variant("straight ramps, afloat at rest", initial_depth=-0.0055),
    Variant("straight ramps, start at 0.1 m", initial_depth=0.1),
)


@dataclass(frozen=True)
class Effort:
    """How much is computed.

    pilot: draws of each of the four rounds of a pilot
    batches: the most of a round, of `draws` points each, `extensions` of each that agrees with plain L1; no
    more of them are drawn once all points are worth `enough` draws of equal density. If they are not at its
    end, the points of a round guide another one, up to `rounds`
    """

    pilot: int = 6000
    rounds: int = 3
    batches: int = 20
    draws: int = 4000
    extensions: int = 10
    enough: float = 250.0


class Proposal:
    """The density that points are drawn from: q(x) = a + (1 - a) kde(x) / Z in the unit cube.

    kde is the Gaussian kernel density of a pilot's points, Z its part within the cube, and a the share of
    even
    draws: no point counts more than 1 / a times one that was drawn evenly, so that a region that the pilot
    has missed is still drawn from (a defensive mixture, Hesterberg 1995).

    positions: of the pilot, shape (n, dimensions), n above the dimensions; weights: shape (n,)
    """

    EVEN_SHARE = 0.2

    def __init__(self, positions: np.ndarray, weights: np.ndarray) -> None:
        self._kernels = gaussian_kde(positions.T, weights=weights)
        # of 50 000 samples Z is known to 0.5 % where it is 0.5
        self._inside = float(np.mean(_is_inside(self._resampled(50_000, np.random.default_rng(1)))))

    def draw(self, count: int, generator: np.random.Generator) -> np.ndarray:
        """Returns independent draws, shape (count, dimensions)."""
        guided = np.empty((0, self._kernels.d))
        while len(guided) < count:
            more = self._resampled(count, generator)
            guided = np.concatenate([guided, more[_is_inside(more)]])
        even = generator.random((count, self._kernels.d))
        return np.where(generator.random((count, 1)) < self.EVEN_SHARE, even, guided[:count])

    def density(self, positions: np.ndarray) -> np.ndarray:
        """Returns q at positions in the cube, shape (n, dimensions)."""
        return self.EVEN_SHARE + (1.0 - self.EVEN_SHARE) * self._kernels(positions.T) / self._inside

    def _resampled(self, count: int, generator: np.random.Generator) -> np.ndarray:
        return self._kernels.resample(count, seed=generator).T


def _is_inside(positions: np.ndarray) -> np.ndarray:
    return np.all((positions >= 0.0) & (positions <= 1.0), axis=1)


def positions(points: Columns, names: tuple[str, ...]) -> np.ndarray:
    """Returns where the numbers of points lie in their ranges, 0..1, shape (points, names)."""
    return np.column_stack([BY_NAME[name].position(points[name]) for name in names])


def agreeing(vehicle: Vehicle, variant: Variant, points: Columns, scenario: str) -> Columns:
    """Solves for the gain that gives the RMSE; keeps the points whose settling time and overshoot agree."""
    points = _solved(vehicle, points, scenario)
    measured = vehicle.figures(scenario, _given(points))
    near = np.abs(measured["settling_time"] - VALUES[scenario, "settling_time"]) <= variant.settling
    figures = {f"{scenario} {metric}": column for metric, column in measured.items()}
    return _taken(points | figures, np.flatnonzero(near & (measured["overshoot"] <= LARGEST_OVERSHOOT_PCT)))


def _solved(vehicle: Vehicle, points: Columns, scenario: str) -> Columns:
    """Sets the gain that puts the RMSE a share of the way through its window; drops points without one."""
    gain, figure = (K_Z if scenario == "nominal-l1" else K_P), (scenario, "rmse")
    value, half = VALUES[figure], half_a_digit(figure)
    target = value + half * (2.0 * points[SHARES[scenario]] - 1.0)

    def excess(logarithm: np.ndarray, row: np.ndarray) -> np.ndarray:
        rows = row.astype(int)
        chosen = _given(_taken(points, rows)) | {gain: np.exp(logarithm)}
        diverged = 1e3  # cm, in place of what is not a number
        return np.log(np.nan_to_num(vehicle.figures(scenario, chosen)["rmse"], nan=diverged) / target[rows])

    every = np.arange(len(target), dtype=float)
    limits = (np.full(len(target), np.log(limit)) for limit in (BY_NAME[gain].low, BY_NAME[gain].high))
    # an RMSE comes as near to the value that was drawn as 0.3 of half a digit
    tolerances = {"xatol": 0.0, "xrtol": 0.0, "fatol": 0.3 * half / value, "frtol": 0.0}
    root: Any = find_root(excess, tuple(limits), args=(every,), tolerances=tolerances, maxiter=40)
    solved = np.flatnonzero(root.success)
    if len(solved):
        difference = 0.02  # of a logarithm: 2 % of the gain
        slope = (excess(root.x[solved] + difference, every[solved]) - root.f_x[solved]) / difference
        density = points["density"].copy()
        density[solved] /= np.abs(slope)
        points = points | {"density": density}
    return _taken(points | {gain: np.exp(root.x)}, solved)


def _given(points: Columns) -> Columns:
    """Returns the columns that runs take."""
    return {name: points[name] for name in (*BY_NAME, "plant.initial_depth") if name in points}


def _taken(points: Columns, rows: np.ndarray) -> Columns:
    return {name: column[rows] for name, column in points.items()}


def drawn_points(
    vehicle: Vehicle, variant: Variant, seed: int, count: int, extensions: int, proposal: Proposal | None
) -> Columns:
    """Returns the points that agree, of `count` drawn; what agrees with plain L1 gets so many extensions.

    They are columns: names of `FREE`, "SCENARIO METRIC", density and the number of the draw. Points with the
    same draw differ in K_P and K_I alone.
    """
    generator = np.random.default_rng(seed)
    shares = qmc.LatinHypercube(len(DRAWN) + 2, rng=seed).random(count)
    guided = [i for i, free in enumerate(DRAWN) if free.name in GUIDED]
    if proposal:
        shares[:, guided] = proposal.draw(count, generator)
    points = {free.name: free.value(share) for free, share in zip(DRAWN, shares.T, strict=False)}
    points |= dict(zip(SHARES.values(), shares.T[-2:], strict=True))
    points["density"] = 1.0 / proposal.density(shares[:, guided]) if proposal else np.ones(count)
    points["plant.initial_depth"] = np.full(count, variant.initial_depth)
    points = agreeing(vehicle, variant, points, "nominal-l1")
    rows = np.repeat(np.arange(len(points["density"])), extensions)
    points, again = _taken(points, rows) | {"draw": rows}, generator.random((len(rows), 2)).T
    points |= {K_I: BY_NAME[K_I].value(again[0]), SHARES["nominal-extended"]: again[1]}
    return agreeing(vehicle, variant, points, "nominal-extended")


def pilot(vehicle: Vehicle, variant: Variant, effort: Effort) -> Proposal:
    """Returns where draws agree: even draws with wide settling times, then rounds that guide each other."""
    proposal = None
    for seed, settling in enumerate((2.0, 1.0, 0.0, 0.0), start=1):
        wide = replace(variant, settling=max(variant.settling, settling))
        proposal = guide(drawn_points(vehicle, wide, seed, effort.pilot, 10, proposal))
    assert proposal
    return proposal


def guide(points: Columns) -> Proposal:
    """Returns the proposal that a set of points gives: its draws, and what they count."""
    _, first, draw = np.unique(points["draw"], return_index=True, return_inverse=True)
    weights = np.bincount(draw, weights=points["density"])
    return Proposal(positions(_taken(points, first), GUIDED), weights)


def posterior(vehicle: Vehicle, variant: Variant, effort: Effort) -> Columns:
    """Returns the points of a variant with their figures in all four scenarios."""
    proposal, points = pilot(vehicle, variant, effort), Columns()
    for number in range(1, 1 + effort.rounds):
        before, of_round = points, Columns()
        for seed in range(100 * number + 1, 100 * number + 1 + effort.batches):  # not those of the pilot
            batch = drawn_points(vehicle, variant, seed, effort.draws, effort.extensions, proposal)
            of_round = joined(of_round, batch)
            points = joined(before, by_worth(of_round))
            if effective_draws(points) >= effort.enough:
                return _predicted(vehicle, points)
        proposal = guide(of_round)
    return _predicted(vehicle, points)


def _predicted(vehicle: Vehicle, points: Columns) -> Columns:
    for scenario in ("buoyancy-l1", "buoyancy-extended"):
        measured = vehicle.figures(scenario, _given(points))
        points = points | {f"{scenario} {metric}": column for metric, column in measured.items()}
    return points


def joined(points: Columns, more: Columns) -> Columns:
    """Returns the points of two sets, whose draws are different ones; the first may be empty."""
    if not points:
        return more
    more = more | {"draw": more["draw"] + 1 + points["draw"].max(initial=-1)}
    return {name: np.concatenate([column, more[name]]) for name, column in points.items()}


def by_worth(points: Columns) -> Columns:
    """Returns them with densities that sum to the effective draws, which of joined sets then add up."""
    total = np.sum(points["density"])
    return points | {"density": points["density"] * (effective_draws(points) / total)} if total else points


def effective_draws(points: Columns) -> float:
    """Returns the number of draws of equal density that would be worth as much: (sum w)^2 / sum w^2."""
    of_draws = np.bincount(points["draw"], weights=points["density"])
    return float(np.sum(of_draws) ** 2 / np.sum(of_draws**2)) if of_draws.any() else 0.0
