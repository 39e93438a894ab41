"""Waves against linear theory, and seas against their spectrum."""

import math
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import kstest

from fmus.block.instance import BlockError
from fmus.generate import builder
from plant_fmu import depth_sensor, waves
from plant_fmu.heave import GRAVITY
from plant_fmu.wave_source import BLOCK as SOURCE
from plant_fmu.wave_source import WaveKind

A, PERIOD, PHASE = 0.2, 5.0, 0.4
W = 2.0 * math.pi / PERIOD
K = W * W / 9.81
SEA: dict[str, Any] = {"kind": WaveKind.JONSWAP, "significant_height": 0.4, "period": 5.0}


def jonswap_sea(
    height: float, period: float, gamma: float, seed: int, has_rayleigh_amplitudes: bool = False
) -> waves.Components:
    return waves.jonswap_sea(height, period, gamma, seed, has_rayleigh_amplitudes)


def variance(sea: waves.Components) -> float:
    """Variance of the elevation over an infinite time."""
    return 0.5 * sum(a * a for a in sea.amplitude)


@pytest.mark.parametrize("t", [0.0, 1.3, 777.7])
@pytest.mark.parametrize("depth", [0.0, 1.0, 7.0])
def test_a_regular_wave_is_that_of_linear_theory(driver: Any, t: float, depth: float) -> None:
    """Elevation up, velocity and acceleration down, pressure under a crest positive: Bernoulli's linear p."""
    values = {"wave_amplitude": A, "period": PERIOD, "start_phase": PHASE, "depth": depth}
    source = driver(SOURCE, **values).begin(t)
    decayed, angle = A * math.exp(-K * depth), W * t + PHASE
    assert source["elevation"] == pytest.approx(A * math.cos(angle), abs=1e-12)
    assert source["wave_velocity"] == pytest.approx(decayed * W * math.sin(angle), abs=1e-12)
    assert source["wave_acceleration"] == pytest.approx(decayed * W * W * math.cos(angle), abs=1e-12)
    assert source["wave_pressure_head"] == pytest.approx(decayed * math.cos(angle), abs=1e-12)


def test_the_surface_moves_as_the_water_at_it() -> None:
    """The kinematic condition: the elevation, positive up, rises by the velocity, positive down."""
    sea, dt = jonswap_sea(0.4, 5.0, 3.3, 1), 1e-5
    for t in (0.0, 3.0, 100.0):
        before, after = (waves.water_motion(t + s, 0.0, sea).elevation for s in (-dt, dt))
        # central differences leave w^3 dt^2 / 6 of the amplitude, and rounding 1e-16 m / 1e-5 s
        assert -waves.water_motion(t, 0.0, sea).wave_velocity == pytest.approx(
            (after - before) / (2 * dt), abs=1e-8
        )


@given(st.floats(0.0, 1e4), st.floats(-1.0, 20.0), st.integers(1, 1000))
def test_the_acceleration_is_the_derivative_of_the_velocity(t: float, depth: float, seed: int) -> None:
    sea, dt = jonswap_sea(0.4, 5.0, 3.3, seed), 1e-4
    before, after = (waves.water_motion(t + s, depth, sea).wave_velocity for s in (-dt, dt))
    # w^4 dt^2 / 6 of 0.1 m at most, w = 5 rad/s; and a time of 1e4 s has 2e-12 s of rounding, over 2e-4 s
    assert waves.water_motion(t, depth, sea).wave_acceleration == pytest.approx(
        (after - before) / (2 * dt), abs=3e-7
    )


def test_every_component_has_the_wave_number_of_deep_water_and_decays_by_it() -> None:
    sea = jonswap_sea(0.4, 5.0, 3.3, 1)
    assert sea.wave_number == pytest.approx([w * w / GRAVITY for w in sea.angular_frequency])
    for i in range(waves.COMPONENTS):
        a, k = sea.amplitude[i], sea.wave_number[i]
        one = waves.Components((a,), (sea.angular_frequency[i],), (k,), (0.0,))
        heads = [waves.water_motion(0.0, z, one, 1).wave_pressure_head for z in (1.0, 1.5)]
        assert heads == pytest.approx([a * math.exp(-k), a * math.exp(-1.5 * k)])


@pytest.mark.parametrize("kind", list(WaveKind))
def test_far_below_nothing_is_left(driver: Any, kind: WaveKind) -> None:
    """At k z = 3 of the longest component each is e^-3 of itself at the surface, or less."""
    source = driver(SOURCE, kind=kind)
    source.begin()
    longest = min(source[f"wave_number[{i + 1}]"] for i in range(waves.COMPONENTS))
    amplitudes = sum(source[f"amplitude[{i + 1}]"] for i in range(waves.COMPONENTS))
    source["depth"] = 3.0 / longest
    for _ in range(100):
        source.step(0.1)
        # a crest is at the bound itself, but for rounding
        assert abs(source["wave_pressure_head"]) <= math.exp(-3.0) * amplitudes * (1.0 + 1e-12)


def test_above_the_mean_surface_the_water_moves_as_at_it() -> None:
    sea = jonswap_sea(0.4, 5.0, 3.3, 1)
    assert waves.water_motion(2.0, -0.3, sea) == waves.water_motion(2.0, 0.0, sea)


@given(st.floats(0.01, 2.0), st.floats(3.0, 20.0), st.floats(1.0, 7.0), st.integers(1, 2147483397))
def test_every_sea_has_the_variance_of_its_significant_height(
    height: float, period: float, gamma: float, seed: int
) -> None:
    assert variance(jonswap_sea(height, period, gamma, seed)) == pytest.approx(height**2 / 16.0)


@pytest.mark.slow
def test_rayleigh_amplitudes_scatter_the_energy_of_seeds_as_records_of_one_sea() -> None:
    """Energies of components are exponential; the variance has the scatter that their shares give.

    With shares s_i of the variance in fixed amplitudes, a seed's variance over (H_s / 4)^2 has mean 1 and the
    variance sum s_i^2. Of 2000 seeds the mean scatters by 0.2 / sqrt(2000), and the ratio of a variance to
    its expectation by 4 %: the bounds are four times these. Significant heights scatter by half of that.
    """
    seeds = range(1, 2001)
    fixed = np.array([jonswap_sea(0.4, 5.0, 3.3, seed).amplitude for seed in seeds])
    drawn = np.array([jonswap_sea(0.4, 5.0, 3.3, seed, True).amplitude for seed in seeds])
    assert kstest(((drawn / fixed) ** 2).ravel(), "expon").pvalue > 1e-3
    shares, ratios = fixed**2 / 0.02, (drawn**2).sum(axis=1) / 0.02
    expected = (shares**2).sum(axis=1).mean()
    assert ratios.mean() == pytest.approx(1.0, abs=4.0 * math.sqrt(expected / 2000.0))
    assert ratios.var() == pytest.approx(expected, rel=0.16)
    assert math.sqrt(expected) == pytest.approx(0.2, abs=0.01)  # as the guide says
    # amplitudes of neighbours, and of one component in consecutive seeds, are independent
    energies = (drawn / fixed) ** 2 - 1.0
    for one, other in ((energies[:, :-1], energies[:, 1:]), (energies[:-1], energies[1:])):
        assert abs((one * other).mean()) < 4.0 / math.sqrt(one.size)


def test_rayleigh_amplitudes_leave_phases_and_frequencies(driver: Any) -> None:
    fixed, drawn = (driver(SOURCE, **SEA, rayleigh_amplitudes=is_drawn).begin() for is_drawn in (False, True))
    for i in range(1, waves.COMPONENTS + 1):
        for name in ("phase", "angular_frequency"):
            assert fixed[f"{name}[{i}]"] == drawn[f"{name}[{i}]"]
        assert fixed[f"amplitude[{i}]"] != drawn[f"amplitude[{i}]"]


def test_a_long_record_has_the_variance_of_the_sea(driver: Any) -> None:
    """An hour is 720 peak periods. What the products of components leave scatters by 0.8 % over 40 seeds."""
    for seed in range(1, 11):
        sea, times = jonswap_sea(0.4, 5.0, 3.3, seed), np.arange(0.0, 3600.0, 0.5)
        angles = np.outer(times, sea.angular_frequency) + np.array(sea.phase)
        elevation = np.cos(angles) @ np.array(sea.amplitude)
        assert elevation.var() == pytest.approx(0.01, rel=0.05)  # six times the scatter


@pytest.mark.parametrize("gamma", [1.0, 3.3, 7.0])
def test_seas_have_the_jonswap_spectrum(gamma: float) -> None:
    """Shares of the variance in four bands, in the mean of 400 seeds.

    Of one seed a share scatters by 0.022 at most (measured), so the mean of 400 by 0.0011.
    """

    def density(x: float) -> float:
        width = 0.07 if x <= 1.0 else 0.09
        return x**-5 * math.exp(-1.25 * x**-4) * gamma ** math.exp(-((x - 1.0) ** 2) / (2.0 * width**2))

    edges = [0.5, 0.9, 1.1, 1.5, 4.0]
    exact = np.array([quad(density, a, b, points=[1.0])[0] for a, b in pairwise(edges)])
    shares = np.zeros(4)
    for seed in range(1, 401):
        sea = jonswap_sea(0.4, 5.0, gamma, seed)
        ratios = np.array(sea.angular_frequency) / W
        energy, _ = np.histogram(ratios, edges, weights=np.square(sea.amplitude))
        shares += energy / energy.sum() / 400.0
    np.testing.assert_allclose(shares, exact / exact.sum(), rtol=0.0, atol=0.004)


def test_a_seed_is_one_sea_and_another_seed_another() -> None:
    seas = [jonswap_sea(0.4, 5.0, 3.3, seed) for seed in (1, 1, 2, 3)]
    assert seas[0] == seas[1]
    assert len({sea.phase for sea in seas}) == 3
    phases = np.array([jonswap_sea(0.4, 5.0, 3.3, seed).phase for seed in range(1, 201)])
    # uniform on the circle: the mean direction of 6400 phases has the length 1 / sqrt(6400), four times that
    assert abs(np.exp(1j * phases).mean()) < 0.05
    assert phases.min() >= 0.0
    assert phases.max() <= 2.0 * math.pi


def test_a_sea_has_other_numbers_than_the_sensor_of_the_same_seed() -> None:
    """Else its first phases would be made of the numbers of the sensor's first noise."""
    _, *seeds = depth_sensor.uniform(*depth_sensor.scrambled(1))
    v, *_ = depth_sensor.uniform(*seeds)
    assert abs(jonswap_sea(0.4, 5.0, 3.3, 1).phase[0] - 2.0 * math.pi * v) > 1e-6


def test_force_and_pressure_belong_together(driver: Any) -> None:
    """On the vehicle of the paper 0.113 m of apparent depth go with each newton at 0.2 Hz, at any depth."""
    plant = builder.load_block("RovDepthPlant")
    source = driver(SOURCE, period=5.0, wave_amplitude=0.1323, depth=1.0).begin()
    deep = driver(plant, initial_depth=5.0, net_weight=-1.2, **{"thruster_ideal": True})
    deep["wave_acceleration"] = source["wave_acceleration"]
    deep["external_force"] = 1.2  # trim
    deep.begin().step(1e-4)
    force = deep["heave_velocity"] / 1e-4 * 5.5
    assert force == pytest.approx(1.0, rel=2e-3)
    assert source["wave_pressure_head"] / force == pytest.approx(0.1126, rel=1e-3)


@pytest.mark.parametrize(
    "values", [{"wave_amplitude": 2.8}, {"kind": WaveKind.JONSWAP, "significant_height": 5.6}]
)
def test_a_wave_that_would_break_is_refused(driver: Any, values: dict[str, Any]) -> None:
    """39 m long, 5.54 m high at most."""
    with pytest.raises(BlockError, match=r"0\.142 g period"):
        driver(SOURCE, **values).begin()
    driver(SOURCE, **{name: x if name == "kind" else 0.98 * x for name, x in values.items()}).begin()
