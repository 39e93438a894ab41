"""Vehicles in heave and pitch against RovDepthPlant, closed forms and energy."""

import math
from typing import Any

import numpy as np
import pytest

from fmus.block.instance import BlockError
from plant_fmu.depth_plant import BLOCK as HEAVE
from plant_fmu.heave_pitch import depth_at, righting_moment, thrust_moment, vertical_thrust
from plant_fmu.heave_pitch_plant import BLOCK as PLANT

WEIGHT, HEIGHT, INERTIA = 29.43, 0.005, 0.026
STIFFNESS = WEIGHT * HEIGHT  # N.m/rad
FREQUENCY = math.sqrt(STIFFNESS / INERTIA)  # rad/s
# deep, neutral, no drag of pitch and no sensor in between
FREE = {"initial_depth": 5.0, "net_weight": 0.0, "sensor_ideal": True}
LONG = {"internal_step": 0.04}  # s, the longest that the sensor allows: a swing takes 2.6 s
UNDAMPED = {"pitch_linear_damping": 0.0, "pitch_quadratic_damping": 0.0}


@pytest.mark.parametrize("tabulated", [False, True])
def test_with_equal_thrusters_it_heaves_as_rov_depth_plant(driver: Any, tabulated: bool) -> None:
    """Through the surface, with noise, disturbances and waves.

    1e-12 m: both add up the same forces in another order, 600 times.
    """
    equal = {"thruster_lever[1]": 0.06, "thruster_lever[2]": -0.06, "sensor_forward": 0.0}
    common = {"thruster_tabulated": tabulated, "thruster_scale[1]": 0.05, "thruster_scale[2]": 0.05}
    heave, pitch = driver(HEAVE, **common).begin(), driver(PLANT, **common, **equal).begin()
    for k in range(600):
        for plant in (heave, pitch):
            plant["voltage[1]"] = plant["voltage[2]"] = 4.0 * math.sin(0.005 * k)
            plant["external_force"], plant["current_velocity"] = 0.1 * math.sin(0.05 * k), 0.05
            plant["wave_velocity"], plant["wave_acceleration"] = 0.1 * math.sin(0.03 * k), 0.15
            plant["wave_pressure_head"] = 0.1 * math.cos(0.03 * k)
            plant.step(0.02)
        for name in ("depth", "depth_rate", "measured_depth", "total_force"):
            assert pitch[name] == pytest.approx(heave[name], abs=1e-12)
    assert pitch["pitch"] == pitch["pitch_rate"] == 0.0
    assert pitch["depth"] > 0.1


def test_a_small_oscillation_has_period_and_damping_of_the_pendulum(driver: Any) -> None:
    """theta'' + 2 zeta w theta' + w^2 theta = 0, sampled over five periods.

    1e-6 of the angle: a pendulum of 1e-3 rad is 1e-7 slower than its linear form.
    """
    damping = 0.02
    plant = driver(PLANT, initial_pitch=1e-3, pitch_quadratic_damping=0.0, internal_step=0.01, **FREE).begin()
    ratio = damping / (2.0 * INERTIA * FREQUENCY)
    damped = FREQUENCY * math.sqrt(1.0 - ratio**2)
    for k in range(1, 251):
        plant.step(0.05)
        t = 0.05 * k
        phase = math.cos(damped * t) + ratio * FREQUENCY / damped * math.sin(damped * t)
        assert plant["pitch"] == pytest.approx(1e-3 * math.exp(-ratio * FREQUENCY * t) * phase, abs=1e-9)
    assert plant["depth"] == 5.0


@pytest.mark.parametrize(("fore", "aft", "moment"), [(0.1, -0.1, 0.0), (-0.5, -0.1, 0.1)])
def test_it_rests_at_its_trim_angle_by_which_sensor_and_thrust_are_tilted(
    driver: Any, fore: float, aft: float, moment: float
) -> None:
    """sin(theta) = (M_ext - 0.06 m (F_fore - F_aft)) / (W BG), after 60 s of damping at 0.38 1/s."""
    ideal = {"thruster_ideal": True, "voltage[1]": fore / 0.25, "voltage[2]": aft / 0.25}
    place = {"sensor_forward": 0.08, "sensor_below": 0.03, "external_moment": moment}
    drag = {"linear_damping": 10.0, "quadratic_damping": 0.0}
    plant = driver(PLANT, **ideal, **place, **drag, **FREE, **LONG).begin()
    plant.step(1.0, count=60)
    pitch = math.asin((moment - 0.06 * (fore - aft)) / STIFFNESS)
    assert (plant["pitch"], plant["pitch_rate"]) == pytest.approx((pitch, 0.0), rel=1e-6, abs=1e-8)
    assert plant["total_force"] == fore + aft
    assert plant["depth_rate"] == pytest.approx((fore + aft) * math.cos(pitch) / 10.0, rel=1e-6, abs=1e-9)
    # bow up: a sensor at the bow rises, one below swings up too
    raised = 0.08 * math.sin(pitch) + 0.03 * (1.0 - math.cos(pitch))
    assert plant["measured_depth"] == pytest.approx(plant["depth"] - raised, abs=1e-8)


def test_without_damping_energy_is_kept(driver: Any) -> None:
    """Heave sinks by W - B, pitch swings by 1 rad: each keeps its own energy.

    1e-9 of the largest term: RK4 loses about (w h)^6 / 72 in a step, here 1e-12 of 2000.
    """
    undamped = {"linear_damping": 0.0, "quadratic_damping": 0.0, **UNDAMPED}
    start = {"initial_pitch": 1.0, "initial_depth": 5.0, "net_weight": 0.5, "internal_step": 0.005}
    plant = driver(PLANT, **undamped, **start).begin()
    energies = []
    for _ in range(100):
        plant.step(0.1)
        heave = 0.5 * 5.5 * plant["depth_rate"] ** 2 - 0.5 * (plant["depth"] - 5.0)
        swing = 0.5 * INERTIA * plant["pitch_rate"] ** 2 + STIFFNESS * (1.0 - math.cos(plant["pitch"]))
        energies.append((heave, swing))
    assert np.ptp(energies, axis=0) == pytest.approx(0.0, abs=1e-9)
    assert energies[0] == pytest.approx((0.0, STIFFNESS * (1.0 - math.cos(1.0))), abs=1e-9)


def test_a_thruster_at_the_stern_loses_its_thrust_when_the_bow_dives(driver: Any) -> None:
    """Ventilation is that of each thruster's own depth."""
    ventilated = {"thruster_full_depth": 0.1, "thruster_depth": 0.0, "initial_depth": 0.05}
    given = {"initial_pitch": -0.5, "voltage[1]": 4.0, "voltage[2]": 4.0, "thruster_lag[1]": 0.0}
    plant = driver(PLANT, **ventilated, **given, **{"thruster_lag[2]": 0.0}).begin()
    plant.step(1e-6)
    fore, aft = 0.05 + 0.06 * math.sin(0.5), 0.05 - 0.06 * math.sin(0.5)
    forces = [plant["thruster_force[1]"], plant["thruster_force[2]"]]
    assert forces == pytest.approx([fore / 0.1, aft / 0.1], abs=1e-6)  # 1 N each; it moves 1e-6 s


def test_the_terms_have_the_signs_of_the_conventions() -> None:
    assert thrust_moment((1.0, 0.0), (0.06, -0.06)) == -0.06  # down at the bow: bow down
    assert thrust_moment((0.0, 1.0), (0.06, -0.06)) == 0.06
    assert righting_moment(0.1, WEIGHT, HEIGHT) > 0.0
    assert vertical_thrust((1.0, 2.0), 0.0) == 3.0
    assert depth_at(1.0, 0.1, 0.08) < 1.0 < depth_at(1.0, -0.1, 0.08)
    assert depth_at(1.0, math.pi, 0.0, 0.03) == pytest.approx(0.94)


# A transfer function

T200 = {f"thruster_transfer[{i}]": v for i, v in enumerate((6136.0, 89.0, 9258.0, 108700.0), start=1)}
NO_LAG = {"thruster_lag[1]": 0.0, "thruster_lag[2]": 0.0}


def exact(t: float) -> float:
    """Returns the answer of the transfer function to a step of 1 N at a time, by its poles and residues."""
    numerator, denominator = np.poly1d([6136.0, 108700.0]), np.poly1d([1.0, 89.0, 9258.0, 108700.0])
    poles = denominator.roots
    residues = numerator(poles) / (poles * denominator.deriv()(poles))
    return 1.0 + float(np.real(np.sum(residues * np.exp(poles * t))))


def test_a_transfer_function_gives_its_step_response_to_fourth_order(driver: Any) -> None:
    """The error at 0.04 s falls by 16 where the step is halved."""
    errors = []
    for step in (0.004, 0.002, 0.001):
        plant = driver(PLANT, internal_step=step, **T200, **NO_LAG, **FREE).begin()
        plant["voltage[1]"] = 4.0  # 1 N
        errors.append(abs(plant.step(0.04)["thruster_force[1]"] - exact(0.04)))
    assert errors[0] < 2e-3  # N of 1 N, |p| h = 0.36
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert orders == pytest.approx(4.0, abs=0.3)  # the steps are not yet small beside the poles


def test_a_transfer_function_settles_at_the_force_that_is_asked_for(driver: Any) -> None:
    plant = driver(PLANT, internal_step=0.005, **T200, **NO_LAG, **FREE).begin()
    plant["voltage[2]"] = -4.0
    plant.step(0.02, count=200)  # 4 s at a slowest pole of 13.2 1/s: exp(-53)
    assert (plant["thruster_force[1]"], plant["thruster_force[2]"]) == (0.0, pytest.approx(-1.0, abs=1e-12))


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ({"internal_step": 0.02}, "internal_step at most 1 / a_2, 1 / sqrt"),
        ({"thruster_transfer[2]": 10.0}, "thruster_transfer stable: a_2 a_1 > a_0"),
        ({"thruster_transfer[2]": 0.0}, "thruster_transfer stable: a_2 a_1 > a_0"),
    ],
)
def test_a_transfer_function_that_is_unstable_or_too_fast_is_refused(
    driver: Any, given: dict[str, float], expected: str
) -> None:
    with pytest.raises(BlockError, match=expected):
        driver(PLANT, **({"internal_step": 0.005} | T200 | given)).begin()


def test_the_pitch_is_measured_with_noise_of_its_own(driver: Any) -> None:
    """2000 samples: a deviation within 5 %, three standard errors, that does not follow that of the depth."""
    plant = driver(
        PLANT, **UNDAMPED, **LONG, initial_depth=5.0, net_weight=0.0, sensor_resolution=0.0
    ).begin()
    samples = []
    for _ in range(2000):
        plant.step(0.04)
        samples.append((plant["measured_depth"] - 5.0, plant["measured_pitch"]))
    depth, pitch = np.transpose(samples)
    assert np.std(pitch) == pytest.approx(0.002, rel=0.05)
    assert abs(np.corrcoef(depth, pitch)[0, 1]) < 0.07  # three standard errors
