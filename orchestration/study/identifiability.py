"""What the paper's eight figures determine: the study in stages.

1  points that agree with the nominal row, for each variant of what the paper does not state
2  what they predict for the buoyancy row; a random subset of them through the FMUs
3  fits to all eight figures through the FMUs, and to seven, which predict the eighth
4  a fit to one realisation of the noise that looks at nothing but the figures
5  effects that the experiment with added buoyancy would need if the gains were those that are shipped
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fmus.files import write_text_atomically
from orchestration.scenarios import scenario
from orchestration.scenarios.identify import LARGEST_OVERSHOOT_PCT
from orchestration.study import missing_effects
from orchestration.study.depth_loop_model import VARIABLES, depth_task, shipped_values
from orchestration.study.eight_figures import variables
from orchestration.study.figure_fits import (
    SHIPPED_RANGES,
    WIDE,
    fits,
    nearest_to_all,
    one_seed,
    shipped_start,
)
from orchestration.study.open_numbers import FREE, FREQUENCY, VALUES, Columns
from orchestration.study.posterior import (
    VARIANTS,
    Variant,
    by_worth,
    drawn_points,
    effective_draws,
    guide_of,
    joined,
    pilot,
    predicted,
)
from orchestration.study.posterior_summary import summary
from orchestration.study.proposal import Proposal
from orchestration.study.stages import Progress, Stages, content_key, imported_sources
from orchestration.study.vehicle_runs import SCENARIOS, SEEDS, VehicleRuns


@dataclass(frozen=True)
class Effort:
    """How much is computed.

    pilot: draws of each round of a variant's pilot
    batches: the most of a round, of `draws` points each, `extensions` of each that agrees with plain L1; no
    more of them are drawn once all points are worth `enough` draws of equal density. If they are not at its
    end, the points of a round guide another one, up to `rounds`
    start: batches of even draws, of which the fits in wide ranges begin at the best
    checked: points through the FMUs; iterations: of least squares; generations: of differential evolution
    """

    pilot: int = 6000
    rounds: int = 3
    batches: int = 20
    draws: int = 4000
    extensions: int = 10
    enough: float = 250.0
    start: int = 4
    checked: int = 60
    iterations: Mapping[str, int] = field(default_factory=lambda: {"model": 40, "FMUs": 2})
    generations: int = 11

    @property
    def stages(self) -> int:
        """How often `study` calls `progress` at most."""
        return len(VARIANTS) * (1 + self.rounds * self.batches) + self.start + 2 * (1 + len(VALUES)) + 3


FULL = Effort()


def model_key() -> str:
    """Of what the stages without FMUs follow from: the model, its draws, and what scenarios give to them."""
    source = Path(__file__)
    files = {
        source,
        source.with_name("depth_loop_model.c"),
        *imported_sources(source.with_name("posterior.py")),
    }
    tasks = [depth_task(name) for name in sorted({variant.scenario for variant in VARIANTS})]
    given = [(task.reference.tolist(), replace(task, reference=np.empty(0))) for task in tasks]
    shipped = [shipped_values()[name] for name in VARIABLES]
    return content_key(files, given, shipped, VALUES, LARGEST_OVERSHOOT_PCT)


def runs_key() -> str:
    """Of what the other stages follow from: besides, their sources, the FMUs, and figures of their runs."""
    fmus = {
        fmu for name in SCENARIOS for fmu in scenario.load(scenario.find(name)).system.components.values()
    }
    with VehicleRuns() as runs:
        figures = [runs.one(name, {}) for name in SCENARIOS]
    files = {*imported_sources(Path(__file__)), *map(Path, fmus)}
    return content_key(files, model_key(), figures, SHIPPED_RANGES, WIDE)


def study(
    folder: Path, progress: Progress = lambda name: None, effort: Effort = FULL
) -> tuple[dict[str, Any], dict[str, Columns]]:
    """The whole study as plain data, and the points of the first two variants."""
    stages = Stages(folder / "stages", model_key(), progress)
    of_runs = Stages(folder / "stages", runs_key(), progress)
    document: dict[str, Any] = {"variants": {}}
    sets: dict[str, Columns] = {}
    for index, variant in enumerate(VARIANTS):
        sets[variant.name], counts = posterior(stages, index, effort)
        document["variants"][variant.name] = counts | summary(sets[variant.name])

    def validated() -> dict[str, Any]:
        with VehicleRuns() as runs:
            return validation(runs, sets[VARIANTS[0].name], effort.checked)

    document["validation"] = of_runs.document("validation", validated)
    start = start_of_wide(stages, effort)
    document["fits"] = {
        "shipped ranges": fits(of_runs, "shipped-ranges", SHIPPED_RANGES, shipped_start(), effort.iterations),
        "wide ranges": fits(of_runs, "wide-ranges", WIDE, start, effort.iterations),
    }
    document["one_seed"] = of_runs.document("one-seed", lambda: one_seed(effort.generations))
    document["effects"] = of_runs.document("effects", effects)
    return document, {variant.name: sets[variant.name] for variant in VARIANTS[:2]}


def posterior(stages: Stages, index: int, effort: Effort) -> tuple[Columns, dict[str, Any]]:
    """The points of a variant with their figures, and how they came about."""
    variant = VARIANTS[index]
    guide = stages.arrays(f"pilot-{index}", lambda: pilot(variant, effort.pilot))
    points, runs = dict[str, np.ndarray](), int(guide.pop("runs"))
    for number in range(1, 1 + effort.rounds):
        before, proposal, of_round = points, Proposal(**guide), dict[str, np.ndarray]()
        for seed in range(100 * number + 1, 100 * number + 1 + effort.batches):  # not those of the pilot
            batch = stages.arrays(f"draws-{index}-{seed}", _batch(variant, seed, proposal, effort))
            runs += int(batch.pop("runs"))
            of_round = joined(of_round, batch)
            points = joined(before, by_worth(of_round))
            if effective_draws(points) >= effort.enough:
                break
        if effective_draws(points) >= effort.enough:
            break
        guide = guide_of(of_round)
    counts = {
        "runs": runs,
        "points": len(points["draw"]),
        "draws": len(np.unique(points["draw"])),
        "effective_draws": round(effective_draws(points), 1),
    }
    return points, counts


def _batch(variant: Variant, seed: int, proposal: Proposal, effort: Effort) -> Callable[[], Columns]:
    def compute() -> Columns:
        drawn = drawn_points(variant, seed, effort.draws, effort.extensions, proposal)
        return predicted(variant, drawn.shares, proposal) | {"runs": np.array(drawn.runs)}

    return compute


def start_of_wide(stages: Stages, effort: Effort) -> dict[str, float]:
    """Where the fits in wide ranges begin: the best of the points of some batches of even draws."""
    seeds = range(1, 1 + effort.start)
    batches = [
        stages.arrays(
            f"even-{seed}",
            lambda seed=seed: {"shares": drawn_points(VARIANTS[0], seed, 5000, 40).shares},
        )
        for seed in seeds
    ]
    return nearest_to_all(predicted(VARIANTS[0], np.concatenate([arrays["shares"] for arrays in batches])))


def validation(runs: VehicleRuns, points: Columns, count: int) -> dict[str, Any]:
    """The model against the FMUs at random points: the differences of each figure, and the spread in hold."""
    chosen = np.random.default_rng(2).permutation(len(points[FREQUENCY]))[:count]
    differences: dict[str, list[float]] = {}
    for row in chosen:
        values = variables({free.name: float(points[free.name][row]) for free in FREE})
        for name in SCENARIOS:
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


def effects() -> list[dict[str, Any]]:
    """What each effect would have to be."""
    with VehicleRuns() as runs:
        return [missing_effects.needed(runs, effect) for effect in missing_effects.EFFECTS]


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
