"""The depth sensor: reproducible, bounded, quantised, late."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from plant_fmu.depth_sensor import (
    HISTORY,
    SensorParameters,
    first_sample,
    normal,
    quantise,
    reading,
    sample_when_due,
)

SENSOR = SensorParameters(sensor_noise=0.0, sensor_resolution=0.0)
# |n| of Box and Muller is at most sqrt(2 ln M_1), as the smallest uniform number is 1 / M_1
LARGEST_NOISE = math.sqrt(2.0 * math.log(2147483563.0))


def readings(sensor: SensorParameters, seed: int = 1, count: int = 200, depth: float = 1.0) -> list[float]:
    state = first_sample(sensor, 0.0, depth, seed)
    values = [reading(sensor, state, 0.0, depth)]
    for k in range(1, count):
        state = sample_when_due(sensor, state, k * sensor.sensor_period, depth)
        values.append(reading(sensor, state, k * sensor.sensor_period, depth))
    return values


def test_the_noise_is_standard_normal_and_white() -> None:
    seed_1, seed_2, values = 12345.0, 67890.0, []
    for _ in range(20000):
        n, seed_1, seed_2 = normal(seed_1, seed_2)
        values.append(n)
    # a true generator fails each of these once in a thousand seeds; this seed is fixed
    assert stats.kstest(values, "norm").pvalue > 1e-3
    correlation = np.corrcoef(values[:-1], values[1:])[0, 1]
    assert abs(correlation) < 3.3 / math.sqrt(20000)


def test_one_seed_one_sequence() -> None:
    noisy = replace(SENSOR, sensor_noise=0.01)
    assert readings(noisy, seed=7) == readings(noisy, seed=7)
    assert readings(noisy, seed=7) != readings(noisy, seed=8)


@given(
    st.integers(1, 2147483397), st.floats(0.0, 0.1), st.floats(0.0, 0.01), st.floats(-1.0, 1.0),
    st.floats(-2.0, 2.0),
)  # fmt: skip
def test_readings_stay_within_noise_and_half_a_resolution(
    seed: int, noise: float, resolution: float, bias: float, depth: float
) -> None:
    sensor = replace(SENSOR, sensor_noise=noise, sensor_resolution=resolution, sensor_bias=bias)
    bound = noise * LARGEST_NOISE + 0.5 * resolution + 1e-12
    assert all(abs(value - depth - bias) <= bound for value in readings(sensor, seed, 20, depth))


@given(st.floats(-10.0, 10.0), st.floats(1e-4, 0.1))
def test_quantisation_gives_the_nearest_multiple(value: float, resolution: float) -> None:
    quantised = quantise(value, resolution)
    assert abs(quantised - value) <= 0.5 * resolution * (1.0 + 1e-9)
    assert quantised / resolution == pytest.approx(round(quantised / resolution), abs=1e-9)
    assert quantise(value, 0.0) == value


def test_a_sample_is_held_for_a_period() -> None:
    state = first_sample(SENSOR, 0.0, 0.0, 1)
    for i in range(1, 13):
        t = 0.01 * i
        state = sample_when_due(SENSOR, state, t, t)
        assert reading(SENSOR, state, t, t) == pytest.approx(0.04 * (i // 4))


@pytest.mark.parametrize("delay", [0.04, 0.1, 0.28])
def test_a_reading_is_as_old_as_the_delay(delay: float) -> None:
    sensor = replace(SENSOR, sensor_delay=delay)
    state = first_sample(sensor, 0.0, 0.0, 1)
    for i in range(1, 400):
        t = 0.01 * i
        state = sample_when_due(sensor, state, t, t)
        if t > 1.0:
            age = t - reading(sensor, state, t, t)
            assert delay - 1e-9 <= age < delay + sensor.sensor_period
    assert delay <= (HISTORY - 1) * sensor.sensor_period


@pytest.mark.parametrize("periods", range(HISTORY))
def test_a_delay_of_whole_periods_ends_with_a_communication_step_whatever_the_rounding(periods: int) -> None:
    """Of 0.02 s, five in a period; the depth is the number of the step."""
    sensor = replace(SENSOR, sensor_period=0.1, sensor_delay=0.1 * periods)
    state, reported = first_sample(sensor, 0.0, 0.0, 1), []
    for i in range(1, 200):
        t = 0.1 / 5 * i
        state = sample_when_due(sensor, state, t, float(i))
        reported.append(reading(sensor, state, t, float(i)))
    assert reported == [5.0 * max(i // 5 - periods, 0) for i in range(1, 200)]


def test_drift_is_counted_from_the_start() -> None:
    """Of the run: it may begin at any time."""
    sensor = replace(SENSOR, sensor_drift=0.5)
    state = first_sample(sensor, 100.0, 1.0, 1)
    assert reading(sensor, state, 100.0, 1.0) == 1.0
    state = sample_when_due(sensor, state, 100.04, 1.0)
    assert reading(sensor, state, 100.04, 1.0) == pytest.approx(1.0 + 0.5 * 0.04)


def test_a_bias_is_added_before_quantisation() -> None:
    sensor = replace(SENSOR, sensor_bias=0.04, sensor_resolution=0.1)
    assert readings(sensor, count=1, depth=1.0) == pytest.approx([1.0])
    assert readings(sensor, count=1, depth=1.02) == pytest.approx([1.1])


def test_an_ideal_sensor_reports_the_depth_itself() -> None:
    sensor = replace(SENSOR, sensor_ideal=True, sensor_noise=1.0, sensor_delay=0.1)
    state = first_sample(sensor, 0.0, 0.0, 1)
    assert reading(sensor, state, 0.013, 0.7) == 0.7
