"""Fits to the eight figures: what is looked at, what is left out, the bound that excludes a limit cycle."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.results.recording import Recording
from orchestration.study.depth_loop_model import shipped_values
from orchestration.study.eight_figures import (
    LARGEST_SPREAD_MM,
    Search,
    fit,
    residuals,
    rounded,
    tolerance,
    variables,
)
from orchestration.study.open_numbers import BY_NAME, K_I, K_P, VALUES, Free
from orchestration.study.vehicle_runs import SCENARIOS, SEEDS, Figure, ModelRuns, VehicleRuns, hold_spread

DOCUMENT = Path(__file__).parents[3] / "docs" / "explanation" / "identification.json"

GAINS = (Free("first", "1", 1.0, 100.0, True, ""), Free("second", "1", -1.0, 1.0, False, ""))
Measured = dict[Figure, np.ndarray]


def on_target() -> Measured:
    quiet = {(name, metric): np.array([0.5]) for name in SCENARIOS for metric in ("overshoot", "hold_spread")}
    return {figure: np.array([value]) for figure, value in VALUES.items()} | quiet


@pytest.fixture(scope="module")
def runs() -> Iterator[VehicleRuns]:
    with VehicleRuns() as loaded:
        yield loaded


def test_the_eight_figures_on_target_leave_nothing() -> None:
    assert len(VALUES) == 8
    assert not residuals(on_target()).any()


@pytest.mark.parametrize("figure", VALUES)
def test_the_mean_of_a_figure_a_tolerance_away_counts_one_unless_it_is_left_out(figure: Figure) -> None:
    away = VALUES[figure] + tolerance(figure) * np.array([0.5, 1.5])
    measured = on_target() | {figure: away}
    assert np.sum(residuals(measured) ** 2) == pytest.approx(1.0)
    assert not residuals(measured, left_out=figure).any()
    other = next(known for known in VALUES if known != figure)
    assert np.sum(residuals(measured, left_out=other) ** 2) == pytest.approx(1.0)


def test_what_did_not_settle_is_far_away() -> None:
    measured = on_target() | {("nominal-l1", "settling_time"): np.array([65.0, np.nan])}
    assert residuals(measured).max() == 40.0


@pytest.mark.parametrize("name", SCENARIOS)
def test_the_largest_spread_of_the_seeds_counts_beyond_the_bound(name: str) -> None:
    spreads = np.array([0.5, LARGEST_SPREAD_MM + 0.5])
    measured = on_target() | {(name, "hold_spread"): spreads}
    assert residuals(measured).max() == pytest.approx(1.0)
    assert not residuals(measured, bounded=False).any()
    high = on_target() | {(name, "overshoot"): np.array([1.25])}
    assert residuals(high).max() == pytest.approx(1.0)
    assert not residuals(high, bounded=False).any()


def test_the_spread_is_that_of_the_hold_alone() -> None:
    time = np.arange(0.0, 310.0, 1.0)
    depth = np.where((time >= 100.0) & (time <= 140.0), 0.8 + 0.002 * (-1.0) ** time, 0.1 * time)
    recording = Recording(("plant.depth",), ("m",), time, depth[:, None])
    assert hold_spread(recording) == pytest.approx(2.0, rel=1e-3)


def test_the_model_is_near_the_runs(runs: VehicleRuns) -> None:
    """As near as the tests of the model say."""
    gains = {name: shipped_values("nominal-extended")[name] for name in (K_P, K_I)}
    near, measured = ModelRuns().figures(gains), runs.figures(gains, seeds=(1,))
    assert set(near) == set(measured)
    for figure in VALUES:
        assert near[figure] == pytest.approx(measured[figure], rel=4e-3)


class Quadratic:
    """In the place of runs: figures that are on target where the first gain is 20 and the second 0.4."""

    def figures(self, values: Mapping[str, float], seeds: Sequence[int]) -> Measured:
        away = np.log(values["first"] / 20.0), values["second"] - 0.4
        measured = on_target()
        for figure, deviation in zip(VALUES, (*away, *away), strict=False):
            measured[figure] = measured[figure] + deviation * tolerance(figure)
        return measured


def search(**options: Any) -> Search:
    return Search(Quadratic(), GAINS, **options)


def test_a_fit_finds_the_gains_and_gives_the_best_when_evaluations_run_out() -> None:
    start = {"first": 3.0, "second": -0.5}
    ended = fit(search(), GAINS, start)
    assert ended.values == pytest.approx({"first": 20.0, "second": 0.4}, rel=1e-2)
    assert ended.cost < 1e-4
    costs: list[float] = []
    cut = fit(search(evaluations=3, progress=costs.append), GAINS, start)
    assert len(costs) == 3
    assert cut.cost == min(costs) > ended.cost


@pytest.mark.parametrize("free", GAINS)
def test_a_position_is_that_of_the_value(free: Free) -> None:
    value = 0.7 if free.low < 0 else 7.0
    assert rounded(free, 1.0 + free.position(value)) == value
    assert (free.position(free.low), free.position(free.high)) == (0.0, 1.0)


def test_buoyancy_changes_where_the_name_says_so_and_seeds_differ(runs: VehicleRuns) -> None:
    more = {"plant.buoyancy_change": 0.6}
    assert runs.one("nominal-l1", more) == runs.one("nominal-l1", {})
    assert runs.one("buoyancy-l1", more)["rmse"] > runs.one("buoyancy-l1", {})["rmse"] + 0.3
    measured = runs.figures({})
    assert {column.shape for column in measured.values()} == {(len(SEEDS),)}
    assert len(set(measured["nominal-l1", "rmse"].tolist())) == len(SEEDS)


def test_the_bound_excludes_the_limit_cycle_that_one_seed_likes(runs: VehicleRuns) -> None:
    """All figures within 6 %, and a depth that swings in hold: the end of the search on the page."""
    ended = json.loads(DOCUMENT.read_text(encoding="utf-8"))["one_seed"]["seed 1"]["values"]
    measured = runs.figures(ended, seeds=(1,))
    for figure, value in VALUES.items():
        assert measured[figure][0] == pytest.approx(value, rel=0.06)
    assert measured["nominal-extended", "hold_spread"][0] > 1.5 * LARGEST_SPREAD_MM
    free, bounded = (float(np.sum(residuals(measured, bounded=bounded) ** 2)) for bounded in (False, True))
    assert bounded > 10.0 * free


def test_a_frequency_becomes_the_gain_of_the_controller() -> None:
    middle = {name: free.value(0.5) for name, free in BY_NAME.items()}
    given = variables(middle)
    assert given["controller.adaptation_gain"] > 0.0
    assert set(middle) - set(given) == {"adaptation_frequency"}
