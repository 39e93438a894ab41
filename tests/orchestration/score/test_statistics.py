"""Statistics on numbers whose results are known, or computed in another way."""

import math

import numpy as np
import pytest
from scipy import stats

from orchestration.score.statistics import compare, distribution, holm


def test_median_percentile_and_cvar_of_one_to_a_hundred() -> None:
    shuffled = np.random.default_rng(3).permutation(np.arange(1.0, 101.0))
    over_plants = distribution(shuffled.tolist())
    assert (over_plants.median, over_plants.p95, over_plants.cvar) == (
        50.0,
        95.0,
        98.0,
    )  # 98 is the mean of 96 .. 100


def test_a_plant_without_a_value_is_worse_than_any() -> None:
    over_plants = distribution([*np.arange(1.0, 99.0), math.nan, math.nan])
    assert (over_plants.median, over_plants.p95, over_plants.cvar) == (50.0, 95.0, math.inf)


def test_wilcoxon_is_exact_where_all_differences_have_one_sign() -> None:
    """10 differences of one sign: 2 of the 2^10 signs are as far from 0."""
    second = np.arange(10.0)
    comparison = compare(second + 1.0 + 0.01 * second, second)
    assert comparison.p == pytest.approx(2.0 / 2.0**10, rel=1e-12)
    assert comparison.pairs == 10
    assert comparison.median_difference == pytest.approx(1.045)
    assert 1.0 < comparison.low < comparison.median_difference < comparison.high < 1.09


def test_the_bootstrap_interval_is_about_that_of_the_order_statistics() -> None:
    """By the binomial distribution alone, that of 101 values is from the 41st to the 61st with 95 %.

    A resampled median is one of the values, so that both ends may be off by one of them.
    """
    ranks = np.arange(1.0, 102.0)
    assert [stats.binom.ppf(p, 101, 0.5) for p in (0.025, 0.975)] == [41.0, 60.0]
    comparison = compare(ranks, np.zeros(101))
    assert comparison.median_difference == 51.0
    assert (comparison.low, comparison.high) == (pytest.approx(41.0, abs=1.0), pytest.approx(61.0, abs=1.0))


def test_pairs_are_those_with_both_values() -> None:
    comparison = compare([1.0, math.nan, 3.0, 5.0], [0.0, 1.0, math.nan, 3.0])
    assert (comparison.pairs, comparison.median_difference) == (2, 1.5)
    assert math.isnan(compare([1.0], [math.nan]).p)


def test_a_controller_does_not_differ_from_itself() -> None:
    comparison = compare([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert (comparison.median_difference, comparison.low, comparison.high, comparison.p) == (
        0.0,
        0.0,
        0.0,
        1.0,
    )


def test_holm_corrects_in_steps_and_keeps_the_order() -> None:
    corrected = holm({"a": 0.01, "b": 0.04, "c": 0.03, "d": 0.005, "e": math.nan})
    assert math.isnan(corrected.pop("e"))
    assert corrected == pytest.approx({"d": 0.02, "a": 0.03, "c": 0.06, "b": 0.06})
    assert holm({"a": 0.6, "b": 0.9}) == {"a": 1.0, "b": 1.0}
