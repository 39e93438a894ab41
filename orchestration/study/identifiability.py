"""What the paper's eight figures determine: the study in stages, each kept in a file when it is done.

1  points that agree with the nominal row, for each variant of what the paper does not state
2  what they predict for the buoyancy row; a random subset of them through the FMUs
3  fits to all eight figures through the FMUs, and to seven, which predict the eighth
4  a fit to one realisation of the noise that looks at nothing but the figures
5  effects that the experiment with added buoyancy would need if the gains were those that are shipped
"""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fmus.files import open_atomically, write_json_atomically, write_text_atomically
from orchestration.scenarios import identify
from orchestration.scenarios.read_layers import parameter_values
from orchestration.study import eight_figures, missing_effects
from orchestration.study.eight_figures import SEEDS, Figure, Fit, Search, VehicleRuns, residuals, variables
from orchestration.study.posterior import (
    BY_NAME,
    FREE,
    FREQUENCY,
    VALUES,
    VARIANTS,
    Columns,
    Free,
    drawn_points,
    predicted,
)

DRAWS, DRAWS_OF_THE_EXTENSION = 5000, 40  # of a batch
# more for the reading that is taken first, with which fewer draws agree
BATCHES = {variant.name: 20 if variant == VARIANTS[0] else 4 for variant in VARIANTS}
BATCHES_BEFORE_FITS = 4
CHECKED = 60  # points through the FMUs
ITERATIONS = {"model": 40, "FMUs": 2}  # of least squares: the model first, then the FMUs
FAST_RAD_PER_S, LARGE_BOUND_N = 2.0, 1.5

DAMPING = tuple(BY_NAME[f"plant.{kind}_damping"] for kind in ("linear", "quadratic"))
SHIPPED_RANGES = (*DAMPING, *(Free(g.name, g.unit, g.low, g.high, True, g.reason) for g in identify.GAINS))
WIDE = tuple(free for free in FREE if free.name not in ("plant.net_weight", "plant.buoyancy_change"))
LIMIT_CYCLE = {
    "plant.linear_damping": 1.483,
    "plant.quadratic_damping": 14.89,
    "controller.depth_feedback_gain": 4.287,
    "controller.rate_feedback_gain": 41.52,
    "controller.filter_bandwidth": 0.1985,
    "controller.proportional_gain": 8.532,
    "controller.integral_gain": 0.01096,
}
"""The end of 1700 evaluations of differential evolution that looked at the figures of seed 1 alone, with
a rate feedback of up to 60 N s/m."""

Progress = Callable[[str], None]


class Stages:
    """Results of stages in a folder: what is there is not computed again."""

    def __init__(self, folder: Path, progress: Progress = lambda name: None) -> None:
        self._folder, self._progress = folder, progress

    def arrays(self, name: str, compute: Callable[[], Mapping[str, Any]]) -> Columns:
        """Named arrays."""
        path = self._folder / f"{name}.npz"
        if not path.exists():
            computed = {key: np.asarray(value) for key, value in compute().items()}
            path.parent.mkdir(parents=True, exist_ok=True)
            with open_atomically(path) as stream:
                np.savez(stream, **computed)  # type: ignore[arg-type]
        self._progress(name)
        with np.load(path) as file:
            return dict(file)

    def document(self, name: str, compute: Callable[[], Any]) -> Any:
        """Plain data."""
        path = self._folder / f"{name}.json"
        if not path.exists():
            computed = compute()
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json_atomically(path, computed)
        self._progress(name)
        return json.loads(path.read_text(encoding="utf-8"))


def posterior(stages: Stages, index: int) -> tuple[Columns, dict[str, Any]]:
    """The points of a variant with their figures, and how they came about."""
    variant = VARIANTS[index]
    shares, runs = _drawn(stages, index, BATCHES[variant.name])
    points = stages.arrays(f"points-{index}", lambda: predicted(variant, shares))
    of_draws = np.bincount(points["draw"], weights=points["density"])
    about = {
        "runs": runs,
        "points": len(points["draw"]),
        "draws": len(of_draws),
        "effective_draws": round(float(np.sum(of_draws) ** 2 / np.sum(of_draws**2)), 1),
    }
    return points, about


def _drawn(stages: Stages, index: int, batches: int) -> tuple[np.ndarray, int]:
    """The points of so many batches of a variant, shape (points, DIMENSIONS), and the runs that they took."""

    def batch(seed: int) -> dict[str, Any]:
        points = drawn_points(VARIANTS[index], seed, DRAWS, DRAWS_OF_THE_EXTENSION)
        return {"shares": points.shares, "runs": points.runs}

    done = [
        stages.arrays(f"rejection-{index}-{seed}", lambda seed=seed: batch(seed))
        for seed in range(1, 1 + batches)
    ]
    return np.concatenate([each["shares"] for each in done]), sum(int(each["runs"]) for each in done)


def described(points: Columns) -> dict[str, Any]:
    """Least, 2.5 %, median, 97.5 % and largest of every column, and of what added buoyancy changes."""
    columns = {name: column for name, column in points.items() if name not in ("density", "draw")}
    for controller in ("l1", "extended"):
        for metric in ("settling_time", "rmse"):
            change = points[f"buoyancy-{controller} {metric}"] - points[f"nominal-{controller} {metric}"]
            columns[f"change-{controller} {metric}"] = change
    return {
        name: _five(column, points["density"])
        for name, column in columns.items()
        if not name.endswith("overshoot")
    }


def _five(column: np.ndarray, density: np.ndarray) -> list[float]:
    """Of the runs that settle; nothing if none does."""
    settled = np.isfinite(column)
    if not settled.any():
        return []
    levels = (0.0, 0.025, 0.5, 0.975, 1.0)
    quantiles = np.quantile(column[settled], levels, weights=density[settled], method="inverted_cdf")
    return [float(f"{x:.4g}") for x in quantiles]


def is_fast(points: Columns) -> np.ndarray:
    """Where adaptation is fast, as the paper describes it, and its bounds are beyond B - W."""
    large = np.minimum(points["controller.sigma_bound"], points["controller.theta_bound[1]"]) >= LARGE_BOUND_N
    return large & (points[FREQUENCY] >= FAST_RAD_PER_S)


def share_of(points: Columns, chosen: np.ndarray) -> float:
    """How much of the density the chosen points have."""
    return float(np.sum(points["density"][chosen]) / np.sum(points["density"]))


def narrowed(points: Columns) -> dict[str, float]:
    """Standard deviation of each number over that of its range, 1 where the nominal row says nothing."""
    matrix = np.cov(_positions(points), ddof=0, aweights=points["density"])
    return {free.name: round(float(np.sqrt(12.0 * matrix[i, i])), 3) for i, free in enumerate(FREE)}


def correlations(points: Columns, least: float = 0.5) -> list[tuple[str, str, float]]:
    """The pairs of numbers that depend on each other, the strongest first."""
    matrix = np.cov(_positions(points), ddof=0, aweights=points["density"])
    deviation = np.sqrt(np.diag(matrix))
    pairs = [
        (FREE[i].name, FREE[j].name, round(float(matrix[i, j] / deviation[i] / deviation[j]), 2))
        for i in range(len(FREE))
        for j in range(i)
        if abs(matrix[i, j]) >= least * deviation[i] * deviation[j]
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def _positions(points: Columns) -> np.ndarray:
    """Where the numbers lie in their ranges, 0..1; shape (numbers, points)."""
    return np.array([free.position(points[free.name]) for free in FREE])


def validation(runs: VehicleRuns, points: Columns) -> dict[str, Any]:
    """The model against the FMUs at random points: the differences of each figure, and the spread in hold."""
    chosen = np.random.default_rng(2).permutation(len(points[FREQUENCY]))[:CHECKED]
    differences: dict[str, list[float]] = {}
    for row in chosen:
        values = variables({free.name: float(points[free.name][row]) for free in FREE})
        for name in eight_figures.SCENARIOS:
            measured = runs.one(name, values)
            for metric in ("settling_time", "rmse"):
                difference = abs(measured[metric] - float(points[f"{name} {metric}"][row]))
                differences.setdefault(metric, []).append(difference)
            differences.setdefault("hold_spread", []).append(measured["hold_spread"])
    settled = {name: np.array(column)[np.isfinite(column)] for name, column in differences.items()}
    return {
        "points": len(chosen),
        **{f"{name}, median": round(float(np.median(column)), 4) for name, column in settled.items()},
        **{f"{name}, 95 %": round(float(np.quantile(column, 0.95)), 4) for name, column in settled.items()},
        "without a settling time": int(np.sum(np.isnan(differences["settling_time"]))),
    }


def fits(stages: Stages, name: str, free: tuple[Free, ...], start: Mapping[str, float]) -> dict[str, Any]:
    """A fit to all eight figures, and to each seven of them; the others begin where the first ended."""

    def fitted(left_out: Figure | None, begin: Mapping[str, float]) -> dict[str, Any]:
        def ended(runs: eight_figures.Runs, iterations: int, begin: Mapping[str, float]) -> Fit:
            search = Search(runs, free, left_out=left_out, evaluations=iterations * (1 + len(free)))
            return eight_figures.fit(search, free, begin)

        near = ended(eight_figures.ModelRuns(), ITERATIONS["model"], begin)
        with VehicleRuns() as runs:
            return fit_document(ended(runs, ITERATIONS["FMUs"], near.values))

    everything = stages.document(f"fit-{name}", lambda: fitted(None, start))
    others = {
        " ".join(figure): stages.document(
            f"fit-{name}-without-{'-'.join(figure)}",
            lambda figure=figure: fitted(figure, everything["values"]),
        )
        for figure in VALUES
    }
    return {"all": everything, "left_out": others}


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


def one_seed() -> dict[str, Any]:
    """The figures of `LIMIT_CYCLE` with the seed that it was fitted to, and with five."""
    with VehicleRuns() as runs:
        seeds = {"seed 1": (1,), "five seeds": SEEDS}
        measured = {name: runs.figures(LIMIT_CYCLE, some) for name, some in seeds.items()}
    return {
        name: fit_document(Fit(LIMIT_CYCLE, figures, _cost(figures))) for name, figures in measured.items()
    }


def _cost(measured: Mapping[Figure, np.ndarray]) -> float:
    """Half the sum of squares of the eight figures alone."""
    return 0.5 * float(np.sum(residuals(measured, bounded=False) ** 2))


def effects() -> list[dict[str, Any]]:
    """What each effect would have to be."""
    with VehicleRuns() as runs:
        return [missing_effects.needed(runs, effect) for effect in missing_effects.EFFECTS]


def shipped_values() -> dict[str, float]:
    """The shipped gains and damping."""
    path = Path(identify.__file__).parent / "parameters" / "identified.toml"
    gains = {name: float(str(value)) for name, value in parameter_values(path).items()}
    return {"plant.linear_damping": 2.5, "plant.quadratic_damping": 7.0, **gains}


def nearest_to_all(points: Columns) -> dict[str, float]:
    """The point whose eight figures are nearest to the published ones, in tolerances."""
    deviations = [
        (points[" ".join(figure)] - value) / eight_figures.tolerance(figure)
        for figure, value in VALUES.items()
    ]
    row = int(np.argmin(np.nan_to_num(np.sum(np.square(deviations), axis=0), nan=np.inf)))
    return {free.name: float(points[free.name][row]) for free in WIDE}


def start_of_wide(stages: Stages) -> dict[str, float]:
    """Where the fits in wide ranges begin: the best of the points of some batches."""
    return nearest_to_all(predicted(VARIANTS[0], _drawn(stages, 0, BATCHES_BEFORE_FITS)[0]))


def number_of_stages() -> int:
    """How often `study` calls `progress`."""
    return sum(BATCHES.values()) + len(VARIANTS) + BATCHES_BEFORE_FITS + 2 * (1 + len(VALUES)) + 3


def study(folder: Path, progress: Progress = lambda name: None) -> tuple[dict[str, Any], dict[str, Columns]]:
    """The whole study as plain data, and the points of the first two variants."""
    stages = Stages(folder / "stages", progress)
    document: dict[str, Any] = {"variants": {}}
    sets: dict[str, Columns] = {}
    for index, variant in enumerate(VARIANTS):
        sets[variant.name], about = posterior(stages, index)
        its_points = sets[variant.name]
        fast = is_fast(its_points)
        subset = {name: column[fast] for name, column in its_points.items()}
        document["variants"][variant.name] = {
            **about,
            "all": described(its_points),
            "fast_share": round(share_of(its_points, fast), 4),
            "fast": described(subset),
            "narrowed": narrowed(its_points),
            "correlations": correlations(its_points),
        }

    points = sets[VARIANTS[0].name]

    def validated() -> dict[str, Any]:
        with VehicleRuns() as runs:
            return validation(runs, points)

    document["validation"] = stages.document("validation", validated)
    document["fits"] = {
        "shipped ranges": fits(stages, "shipped-ranges", SHIPPED_RANGES, shipped_values()),
        "wide ranges": fits(stages, "wide-ranges", WIDE, start_of_wide(stages)),
    }
    document["one_seed"] = stages.document("one-seed", one_seed)
    document["effects"] = stages.document("effects", effects)
    return document, {variant.name: sets[variant.name] for variant in VARIANTS[:2]}


def write_parameters(fit: Mapping[str, Any], path: Path) -> None:
    """The parameter file of a fit to all eight figures, provenance beside each value."""
    source = (
        f"identified: least squares on all eight figures of Tables 1 and 2 of Maalouf et al. (2013), "
        f"mean of {len(SEEDS)} sensor seeds; not a published value"
    )
    values = variables(fit["values"])
    units = {free.name: free.unit for free in FREE} | {"controller.adaptation_gain": "1"}
    parameters = {
        name: {"value": float(f"{value:.4g}"), "unit": units[name], "source": source}
        for name, value in values.items()
    }
    write_text_atomically(path, tomli_w.dumps({"parameters": parameters}))
