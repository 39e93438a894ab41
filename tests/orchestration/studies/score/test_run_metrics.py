"""Metrics of a made-up run whose voltages and depth are known, and statistics over many runs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from orchestration.results.recording import Recording
from orchestration.results.statistics import (
    distribution,
    holm,
    paired,
    profile,
    proportion_interval,
    ratios_to_best,
    verdict_of,
)
from orchestration.scenarios.actuators import VOLTAGES, Actuators
from orchestration.studies.score.protocol import Protocol
from orchestration.studies.score.run_metrics import declared, failures, judged_signals, metrics_of

STEP = 0.02
TIME = STEP * np.arange(round(310.0 / STEP) + 1)
NAMES = ("reference", "depth", "one", "two")


def run(depth: np.ndarray, one: np.ndarray, two: np.ndarray) -> Recording:
    """Signals that metrics are computed of; limits 3 V and 12 V, gains 0.2 N/V and 0.3 N/V."""
    reference = np.interp(TIME, [0.0, 40.0, 140.0, 180.0, 250.0, 310.0], [0.0, 0.8, 0.8, 0.4, 0.4, 0.6])
    values = np.column_stack([reference, depth, one, two])
    recording = Recording(NAMES, ("m", "m", "V", "V"), TIME, values)
    return judged_signals(recording, NAMES, Actuators(VOLTAGES, (0.2, 0.3), ((-3.0, 3.0), (-12.0, 12.0))))


def test_u_and_power_are_of_what_the_vehicle_can_deliver() -> None:
    signals = run(np.zeros_like(TIME), np.full_like(TIME, -5.0), np.full_like(TIME, 4.0))
    assert signals["u"][0] == pytest.approx(-3.0 * 0.2 + 4.0 * 0.3)
    assert signals["power"][0] == 9.0 + 16.0
    assert signals["voltage"][0] == 5.0
    assert signals["saturated"][0] == 100.0


def test_metrics_of_a_depth_that_is_ahead_by_a_constant(protocol: Protocol) -> None:
    """z = r + 0.02 m; both voltages a square wave of 1 V and 2 V with a period of 2 s."""
    wave = 1.0 + (np.floor(TIME + 1e-9) % 2)
    reference = run(np.zeros_like(TIME), wave, wave)["reference"]
    metrics = metrics_of(run(reference + 0.02, wave, wave), declared(protocol.nominal, protocol))
    assert metrics["rmse"] == pytest.approx(2.0)
    assert metrics["peak_error"] == pytest.approx(2.0)
    assert metrics["iae"] == pytest.approx(0.02 * 310.0)
    assert metrics["ise"] == pytest.approx(0.02**2 * 310.0)
    assert metrics["itae"] == pytest.approx(0.02 * 310.0**2 / 2.0)
    assert metrics["overshoot"] == pytest.approx(2.5)
    assert metrics["settling_time"] == pytest.approx(37.0, abs=STEP)  # where r is 0.74 m
    assert metrics["total_variation"] == pytest.approx(310 * 0.5)  # a change every second; 0.5 N/V in all
    assert metrics["effort"] == pytest.approx(
        0.5 * 1.5 * 310.0, rel=1e-3
    )  # of 310 s, half a step each change
    assert metrics["energy"] == pytest.approx(2.0 * 2.5 * 310.0, rel=1e-3)
    assert metrics["peak_voltage"] == 2.0
    assert metrics["saturated"] == 0.0
    assert metrics["breach"] == 0.0
    assert failures(metrics, protocol) == []


def test_a_vehicle_that_stays_at_the_surface_failed(protocol: Protocol) -> None:
    zero = np.zeros_like(TIME)
    metrics = metrics_of(run(zero, zero, zero), declared(protocol.nominal, protocol))
    assert math.isnan(metrics["settling_time"])
    assert math.isnan(metrics["breach"])
    assert failures(metrics, protocol) == ["not settled"]


def test_overshoot_and_breach_are_failures_with_their_numbers(protocol: Protocol) -> None:
    zero = np.zeros_like(TIME)
    depth = np.where(TIME < 60.0, 0.9, np.where(TIME < 70.0, 0.0, 0.8))
    metrics = metrics_of(run(depth, zero, zero), declared(protocol.nominal, protocol))
    # 499 steps at 0 m, and what is above 0.05 m of the lines down from 0.9 m and up to 0.8 m
    assert metrics["breach"] == pytest.approx(STEP * (499 + 0.05 / 0.9 + 0.05 / 0.8))
    assert failures(metrics, protocol) == ["overshoot 12.5 %", "breach 9.98 s"]


def test_where_the_reference_does_not_move_there_is_neither_lag_nor_overshoot(protocol: Protocol) -> None:
    zero = np.zeros_like(TIME)
    holding = replace(protocol.nominal, target=replace(protocol.nominal.target, moves=False))
    names = declared(holding, protocol, ["lag", "overshoot", "rmse"])
    metrics = metrics_of(run(zero + 0.8, zero, zero), names)
    assert math.isnan(metrics["lag"])
    assert math.isnan(metrics["overshoot"])
    assert set(metrics) == {"lag", "overshoot", "rmse"}


def test_median_percentile_and_cvar_of_one_to_a_hundred() -> None:
    shuffled = np.random.default_rng(3).permutation(np.arange(1.0, 101.0))
    over_plants = distribution(shuffled.tolist())
    # 98 is the mean of 96 .. 100
    assert (over_plants.median, over_plants.p95, over_plants.cvar) == (50.0, 95.0, 98.0)


@pytest.mark.parametrize(("plants", "worst"), [(1, 1.0), (20, 20.0), (21, 20.5), (30, 29.5), (41, 40.0)])
def test_cvar_is_the_mean_of_five_percent_of_the_plants_and_no_fewer(plants: int, worst: float) -> None:
    """5 % of 21, 30 and 41 plants are 2, 2 and 3 of them."""
    assert distribution(np.arange(1.0, plants + 1.0)).cvar == worst


def test_a_plant_without_a_value_is_worse_than_any() -> None:
    over_plants = distribution([*np.arange(1.0, 99.0), math.nan, math.nan])
    assert (over_plants.median, over_plants.p95, over_plants.cvar) == (50.0, 95.0, math.inf)


def test_wilcoxon_is_exact_where_all_differences_have_one_sign() -> None:
    """10 differences of one sign: 2 of the 2^10 signs are as far from 0."""
    second = np.arange(10.0)
    comparison = paired(second + 1.0 + 0.01 * second, second)
    assert comparison.p == pytest.approx(2.0 / 2.0**10, rel=1e-12)
    assert comparison.pairs == 10
    assert comparison.median_difference == pytest.approx(1.045)


def test_the_interval_of_the_median_is_from_one_order_statistic_to_another() -> None:
    """Of 101 values from the 41st to the 61st, by the binomial distribution alone, however large the last."""
    ranks = np.array([*np.arange(1.0, 101.0), 1e6])
    comparison = paired(1000.0 + ranks, np.full(101, 1000.0))
    assert (comparison.median_difference, comparison.interval) == (51.0, (41.0, 61.0))
    tail = [stats.binom.cdf(below, 101, 0.5) for below in (40, 41)]
    assert tail[0] < 0.025 < tail[1]


def test_intervals_of_many_comparisons_are_wider_so_that_all_hold_together() -> None:
    """24 values and 100 comparisons: the 4th to the 21st, outside of which the median is with 0.03 %."""
    values = np.random.default_rng(2).permutation(np.arange(1.0, 25.0))
    alone, together = (paired(100.0 + values, np.full(24, 100.0), count) for count in (1, 100))
    assert alone.interval == (7.0, 18.0)
    assert together.interval == (4.0, 21.0)
    assert 2.0 * stats.binom.cdf(3, 24, 0.5) < 0.05 / 100 < 2.0 * stats.binom.cdf(4, 24, 0.5)
    assert together.p == alone.p


def test_six_pairs_are_the_fewest_that_have_an_interval() -> None:
    """2 of 2^6 signs are 3 %, 2 of 2^5 are 6 %: fewer pairs decide nothing."""
    six, five = (paired(np.arange(1.0, 1.0 + count), np.zeros(count)) for count in (6, 5))
    assert six.interval == (1.0, 6.0)
    assert math.isnan(five.interval[0])
    assert five.verdict == "open"


@pytest.mark.parametrize(
    ("low", "high", "verdict"),
    [
        (-0.9, 0.9, "equal"),
        (0.1, 0.9, "equal"),  # it differs from 0, and that means nothing
        (-1.0, 0.9, "open"),
        (-0.9, 1.0, "open"),
        (-2.0, 2.0, "open"),
        (0.5, 1.5, "open"),
        (-1.5, -0.5, "open"),
        (-3.0, -1.1, "lower"),
        (1.1, 3.0, "higher"),
    ],
)
def test_a_verdict_is_where_the_interval_is_on_one_side_of_the_margin(
    low: float, high: float, verdict: str
) -> None:
    assert verdict_of((low, high), 1.0) == verdict


def test_the_margin_is_five_percent_of_the_lesser_median() -> None:
    first, second = np.full(20, 4.0), np.linspace(1.0, 3.0, 20)
    assert paired(first, second).margin == paired(second, first).margin == pytest.approx(0.05 * 2.0)
    assert paired(1.04 * second, second).verdict == "equal"
    assert [paired(*pair).verdict for pair in ((first, second), (second, first))] == ["higher", "lower"]


def test_pairs_are_those_with_both_values() -> None:
    comparison = paired([1.0, math.nan, 3.0, 5.0], [0.0, 1.0, math.nan, 3.0])
    assert (comparison.pairs, comparison.median_difference) == (2, 1.5)
    assert comparison.margin == pytest.approx(0.05 * 1.5)  # of the pairs alone: 0 and 3
    assert math.isnan(paired([1.0], [math.nan]).p)


def test_a_controller_does_not_differ_from_itself() -> None:
    comparison = paired(np.arange(1.0, 9.0), np.arange(1.0, 9.0))
    assert (comparison.median_difference, comparison.interval, comparison.p) == (0, (0, 0), 1)
    assert comparison.verdict == "equal"


def test_the_interval_of_a_share_is_that_of_clopper_and_pearson() -> None:
    """None of 300: the share p at which (1 - p)^300 is 2.5 %. 3 of 300 overlap with it."""
    low, high = proportion_interval(0, 300)
    assert (low, high) == (0.0, pytest.approx(1.0 - 0.025 ** (1.0 / 300.0), rel=1e-9))
    low, high = proportion_interval(3, 300)
    assert stats.binom.sf(2, 300, low) == pytest.approx(0.025, rel=1e-6)
    assert stats.binom.cdf(3, 300, high) == pytest.approx(0.025, rel=1e-6)
    assert proportion_interval(300, 300) == (pytest.approx(0.025 ** (1.0 / 300.0), rel=1e-9), 1.0)


def test_ratios_are_to_the_best_ranked_one_of_each_problem() -> None:
    """The third is not ranked; a failed run is as far from the best as can be, and all may fail."""
    values = [[1.0, 6.0, math.nan, math.nan], [2.0, 3.0, 4.0, math.nan], [0.5, 3.0, 1.0, 2.0]]
    ratios = ratios_to_best(values, [True, True, False])
    assert ratios.tolist() == [
        [1.0, 2.0, math.inf, math.inf],
        [2.0, 1.0, 1.0, math.inf],
        [0.5, 1.0, 0.25, 0.0],
    ]


def test_a_profile_is_the_share_of_problems_within_a_factor() -> None:
    """Dolan and Moré (2002): at 1 the share of wins, at large factors that of runs that did not fail."""
    ratios = ratios_to_best([[1.0, 6.0, math.nan, 1.0], [2.0, 3.0, 4.0, 1.0]], [True, True])
    assert profile(ratios, [1.0, 1.99, 2.0, 1e9]).tolist() == [[0.5, 0.5, 0.75, 0.75], [0.75, 0.75, 1.0, 1.0]]


def test_holm_corrects_in_steps_and_keeps_the_order() -> None:
    corrected = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005, "e": math.nan})
    assert math.isnan(corrected.pop("e"))
    assert corrected == pytest.approx({"d": 0.02, "a": 0.03, "c": 0.06, "b": 0.06})
    assert holm({"a": 0.6, "b": 0.9}) == {"a": 1.0, "b": 1.0}
