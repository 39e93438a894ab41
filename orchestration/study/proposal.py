"""The density that the points of the posterior are drawn from, as a pilot sample suggests it.

    q(x) = a + (1 - a) kde(x) / Z    in the unit cube

kde is the Gaussian kernel density of the pilot's points with Scott's bandwidth, Z its part within the cube,
and a the share of even draws: no point counts more than 1 / a times one that was drawn evenly, so that a
region that the pilot has missed is still drawn from (a defensive mixture, Hesterberg 1995).
"""

import numpy as np

EVEN_SHARE = 0.2
_SAMPLES = 50_000  # of which Z is known to 0.5 % where it is 0.5


class Proposal:
    """positions: of the pilot, shape (n, dimensions), n above the dimensions; weights: shape (n,)."""

    def __init__(self, positions: np.ndarray, weights: np.ndarray) -> None:
        from scipy.stats import gaussian_kde  # takes a second to import

        self._kernels = gaussian_kde(positions.T, weights=weights)
        self._inside = float(np.mean(_is_inside(self._resampled(_SAMPLES, np.random.default_rng(1)))))

    def draw(self, count: int, generator: np.random.Generator) -> np.ndarray:
        """Independent draws, shape (count, dimensions)."""
        guided = np.empty((0, self._kernels.d))
        while len(guided) < count:
            more = self._resampled(count, generator)
            guided = np.concatenate([guided, more[_is_inside(more)]])
        even = generator.random((count, self._kernels.d))
        return np.where(generator.random((count, 1)) < EVEN_SHARE, even, guided[:count])

    def density(self, positions: np.ndarray) -> np.ndarray:
        """q at positions in the cube, shape (n, dimensions)."""
        return EVEN_SHARE + (1.0 - EVEN_SHARE) * self._kernels(positions.T) / self._inside

    def _resampled(self, count: int, generator: np.random.Generator) -> np.ndarray:
        return self._kernels.resample(count, seed=generator).T


def _is_inside(positions: np.ndarray) -> np.ndarray:
    return np.all((positions >= 0.0) & (positions <= 1.0), axis=1)
