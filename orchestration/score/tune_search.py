"""One search of CMA-ES with a fixed number of evaluations, asked for points and told their costs.

Source: Hansen, "The CMA evolution strategy: a tutorial" (arXiv 1604.00772), as the library `cmaes` has it;
restarts with twice the population after Auger and Hansen (CEC 2005).
"""

from collections.abc import Sequence

import numpy as np

from fmus.extras import require

_BEGIN = (0.25, 0.75)  # of the unit cube: the first mean of a search is drawn from there
_STEP = 0.25  # first standard deviation: half of the range lies within one of the mean
_FINE_STEP = 0.05  # that of a search which begins at a point that another one has found


class Search:
    """Points of the unit cube, generation by generation, until the evaluations are used up.

    The same seed and the same costs give the same points, so that a search continues from its costs alone.
    start: point that the search begins at, in small steps; by default it begins anywhere
    """

    def __init__(
        self, dimensions: int, seed: int, evaluations: int, start: Sequence[float] | None = None
    ) -> None:
        self._dimensions = dimensions
        self._random = np.random.default_rng(seed)
        self._remaining = evaluations
        self._points: list[np.ndarray] = []
        self._start = start
        self._begin(None)

    def _begin(self, population: int | None) -> None:
        cmaes = require("cmaes", "study", "tuning")
        size = max(self._dimensions, 2)  # CMA-ES adapts a covariance: one gain gets a second coordinate
        anywhere = self._random.uniform(*_BEGIN, size)
        self._strategy = cmaes.CMA(
            mean=anywhere if self._start is None else np.array([*self._start, 0.5])[:size],
            sigma=_STEP if self._start is None else _FINE_STEP,
            bounds=np.tile([0.0, 1.0], (size, 1)),
            seed=int(self._random.integers(2**31)),
            population_size=population,
        )

    def ask(self) -> list[np.ndarray]:
        """The points of the next generation, shape (dimensions,) each; none at the end of the budget."""
        count = min(self._strategy.population_size, self._remaining)
        self._points = [self._strategy.ask() for _ in range(count)]
        return [point[: self._dimensions] for point in self._points]

    def tell(self, costs: Sequence[float]) -> None:
        """The costs of the points that were asked for last, in their order."""
        self._remaining -= len(costs)
        if len(costs) < self._strategy.population_size:  # the budget cuts the last generation short
            return
        self._strategy.tell(list(zip(self._points, costs, strict=True)))
        if self._strategy.should_stop():  # converged: the rest of the budget looks elsewhere
            self._begin(2 * self._strategy.population_size)
