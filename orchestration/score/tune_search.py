"""The gains that a tuning chooses, and one search of their least cost by CMA-ES.

Source: Hansen, "The CMA evolution strategy: a tutorial" (arXiv 1604.00772), as the library `cmaes` has it;
restarts with twice the population after Auger and Hansen (CEC 2005).
"""

from collections.abc import Iterable, Sequence

import numpy as np

from fmus.errors import nearest
from fmus.extras import require
from fmus.fmi.description import of_causality
from fmus.fmi.model_description import ModelDescription
from orchestration.errors import OrchestrationError
from orchestration.scenarios.free_parameter import FreeParameter, check_once


def with_units(gains: Iterable[FreeParameter], description: ModelDescription) -> tuple[FreeParameter, ...]:
    """Returns the gains with the units of an FMU; OrchestrationError for one that it cannot take.

    A gain is a parameter of type Real, tunable or fixed, whose declared range holds the limits.
    """
    gains, parameters = list(gains), of_causality(description, "parameter")
    known = {v.name: v for v in parameters if v.type == "Real"}
    for gain in gains:
        if gain.name not in known:
            raise OrchestrationError(
                f"--free {gain.name}: expected a parameter of type Real; {nearest(gain.name, known)}"
            )
        if not gain.is_limited:
            raise OrchestrationError(f"--free {gain.name}: expected NAME=LOW:HIGH, such as {gain.name}=1:20")
    check_once(gains)
    if not gains:
        tunable = [name for name, v in known.items() if v.variability == "tunable"]
        raise OrchestrationError(
            f"nothing to tune: expected --free NAME=LOW:HIGH; tunable are {', '.join(tunable) or 'none'}"
        )
    return tuple(gain.within(known[gain.name]) for gain in gains)


_BEGIN = (0.25, 0.75)  # of the unit cube: the first mean of a search is drawn from there
_STEP = 0.25  # first standard deviation: half of the range lies within one of the mean
_FINE_STEP = 0.05  # that of a search which begins at a point that another one has found


class EvolutionSearch:
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
        """Returns the points of the next generation, shape (dimensions,) each; none after the budget."""
        count = min(self._strategy.population_size, self._remaining)
        self._points = [self._strategy.ask() for _ in range(count)]
        return [point[: self._dimensions] for point in self._points]

    def tell(self, costs: Sequence[float]) -> None:
        """Takes the costs of the points that were asked for last, in their order."""
        self._remaining -= len(costs)
        if len(costs) < self._strategy.population_size:  # the budget cuts the last generation short
            return
        self._strategy.tell(list(zip(self._points, costs, strict=True)))
        if self._strategy.should_stop():  # converged: the rest of the budget looks elsewhere
            self._begin(2 * self._strategy.population_size)
