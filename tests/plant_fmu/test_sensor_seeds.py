"""Seeds give independent noise, consecutive ones too: Monte Carlo runs draw 1, 2, 3 ..."""

import math

import numpy as np
import pytest

from plant_fmu.depth_sensor import (
    SensorParameters,
    first_sample,
    normal,
    reading,
    sample_when_due,
    scrambled,
    uniform,
)

SEEDS, SAMPLES, DISTANCES = 1000, 40, 50
# The largest of 50 standard normal numbers is above 4.8 once in 12,000 generators,
# the largest of 2,000 above 5.5 once in 13,000
OF_ALL_DISTANCES, OF_ALL_TIMES = 4.8, 5.5


@pytest.fixture(scope="module")
def noise() -> np.ndarray:
    """The first samples of consecutive seeds: shape (seeds, samples)."""
    values = np.empty((SEEDS, SAMPLES))
    for i in range(SEEDS):
        seed_1, seed_2 = scrambled(i + 1)
        for k in range(SAMPLES):
            values[i, k], seed_1, seed_2 = normal(seed_1, seed_2)
    return values


def test_consecutive_seeds_are_not_correlated(noise: np.ndarray) -> None:
    """The product of two independent standard normal numbers has mean 0 and variance 1."""
    for distance in range(1, DISTANCES + 1):
        products = noise[distance:] * noise[:-distance]
        assert abs(products.mean()) < OF_ALL_DISTANCES / math.sqrt(products.size), distance
        at_equal_times = np.abs(products.mean(axis=0)).max()
        assert at_equal_times < OF_ALL_TIMES / math.sqrt(len(products)), distance


def test_each_sample_is_standard_normal_over_the_seeds(noise: np.ndarray) -> None:
    bound = 4.5  # of 40 means once in 3,700 generators; the variance of n^2 is 2
    assert np.abs(noise.mean(axis=0)).max() < bound / math.sqrt(SEEDS)
    assert np.abs((noise**2).mean(axis=0) - 1.0).max() < bound * math.sqrt(2.0 / SEEDS)


def test_the_noise_of_a_sensor_is_that_of_its_scrambled_seed() -> None:
    sensor = SensorParameters(sensor_noise=0.01, sensor_resolution=0.0)
    first, *following = scrambled(7)
    n, *following = normal(first, *following)
    state = first_sample(sensor, 0.0, 1.0, 7)
    assert reading(sensor, state, 0.0, 1.0) == 1.0 + 0.01 * n
    n, *following = normal(*following)
    state = sample_when_due(sensor, state, 0.04, 1.0)
    assert reading(sensor, state, 0.04, 1.0) == 1.0 + 0.01 * n


@pytest.mark.parametrize("seed", [1, 2, 65536, 2147483397])
def test_a_scrambled_seed_is_one_of_the_generators(seed: int) -> None:
    """L'Ecuyer's components need whole numbers in 1..m - 1."""
    for value, modulus in zip(scrambled(seed), (2147483563, 2147483399), strict=True):
        assert value == int(value)
        assert 1 <= value < modulus


def test_no_two_seeds_share_a_state() -> None:
    assert len({scrambled(seed) for seed in range(1, 20001)}) == 20000


@pytest.mark.parametrize(("difference", "number"), [(0, 2147483562), (1, 1), (2, 2)])
def test_two_equal_components_give_the_largest_uniform_number(difference: int, number: int) -> None:
    """L'Ecuyer's rule for a difference of 0, which the logarithm could not take."""
    following = 5 + difference, 5
    seed_1, seed_2 = (
        float(component * pow(a, -1, m) % m)
        for component, a, m in zip(following, (40014, 40692), (2147483563, 2147483399), strict=True)
    )
    assert uniform(seed_1, seed_2) == (number / 2147483563.0, *following)


@pytest.mark.parametrize("seed", [1, 7, 65535, 65536, 2147483397])
def test_the_noise_of_a_seed_is_that_of_integer_arithmetic(seed: int) -> None:
    """A Feistel network over halves of 16 bits, L'Ecuyer's two generators, Box and Muller: on any machine."""
    high, low, components = seed >> 16, seed & 0xFFFF, []
    for modulus in (2147483563, 2147483399):
        for i in range(4):
            high, low = low, high + ((low + 40503 + i) ** 2 >> 8) & 0xFFFF
        components.append(((high << 16) + low) % (modulus - 1) + 1)
    assert scrambled(seed) == tuple(components)
    uniforms, (one, two) = [], components
    for _ in range(2):
        one, two = 40014 * one % 2147483563, 40692 * two % 2147483399
        uniforms.append(((one - two) % 2147483562 or 2147483562) / 2147483563)
    expected = math.sqrt(-2.0 * math.log(uniforms[0])) * math.cos(2.0 * math.pi * uniforms[1])
    assert normal(*map(float, components)) == (expected, one, two)
