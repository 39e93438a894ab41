"""Every parameter and input of the plant reaches the thruster or sensor that it belongs to."""

from typing import Any

import numpy as np
import pytest

from plant_fmu.depth_plant import BLOCK as PLANT

DEEP = {"initial_depth": 5.0, "net_weight": 0.0}


def readings(driver: Any, count: int = 500, **values: Any) -> np.ndarray:
    """Depth errors of a sensor on a vehicle at rest."""
    plant = driver(PLANT, **DEEP, **values).begin()
    errors = []
    for _ in range(count):
        plant.step(0.04)
        errors.append(plant["measured_depth"] - plant["depth"])
    return np.array(errors)


@pytest.mark.parametrize(("alive", "dead"), [(1, 2), (2, 1)])
def test_each_efficiency_acts_on_its_own_thruster(driver: Any, alive: int, dead: int) -> None:
    plant = driver(PLANT, **{f"thruster_efficiency[{dead}]": 0.0, "voltage[1]": 4.0, "voltage[2]": 4.0})
    plant.begin().step(1.0)
    assert plant[f"thruster_force[{dead}]"] == 0.0
    assert plant[f"thruster_force[{alive}]"] == pytest.approx(1.0, rel=1e-6)  # after 20 time constants
    assert plant["total_force"] == plant["thruster_force[1]"] + plant["thruster_force[2]"]


@pytest.mark.parametrize("which", [1, 2])
def test_each_thruster_has_its_own_gain_dead_zone_limit_and_lag(driver: Any, which: int) -> None:
    own = {
        f"thruster_gain[{which}]": 0.5,
        f"thruster_dead_zone[{which}]": 1.0,
        f"thruster_voltage_limit[{which}]": 6.0,
        f"thruster_lag[{which}]": 0.2,
    }
    plant = driver(PLANT, **own, **{"voltage[1]": 10.0, "voltage[2]": 10.0}).begin().step(0.2)
    assert plant[f"thruster_force[{which}]"] == pytest.approx(0.5 * 5.0 * (1.0 - np.exp(-1.0)))
    assert plant[f"thruster_force[{3 - which}]"] == pytest.approx(2.5 * (1.0 - np.exp(-4.0)))


@pytest.mark.parametrize("which", [1, 2])
def test_each_thruster_has_its_own_curve_reverse_ratio_and_rate_limit(driver: Any, which: int) -> None:
    curved = {f"thruster_curvature[{which}]": 1.0, f"thruster_curve_voltage[{which}]": 6.0}
    weaker = {f"thruster_reverse_ratio[{which}]": 0.8}
    plant = driver(PLANT, **curved, **weaker, **{"voltage[1]": -3.0, "voltage[2]": -3.0}).begin().step(2.0)
    assert plant[f"thruster_force[{which}]"] == pytest.approx(-0.8 * 0.25 * 3.0 * 3.0 / 6.0)
    assert plant[f"thruster_force[{3 - which}]"] == pytest.approx(-0.75)
    limited = driver(PLANT, **{f"thruster_rate_limit[{which}]": 1.0, "voltage[1]": 8.0, "voltage[2]": 8.0})
    limited.begin().step(1.0)
    assert limited[f"thruster_force[{which}]"] == pytest.approx(1.0)
    assert limited[f"thruster_force[{3 - which}]"] == pytest.approx(2.0)


def test_thrusters_that_draw_air_push_less(driver: Any) -> None:
    """At 5 cm with propellers 3 cm below the top and full thrust from 16 cm on: half of it."""
    full = {"voltage[1]": 4.0, "voltage[2]": 4.0}
    near = {"initial_depth": 0.05, "thruster_depth": 0.03, "thruster_full_depth": 0.16}
    plant = driver(PLANT, **full, **near, inertia=1e6, **{"thruster_lag[1]": 0.0, "thruster_lag[2]": 0.0})
    plant.begin().step(0.02)
    assert plant["total_force"] == pytest.approx(1.0)
    assert plant["thruster_force[1]"] == pytest.approx(0.5)
    assert plant["heave_velocity"] == pytest.approx((1.0 - 1.2) / 1e6 * 0.02, rel=1e-6)


def test_within_a_step_ventilation_follows_the_depth(driver: Any) -> None:
    """A constant force F in proportion to the depth of the propellers: d = d_0 cosh(sqrt(F / (M d_f)) t)."""
    ideal = {"inertia": 1.0, "linear_damping": 0.0, "quadratic_damping": 0.0, "net_weight": 0.0}
    fast = {"free_surface": False, "thruster_lag[1]": 0.0, "thruster_lag[2]": 0.0}
    steps = {"internal_step": 0.25, "sensor_period": 0.25}
    air = {"thruster_depth": 0.1, "thruster_full_depth": 0.5, "voltage[1]": 4.0, "voltage[2]": 4.0}
    plant = driver(PLANT, **ideal, **fast, **steps, **air).begin().step(0.25)
    # 2 N, 1 kg and 0.5 m: 0.5 rad in a step; a step of fourth order leaves 0.5^6 / 720 = 2.2e-5 of d
    assert 0.1 + plant["depth"] == pytest.approx(0.1 * np.cosh(0.5), rel=2.5e-5)


def test_the_sensor_has_the_noise_bias_and_seed_that_were_set(driver: Any) -> None:
    fine: dict[str, Any] = {"sensor_resolution": 0.0, "sensor_noise": 0.01, "sensor_bias": 0.3}
    errors = readings(driver, **fine)
    assert errors.std() == pytest.approx(0.01, rel=0.15)  # 4.7 standard errors of 500 samples
    assert errors.mean() == pytest.approx(0.3, abs=0.002)  # 4.5 standard errors
    assert not np.array_equal(errors, readings(driver, **fine, sensor_seed=2))


def test_the_sensor_drifts_and_quantises_as_set(driver: Any) -> None:
    drifting = readings(driver, 100, sensor_noise=0.0, sensor_resolution=0.0, sensor_drift=0.01)
    assert drifting[-1] == pytest.approx(0.01 * 4.0)
    coarse = readings(driver, 10, sensor_noise=0.0, sensor_resolution=0.3)
    assert coarse == pytest.approx(0.1)  # 5.1 is the multiple of 0.3 nearest to 5
    assert readings(driver, 10, sensor_ideal=True) == pytest.approx(0.0)


def test_the_reading_is_late_by_the_delay(driver: Any) -> None:
    values: dict[str, Any] = {"sensor_noise": 0.0, "sensor_resolution": 0.0, "initial_heave_velocity": 0.1}
    still: dict[str, Any] = {"linear_damping": 0.0, "quadratic_damping": 0.0}
    errors = readings(driver, 100, sensor_delay=0.12, **values, **still)
    assert errors[-1] == pytest.approx(-0.1 * 0.12)
