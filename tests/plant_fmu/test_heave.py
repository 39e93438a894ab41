"""The vehicle's dynamics against analytic solutions."""

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.block.instance import BlockError
from plant_fmu import heave
from plant_fmu.depth_plant import BLOCK as PLANT

IDEAL = {"thruster_ideal": True, "sensor_ideal": True}
LONG = {"internal_step": 0.04}  # s, the longest that the sensor allows: a time constant is 0.1 s or more


def test_it_floats_five_and_a_half_millimetres_out_of_the_water(driver: Any) -> None:
    """W - B = -1.2 N over 218 N/m of waterplane."""
    plant = driver(PLANT, **LONG).begin()
    plant.step(1.0, count=100)
    assert plant["depth"] == pytest.approx(-1.2 / (1000.0 * 9.81 * 0.152 * 0.146), rel=1e-3)


def test_it_sinks_at_the_terminal_velocity_of_its_damping(driver: Any) -> None:
    plant = driver(PLANT, initial_depth=1.0, net_weight=2.0, **IDEAL, **LONG).begin()
    plant.step(1.0, count=60)
    w = plant["heave_velocity"]
    assert 2.5 * w + 7.0 * w * w == pytest.approx(2.0, rel=1e-9)


def test_the_linear_response_to_a_force_is_exponential(driver: Any) -> None:
    plant = driver(PLANT, initial_depth=1.0, net_weight=0.0, quadratic_damping=0.0, **IDEAL).begin()
    plant["external_force"] = 1.0
    plant.step(0.02, count=100)
    rate = 2.5 / 5.5
    velocity = (1.0 - math.exp(-rate * 2.0)) / 2.5
    assert plant["heave_velocity"] == pytest.approx(velocity, rel=1e-9)  # RK4 at h rate = 0.009
    assert plant["depth"] == pytest.approx(1.0 + 2.0 / 2.5 - velocity / rate, rel=1e-9)


@pytest.mark.parametrize(("current", "wave"), [(-0.2, 0.0), (-0.2, 0.5)])
def test_current_and_waves_carry_a_neutral_vehicle_along_its_tilted_axis(
    driver: Any, current: float, wave: float
) -> None:
    """Drag is that of the motion through both: w = J (v_c + v_w), and z' = J w."""
    water = {"current_velocity": current, "wave_velocity": wave, "roll": 0.4, "pitch": -0.3}
    neutral: dict[str, Any] = {"free_surface": False, "net_weight": 0.0} | IDEAL | LONG
    plant = driver(PLANT, **water, **neutral).begin()
    plant.step(1.0, count=100)
    j = math.cos(0.4) * math.cos(0.3)
    assert plant["heave_velocity"] == pytest.approx((current + wave) * j, rel=1e-6)
    assert plant["depth_rate"] == pytest.approx((current + wave) * j * j, rel=1e-6)


@pytest.mark.parametrize(
    ("name", "largest", "beyond", "message"),
    [
        ("net_weight", 29.42, 29.43, "net_weight below weight"),
        ("internal_step", 0.04, 0.05, "internal_step at most sensor_period"),
        ("sensor_delay", 0.28, 0.3, "sensor_delay at most 7 times sensor_period"),
    ],
)
def test_a_vehicle_without_buoyancy_and_steps_beyond_the_sensors_are_refused(
    driver: Any, name: str, largest: float, beyond: float, message: str
) -> None:
    given = {"weight": 29.43, "sensor_period": 0.04}
    driver(PLANT, **given, **{name: largest}).begin()
    with pytest.raises(BlockError, match=message):
        driver(PLANT, **given, **{name: beyond}).begin()


def test_buoyancy_falls_by_the_weight_of_the_water_displaced(driver: Any) -> None:
    """Half out of the water: the spring of a vertical-sided body."""
    lost = 1000.0 * 9.81 * 0.022192 * 0.05
    assert heave.buoyancy(-0.05, 30.0, 1000.0, 0.022192) == pytest.approx(30.0 - lost)
    assert heave.buoyancy(0.05, 30.0, 1000.0, 0.022192) == 30.0
    assert heave.buoyancy(-5.0, 30.0, 1000.0, 0.022192) == pytest.approx(0.0, abs=1e-12)
    plant = driver(PLANT, initial_depth=-0.05, **IDEAL).begin().step(1e-4)
    restoring = 29.43 - (30.63 - lost)
    assert plant["heave_velocity"] == pytest.approx(restoring / 5.5 * 1e-4, rel=1e-3)


def test_a_change_of_buoyancy_lifts(driver: Any) -> None:
    plant = driver(PLANT, initial_depth=1.0, buoyancy_change=0.2, **IDEAL).begin().step(0.001)
    assert plant["heave_velocity"] == pytest.approx(-1.4 / 5.5 * 0.001, rel=1e-3)


@given(st.floats(-10.0, 10.0))
def test_buoyancy_is_never_negative_and_never_above_submerged(z: float) -> None:
    assert 0.0 <= heave.buoyancy(z, 30.0, 1000.0, 0.022) <= 30.0


def test_without_a_free_surface_buoyancy_stays(driver: Any) -> None:
    plant = driver(PLANT, initial_depth=-1.0, free_surface=False, **IDEAL).begin().step(0.001)
    assert plant["heave_velocity"] < 0.0


def test_waves_push_on_the_displaced_water_and_the_added_mass(driver: Any) -> None:
    """rho V + A = M_z - (W - B) / g: 5.5 kg and 1.2 N / g; along the tilted axis J of it, and the thrust."""
    assert heave.wave_force(2.0, 5.5, -1.2) == pytest.approx(2.0 * (5.5 + 1.2 / 9.81))
    tilted = {"initial_depth": 1.0, "roll": 0.4, "pitch": -0.3, "wave_acceleration": 0.5}
    plant = driver(PLANT, **tilted, **{"voltage[1]": 4.0, "voltage[2]": 4.0}, **IDEAL).begin()
    plant.step(0.001)
    j = math.cos(0.4) * math.cos(0.3)
    expected = (2.0 + (0.5 * (5.5 + 1.2 / 9.81) - 1.2) * j) / 5.5 * 0.001
    assert plant["heave_velocity"] == pytest.approx(expected, rel=1e-3)
    assert plant["depth_rate"] == pytest.approx(j * plant["heave_velocity"])


def test_a_vehicle_that_has_emerged_displaces_no_water_for_waves_to_push(driver: Any) -> None:
    """Out of the water rho V is 0: what is left is the added mass M_z - W / g."""
    plant = driver(PLANT, initial_depth=-1.0, wave_acceleration=0.5, **IDEAL).begin().step(0.001)
    expected = (0.5 * (5.5 - 29.43 / 9.81) + 29.43) / 5.5 * 0.001
    assert plant["heave_velocity"] == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("ideal", [True, False])
def test_the_sensor_reads_the_pressure_of_waves_as_depth(driver: Any, ideal: bool) -> None:
    exact = {"sensor_ideal": ideal, "sensor_noise": 0.0, "sensor_resolution": 0.0, "inertia": 1e6}
    plant = driver(PLANT, initial_depth=1.0, wave_pressure_head=0.1, **exact).begin()
    assert plant["measured_depth"] == pytest.approx(1.1, abs=1e-12)
    plant["wave_pressure_head"] = -0.2
    plant.step(0.04)
    assert plant["depth"] == pytest.approx(1.0, abs=1e-8)  # 1.2 N on 1e6 kg
    assert plant["measured_depth"] == pytest.approx(0.8, abs=1e-8)
