"""What the paper's eight figures determine: the study in stages, each kept in a file when it is done.

1  points by rejection, then a walk over the gains that agree with the nominal row, for each variant
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
    Variant,
    first_points,
)

DRAWS, DRAWS_OF_THE_EXTENSION = 5000, 40
WALKERS, STEPS_OF_A_BLOCK = 100, 50
BATCHES = 4  # of draws
# blocks of steps: more for the reading that is taken first
BLOCKS = {variant.name: 8 if variant == VARIANTS[0] else 2 for variant in VARIANTS}
BURN_IN = 1  # blocks
CHECKED = 60  # points through the FMUs
ITERATIONS = {"all": 8, "left out": 2}  # of least squares
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
    """Independent enough points of one variant with their figures, and how they came about."""
    from orchestration.study import posterior_chain as chain

    variant, runs = VARIANTS[index], 0
    known, of_rejection = rejected(stages, index)
    runs += of_rejection
    here = known[np.random.default_rng(1).permutation(len(known))[:WALKERS]]
    blocks, accepted = [], []
    for block in range(BLOCKS[variant.name]):
        walked = stages.arrays(
            f"walk-{index}-{block}",
            lambda here=here, block=block: vars(chain.walk(variant, here, STEPS_OF_A_BLOCK, block)),
        )
        here = walked["shares"][-1]
        blocks.append(walked["shares"])
        accepted.append(float(walked["accepted"]))
        runs += int(walked["runs"])
    walk = np.concatenate(blocks[BURN_IN:])
    time = float(np.max(chain.autocorrelation_time(walk)))
    every = max(1, round(0.2 * time))
    thinned = walk[every - 1 :: every].reshape(-1, walk.shape[2])
    points = stages.arrays(f"points-{index}", lambda: chain.predicted(variant, thinned))
    about = {
        "runs": runs,
        "points": len(points[FREQUENCY]),
        "independent": round(walk.shape[0] * walk.shape[1] / time),
        "steps": walk.shape[0],
        "autocorrelation_time": round(time),
        "accepted_moves": round(float(np.mean(accepted)), 3),
        "by_rejection": len(known),
    }
    return points, about


def rejected(stages: Stages, index: int) -> tuple[np.ndarray, int]:
    """The points of a variant that rejection gives, and the runs that it took."""
    variant = VARIANTS[index]
    batches = [
        stages.arrays(f"rejection-{index}-{seed}", lambda seed=seed: _rejected(variant, seed))
        for seed in range(1, 1 + BATCHES)
    ]
    return np.concatenate([batch["shares"] for batch in batches]), sum(
        int(batch["runs"]) for batch in batches
    )


def _rejected(variant: Variant, seed: int) -> dict[str, Any]:
    points = first_points(variant, seed, DRAWS, DRAWS_OF_THE_EXTENSION)
    return {"shares": points.shares, "runs": points.runs}


def described(points: Columns) -> dict[str, Any]:
    """Least, 2.5 %, median, 97.5 % and largest of every column, and of what added buoyancy changes."""
    columns = dict(points)
    for controller in ("l1", "extended"):
        for metric in ("settling_time", "rmse"):
            change = points[f"buoyancy-{controller} {metric}"] - points[f"nominal-{controller} {metric}"]
            columns[f"change-{controller} {metric}"] = change
    return {name: _five(column) for name, column in columns.items() if not name.endswith("overshoot")}


def _five(column: np.ndarray) -> list[float]:
    settled = column[np.isfinite(column)]
    if not len(settled):
        return []
    return [float(f"{x:.4g}") for x in np.quantile(settled, (0.0, 0.025, 0.5, 0.975, 1.0))]


def is_fast(points: Columns) -> np.ndarray:
    """Where adaptation is fast, as the paper describes it, and its bounds are beyond B - W."""
    large = np.minimum(points["controller.sigma_bound"], points["controller.theta_bound[1]"]) >= LARGE_BOUND_N
    return large & (points[FREQUENCY] >= FAST_RAD_PER_S)


def narrowed(points: Columns) -> dict[str, float]:
    """Standard deviation of each number over that of its range, 1 where the nominal row says nothing."""
    ratios = {}
    for free in FREE:
        column = points[free.name]
        share = np.log(column / free.low) / np.log(free.high / free.low) if free.logarithmic else None
        share = (column - free.low) / (free.high - free.low) if share is None else share
        ratios[free.name] = round(float(np.std(share) * np.sqrt(12.0)), 3)
    return ratios


def correlations(points: Columns, least: float = 0.5) -> list[tuple[str, str, float]]:
    """The pairs of numbers whose logarithms depend on each other, the strongest first."""
    logarithms = [np.log(np.abs(points[free.name])) for free in FREE]
    matrix = np.corrcoef(logarithms)
    pairs = [
        (FREE[i].name, FREE[j].name, round(float(matrix[i, j]), 2))
        for i in range(len(FREE))
        for j in range(i)
        if abs(matrix[i, j]) >= least
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[2]))


def validation(runs: VehicleRuns, points: Columns) -> dict[str, Any]:
    """The model against the FMUs at random points: the largest and the median difference of each figure."""
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
    return {
        "points": len(chosen),
        **{f"{name}, median": round(float(np.median(column)), 4) for name, column in differences.items()},
        **{f"{name}, largest": round(float(np.max(column)), 4) for name, column in differences.items()},
    }


def fits(stages: Stages, name: str, free: tuple[Free, ...], start: Mapping[str, float]) -> dict[str, Any]:
    """A fit to all eight figures, and to each seven of them; the others begin where the first ended."""

    def fitted(
        left_out: tuple[str, str] | None, begin: Mapping[str, float], iterations: int
    ) -> dict[str, Any]:
        with VehicleRuns() as runs:
            search = Search(runs, free, left_out=left_out, evaluations=iterations * (1 + len(free)))
            return fit_document(eight_figures.fit(search, free, begin))

    everything = stages.document(f"fit-{name}", lambda: fitted(None, start, ITERATIONS["all"]))
    others = {
        " ".join(figure): stages.document(
            f"fit-{name}-without-{'-'.join(figure)}",
            lambda figure=figure: fitted(figure, everything["values"], ITERATIONS["left out"]),
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
    """Where the fits in wide ranges begin: the best of the points by rejection."""
    from orchestration.study.posterior_chain import predicted

    return nearest_to_all(predicted(VARIANTS[0], rejected(stages, 0)[0]))


def number_of_stages() -> int:
    """How often `study` calls `progress`."""
    of_variants = BATCHES * len(VARIANTS) + sum(BLOCKS.values()) + len(VARIANTS)
    return of_variants + 2 * (1 + len(VALUES)) + 3 + BATCHES  # the fits read those of the first variant again


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
            "fast_share": round(float(np.mean(fast)), 4),
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
