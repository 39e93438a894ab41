"""A walk over the sets of gains that agree with the nominal row: emcee's ensemble of walkers.

It starts at points found by rejection and moves by differences of its own points (ter Braak 2006), without
step sizes. Source: Foreman-Mackey et al., emcee, PASP 125 (2013).
"""

from dataclasses import dataclass

import numpy as np

from fmus.extras import imports_of
from orchestration.study.posterior import DIMENSIONS, Columns, Points, Variant

with imports_of("study", "the posterior"):
    import emcee


@dataclass(frozen=True)
class Block:
    """Part of a walk. shares: (steps, walkers, DIMENSIONS); accepted: share of moves; runs: of the model."""

    shares: np.ndarray
    accepted: float
    runs: int


def walk(variant: Variant, begin: np.ndarray, steps: int, seed: int) -> Block:
    """So many steps from the points `begin`, shape (walkers, DIMENSIONS), all of which agree.

    It walks in standard normal quantiles of the coordinates, which have no walls.
    """
    from scipy.special import ndtr, ndtri

    runs = 0

    def log_density(quantiles: np.ndarray) -> np.ndarray:
        nonlocal runs
        points = Points(variant, ndtr(quantiles)).agree()
        runs += points.runs
        logarithm = np.full(len(quantiles), -np.inf)
        logarithm[points.rows] = np.log(points.density) - 0.5 * np.sum(quantiles[points.rows] ** 2, axis=1)
        return logarithm

    moves = [
        (emcee.moves.DEMove(), 0.8),
        (emcee.moves.DESnookerMove(), 0.1),
        (emcee.moves.StretchMove(), 0.1),
    ]
    sampler = emcee.EnsembleSampler(len(begin), DIMENSIONS, log_density, moves=moves, vectorize=True)
    sampler.random_state = np.random.RandomState(seed).get_state()
    sampler.run_mcmc(ndtri(begin), steps, skip_initial_state_check=True)
    return Block(ndtr(sampler.get_chain()), float(np.mean(sampler.acceptance_fraction)), runs)


def autocorrelation_time(shares: np.ndarray) -> np.ndarray:
    """Steps between independent points of a walk, for each dimension: shape (DIMENSIONS,)."""
    return emcee.autocorr.integrated_time(shares, quiet=True)


def predicted(variant: Variant, shares: np.ndarray) -> Columns:
    """Values and figures of points that agree: columns named as in `FREE`, and "SCENARIO METRIC"."""
    points = Points(variant, shares).agree()
    columns = points.columns
    for scenario in ("nominal-l1", "nominal-extended", "buoyancy-l1", "buoyancy-extended"):
        columns = columns | {
            f"{scenario} {name}": values for name, values in points.measure(scenario).items()
        }
    return columns
