"""The search and the intervals, against what linear problems give in closed form."""

import math
from collections.abc import Iterator, Sequence

import numpy as np
import pytest

from orchestration.scenarios.free_parameter import FreeParameter
from orchestration.studies.fit.least_squares import (
    LeastSquares,
    Values,
    analysed,
    coordinate,
    correlation_time,
    values_at,
)

TIMES = np.linspace(0.0, 1.0, 200)
FREE = (
    FreeParameter("offset", start=2.0),
    FreeParameter("slope", start=-3.0),
    FreeParameter("gain", 0.1, 100.0, 5.0),
)


def line(noise: np.ndarray, free: Sequence[FreeParameter] = FREE) -> LeastSquares:
    """A search for offset 1, slope -2 and gain 4, from readings with noise."""
    readings = 1.0 - 2.0 * TIMES + 4.0 * TIMES**2 + noise

    def residuals(points: Sequence[Values]) -> Iterator[np.ndarray]:
        for p in points:
            yield p["offset"] + p["slope"] * TIMES + p["gain"] * TIMES**2 - readings

    search = LeastSquares(free, residuals, 1e-6, 500)
    return search.run(np.array([coordinate(one, one.start) for one in free]), x_scale="jac")


def test_a_linear_problem_has_the_solution_and_the_intervals_of_linear_regression() -> None:
    noise = 0.1 * np.random.default_rng(1).standard_normal(len(TIMES))
    design = np.column_stack([np.ones_like(TIMES), TIMES, TIMES**2])
    readings = 1.0 - 2.0 * TIMES + 4.0 * TIMES**2 + noise
    expected, (squares,), *_ = np.linalg.lstsq(design, readings)
    covariance = squares / (len(TIMES) - 3) * np.linalg.inv(design.T @ design)
    search = line(noise)
    # the search ends when the sum of squares changes by 1e-8 of it: values are then 1e-4 deviations away
    deviations = np.sqrt(np.diag(covariance))
    values = np.array([*values_at(FREE, search.best).values()])
    assert np.abs(values - expected).max() < 1e-3 * deviations.min()
    analysis = analysed(search, lambda residuals: [residuals])
    half = np.array([0.5 * (one.high - one.low) for one in analysis.estimates])
    # 1.972 is the quantile of Student's t for 197 readings; the logarithm of the gain bends by 3 % of 1 %
    assert half / deviations == pytest.approx(1.972 * math.sqrt(analysis.correlation_time), rel=5e-3)


def test_parameters_of_which_only_the_sum_acts_are_not_determined() -> None:
    free = (FreeParameter("a", start=3.0), FreeParameter("b", start=3.0), FreeParameter("slope", start=1.0))
    readings = 4.0 + TIMES + 0.01 * np.random.default_rng(1).standard_normal(len(TIMES))

    def residuals(points: Sequence[Values]) -> Iterator[np.ndarray]:
        for p in points:
            yield p["a"] + p["b"] + p["slope"] * TIMES - readings

    search = LeastSquares(free, residuals, 1e-6, 500).run(np.ones(3), x_scale="jac")
    analysis = analysed(search, lambda residuals: [residuals])
    assert [one.note for one in analysis.estimates] == ["not determined", "not determined", ""]
    (message,) = analysis.undetermined
    assert message.startswith("a and b: a ")
    assert "together leave the depth as it is" in message
    slope = analysis.estimates[2]
    assert slope.low < 1.0 < slope.high


@pytest.mark.parametrize(("power", "rough"), [(1.0, ()), (8.0, ("a",))])
def test_an_interval_is_rough_where_the_model_bends_over_it(power: float, rough: tuple[str, ...]) -> None:
    """Of a^8 = 1 with noise of 5 in 200 readings: the sum rises by 1.9 and 0.5 of what is predicted."""
    readings = 1.0 + 5.0 * np.random.default_rng(1).standard_normal(len(TIMES))
    readings += 1.0 - readings.mean()
    free = (FreeParameter("a", start=1.1),)

    def residuals(points: Sequence[Values]) -> Iterator[np.ndarray]:
        return (p["a"] ** power - readings for p in points)

    search = LeastSquares(free, residuals, 1e-6, 500).run(np.ones(1), x_scale="jac")
    assert analysed(search, lambda residuals: [residuals]).rough == rough


def test_a_value_at_a_limit_says_so_and_is_taken_as_given() -> None:
    free = (FREE[0], FREE[1], FreeParameter("gain", 5.0, 100.0, 6.0))
    analysis = analysed(line(np.zeros_like(TIMES), free), lambda residuals: [residuals])
    assert [one.note for one in analysis.estimates] == ["", "", "at the limit 5"]


@pytest.mark.parametrize(("low", "high", "start"), [(1.0, 5.0, 5.0), (-1.0, 5.0, 5.0), (-5.0, 1.0, -5.0)])
def test_no_step_of_the_differences_leaves_the_limits(low: float, high: float, start: float) -> None:
    """Where a limit is the start, too: values beyond it may have no meaning."""
    asked: list[float] = []
    free = (FreeParameter("a", low, high, start),)

    def residuals(points: Sequence[Values]) -> Iterator[np.ndarray]:
        for p in points:
            asked.append(p["a"])
            yield p["a"] - 0.5 * (low + high) + np.zeros(3)

    search = LeastSquares(free, residuals, 1e-3, 50)
    at = np.array([coordinate(free[0], start)])
    search.at([at])
    # a step beyond a limit would come back to it, as if nothing depended on the parameter
    size = start * np.log(high / low) if free[0].is_logarithmic else abs(start)
    assert search.jacobian(at) == pytest.approx(np.full((3, 1), size), rel=2e-3)
    assert len(asked) == 2
    assert low <= min(asked) < max(asked) <= high


@pytest.mark.parametrize("coefficient", [0.0, 0.5, 0.9])
def test_the_correlation_time_is_that_of_an_autoregressive_process(coefficient: float) -> None:
    """(1 + a) / (1 - a); 200 000 readings leave 5 %."""
    shocks = np.random.default_rng(1).standard_normal(200_000)
    series = np.empty_like(shocks)
    series[0] = shocks[0]
    for i in range(1, len(shocks)):
        series[i] = coefficient * series[i - 1] + shocks[i]
    expected = (1.0 + coefficient) / (1.0 - coefficient)
    assert correlation_time(np.split(series, 4)) == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize(("repeated", "is_trusted"), [(1, True), (40, False)])
def test_readings_worth_less_than_30_are_not_to_be_trusted(repeated: int, is_trusted: bool) -> None:
    noise = np.repeat(0.1 * np.random.default_rng(1).standard_normal(len(TIMES) // repeated), repeated)
    assert is_trusted == (not analysed(line(noise), lambda residuals: [residuals]).doubts)


def test_fitted_parameters_take_slow_noise_with_them() -> None:
    """Four fitted to 2000 readings shorten the correlation time, 39, unless they are counted.

    The median of 50 series leaves a tenth.
    """
    random, given, corrected = np.random.default_rng(1), [], []
    design = np.linalg.qr(np.vander(np.linspace(-1.0, 1.0, 2000), 4))[0]
    for _ in range(50):
        noise = random.standard_normal(2000)
        for i in range(1, len(noise)):
            noise[i] += 0.95 * noise[i - 1]
        residuals = noise - design @ (design.T @ noise)
        given.append(correlation_time([residuals]))
        corrected.append(correlation_time([residuals], 5))
    assert np.median(given) < 0.85 * 39.0
    assert np.median(corrected) == pytest.approx(39.0, rel=0.1)


def test_a_reading_that_is_repeated_counts_once() -> None:
    series = np.repeat(np.random.default_rng(1).standard_normal(50_000), 3)
    assert correlation_time([series]) == pytest.approx(3.0, rel=0.05)


def test_a_search_ends_when_its_evaluations_are_used_up_and_keeps_the_best() -> None:
    costs: list[float] = []
    search = LeastSquares(
        FREE, lambda points: [np.array([p["slope"], p["gain"], 1.0]) for p in points], 1e-6, 6
    )
    search.progress = costs.append
    search.run(np.array([coordinate(one, one.start) for one in FREE]))
    assert search.count == len(costs) == 6
    assert search.ended == "the 6 evaluations are used up"
    assert costs == sorted(costs, reverse=True)
    assert search.cost == costs[-1]
