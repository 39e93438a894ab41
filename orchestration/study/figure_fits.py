"""The fits of the study: to all eight figures, to each seven of them, and to one realisation of the noise."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from orchestration.scenarios import identify
from orchestration.study.depth_loop_model import shipped_values
from orchestration.study.eight_figures import Fit, Search, fit, residuals, tolerance
from orchestration.study.open_numbers import BY_NAME, FREE, VALUES, Columns, Free
from orchestration.study.stages import Stages
from orchestration.study.vehicle_runs import SEEDS, Figure, ModelRuns, Runs, VehicleRuns

DAMPING = tuple(BY_NAME[f"plant.{kind}_damping"] for kind in ("linear", "quadratic"))
SHIPPED_RANGES = (*DAMPING, *(Free(g.name, g.unit, g.low, g.high, True, g.reason) for g in identify.GAINS))
WIDE = tuple(free for free in FREE if free.name not in ("plant.net_weight", "plant.buoyancy_change"))
_RATE_FEEDBACK = "controller.rate_feedback_gain"
FAST_RATE_FEEDBACK = tuple(
    replace(free, low=40.0, high=60.0) if free.name == _RATE_FEEDBACK else free for free in SHIPPED_RANGES
)
"""With a rate feedback that the observer is too slow for: 8 to 11 rad/s, against its 8 rad/s."""


def shipped_start() -> dict[str, float]:
    """The shipped gains and damping."""
    shipped = shipped_values("nominal-extended")
    return {free.name: shipped[free.name] for free in SHIPPED_RANGES}


def nearest_to_all(points: Columns) -> dict[str, float]:
    """The point whose eight figures are nearest to the published ones, in tolerances."""
    deviations = [(points[" ".join(figure)] - value) / tolerance(figure) for figure, value in VALUES.items()]
    row = int(np.argmin(np.nan_to_num(np.sum(np.square(deviations), axis=0), nan=np.inf)))
    return {free.name: float(points[free.name][row]) for free in WIDE}


def fits(
    stages: Stages,
    name: str,
    free: tuple[Free, ...],
    start: Mapping[str, float],
    iterations: Mapping[str, int],
) -> dict[str, Any]:
    """A fit to all eight figures, and to each seven of them; the others begin where the first ended.

    iterations: of least squares, by the model first, then by the FMUs
    """

    def fitted(left_out: Figure | None, begin: Mapping[str, float]) -> dict[str, Any]:
        def best_fit(runs: Runs, count: int, begin: Mapping[str, float]) -> Fit:
            search = Search(runs, free, left_out=left_out, evaluations=count * (1 + len(free)))
            return fit(search, free, begin)

        model_fit = best_fit(ModelRuns(), iterations["model"], begin)
        with VehicleRuns() as runs:
            return fit_document(best_fit(runs, iterations["FMUs"], model_fit.values))

    fit_to_all = stages.document(f"fit-{name}", lambda: fitted(None, start))
    others = {
        " ".join(figure): stages.document(
            f"fit-{name}-without-{'-'.join(figure)}",
            lambda figure=figure: fitted(figure, fit_to_all["values"]),
        )
        for figure in VALUES
    }
    return {"all": fit_to_all, "left_out": others}


def fit_document(fit: Fit) -> dict[str, Any]:
    """A fit as plain data: the mean and the range of each figure over the seeds."""
    return {
        "values": fit.values,
        "cost": float(f"{fit.cost:.4g}"),
        "figures": {
            " ".join(figure): [float(f"{x:.5g}") for x in (np.mean(v), np.min(v), np.max(v))]
            for figure, v in fit.measured.items()
        },
    }


def one_seed(generations: int, population: int = 10) -> dict[str, Any]:
    """A search that looks at the figures of one seed alone: its end with that seed, and with five.

    generations, population: of differential evolution, the latter a free number
    """
    from scipy.optimize import differential_evolution  # takes a second to import

    with VehicleRuns() as runs:
        count = (1 + generations) * population * len(FAST_RATE_FEEDBACK)
        search = Search(runs, FAST_RATE_FEEDBACK, seeds=(1,), bounded=False, evaluations=count)

        def cost(scaled: np.ndarray) -> float:
            return 0.5 * float(np.sum(search(scaled) ** 2))

        limits = [(1.0, 2.0)] * len(FAST_RATE_FEEDBACK)
        differential_evolution(cost, limits, popsize=population, maxiter=generations, polish=False, rng=1)
        values = search.best.values
        measured = {"seed 1": search.best.measured, "five seeds": runs.figures(values, SEEDS)}
    return {name: fit_document(Fit(values, figures, _cost(figures))) for name, figures in measured.items()}


def _cost(measured: Mapping[Figure, np.ndarray]) -> float:
    """Half the sum of squares of the eight figures alone."""
    return 0.5 * float(np.sum(residuals(measured, bounded=False) ** 2))
