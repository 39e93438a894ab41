"""A BlueROV2 Heavy against closed forms of its published numbers, which stand here once more."""

import math
from typing import Any

import pytest

from plant_fmu.blue_rov2_plant import BLOCK as PLANT
from plant_fmu.heave_pitch_plant import BLOCK as HEAVE_PITCH

IDEAL = {"sensor_ideal": True, "initial_depth": 5.0}
MASS, INERTIA = 13.5 + 18.68, 0.23 + 0.135
WEIGHT, BUOYANCY = 13.5 * 9.82, 1000.0 * 0.0134 * 9.82
STIFFNESS = WEIGHT * 0.01
FREQUENCY = math.sqrt(STIFFNESS / INERTIA)
KGF = 9.80665


def terminal_velocity(force: float) -> float:
    """Returns the velocity of 33 v + 190 v |v| = force."""
    size = (math.sqrt(33.0**2 + 4.0 * 190.0 * abs(force)) - 33.0) / (2.0 * 190.0)
    return math.copysign(size, force)


@pytest.mark.parametrize(
    ("voltage", "thrust"),
    [(12.0, 4 * 4.07 * KGF), (-12.0, -4 * 5.25 * KGF), (30.0, 4 * 4.07 * KGF), (0.84, 0.0), (-0.84, 0.0)],
)
def test_full_command_gives_the_published_thrust_and_its_terminal_velocity(
    driver: Any, voltage: float, thrust: float
) -> None:
    """160 N down and 206 N up; forward thrust is up. 1e-9: exp(-22), as rates are above 1 1/s."""
    plant = driver(PLANT, free_surface=False, **IDEAL).begin()
    plant["voltage[1]"] = plant["voltage[2]"] = voltage
    plant.step(0.02, count=1100)
    assert plant["total_force"] == pytest.approx(thrust, abs=1e-9)
    assert plant["depth_rate"] == pytest.approx(terminal_velocity(thrust + WEIGHT - BUOYANCY), rel=1e-9)
    assert plant["pitch"] == 0.0


def test_both_directions_are_206_n_and_160_n() -> None:
    assert round(4 * 5.25 * KGF) == 206
    assert round(4 * 4.07 * KGF) == 160


# force [kgf] from 1100 us by 40 us, forward thrust positive: Blue Robotics, T200 at 16 V, September 2019
T200 = (
    -4.07, -3.66, -2.99, -2.45, -1.94, -1.44, -1.02, -0.65, -0.32, -0.07, 0.0,
    0.08, 0.40, 0.82, 1.28, 1.82, 2.43, 3.11, 3.82, 4.65, 5.25,
)  # fmt: skip


def test_the_table_is_the_published_one_at_every_pulse(driver: Any) -> None:
    """Forward thrust is up, so 12 V are 1100 us; without a transfer function the force follows at once."""
    plant = driver(PLANT, **IDEAL, **{"thruster_transfer[4]": 0.0}).begin()
    for i, thrust in enumerate(T200):
        pulse = 1100 + 40 * i
        plant["voltage[1]"] = (1500 - pulse) * 12.0 / 400.0
        plant.step(0.005)
        # two thrusters of a pair; between two of the published pulses the table has more points
        assert plant["thruster_force[1]"] == pytest.approx(-2.0 * thrust * KGF, abs=1e-9), pulse


def test_it_holds_its_depth_at_the_edge_of_the_dead_band(driver: Any) -> None:
    """0.98 N up of four thrusters: 2.5 us behind 1528 us, on the line to 0.04 kgf at 1532 us."""
    pulse = 1528.0 + 4.0 * (WEIGHT - BUOYANCY) / (4.0 * 0.04 * KGF)
    trim = (1500.0 - pulse) * 12.0 / 400.0
    assert trim == pytest.approx(-0.915, abs=5e-4)
    plant = driver(PLANT, **IDEAL).begin()
    plant["voltage[1]"] = plant["voltage[2]"] = trim
    plant.step(0.02, count=1000)
    # 2.5 mm/s, where the thrusters have their force, and exp(-20) of it are left
    assert plant["depth_rate"] == pytest.approx(0.0, abs=1e-11)
    assert plant["depth"] == pytest.approx(5.0, abs=5e-3)


def test_a_small_oscillation_has_the_period_and_damping_ratio_of_the_published_numbers(driver: Any) -> None:
    """3.30 s and 0.575. 1e-9 rad: the pendulum of 1e-3 rad is 1e-7 slower than its linear form."""
    ratio = 0.8 / (2.0 * INERTIA * FREQUENCY)
    damped = FREQUENCY * math.sqrt(1.0 - ratio**2)
    assert (2.0 * math.pi / FREQUENCY, ratio) == pytest.approx((3.30, 0.575), abs=5e-3)
    plant = driver(PLANT, initial_pitch=1e-3, pitch_quadratic_damping=0.0, **IDEAL).begin()
    for k in range(1, 101):
        t = 0.05 * k
        plant.step(0.05)
        phase = math.cos(damped * t) + ratio * FREQUENCY / damped * math.sin(damped * t)
        assert plant["pitch"] == pytest.approx(1e-3 * math.exp(-ratio * FREQUENCY * t) * phase, abs=1e-9)


def test_a_difference_of_the_pairs_turns_it_by_their_lever(driver: Any) -> None:
    """1620 us and 1580 us: 0.82 kgf and 0.40 kgf of each thruster, up, two in a pair at 0.12 m."""
    plant = driver(PLANT, free_surface=False, **IDEAL).begin()
    plant["voltage[1]"], plant["voltage[2]"] = -3.6, -2.4
    plant.step(0.02, count=1100)
    moment = 0.12 * 2.0 * (0.82 - 0.40) * KGF
    assert plant["pitch"] == pytest.approx(math.asin(moment / STIFFNESS), rel=1e-9)


def test_in_sea_water_it_floats_by_the_published_difference() -> None:
    """The guide gives -2.6 N."""
    heavier = 1027.0 * 0.0134 * 9.82
    assert WEIGHT - heavier == pytest.approx(-2.6, abs=0.05)


def test_every_number_that_is_not_published_says_so() -> None:
    """No source is one of RovHeavePitchPlant, which are of the paper's vehicle."""
    sources = {v.name.partition("[")[0]: v.source for v in PLANT.variables if v.causality == "parameter"}
    published = {name for name, source in sources.items() if source.startswith("published: ")}
    numbers = {
        "inertia", "linear_damping", "quadratic_damping", "weight", "net_weight", "water_density",
        "thruster_scale", "thruster_table_force", "thruster_transfer", "thruster_lever", "pitch_inertia",
        "metacentric_height", "pitch_linear_damping", "pitch_quadratic_damping", "sensor_period",
        "sensor_resolution",
    }  # fmt: skip
    assert published == numbers | {"thruster_ideal", "thruster_tabulated", "sensor_ideal"}
    others = ("chosen", "guess: ", "estimate: ", "assumed", "left out: ", "without effect beside the table")
    assert all(source.startswith(others) for name, source in sources.items() if name not in published)
    assert not [name for name, source in sources.items() if "paper" in source or "(11)" in source]


def test_only_start_values_differ_from_rov_heave_pitch_plant() -> None:
    other = HEAVE_PITCH
    assert PLANT.step is other.step
    assert [v.name for v in PLANT.variables] == [v.name for v in other.variables]
    assert [(v.unit, v.minimum, v.description) for v in PLANT.variables] == [
        (v.unit, v.minimum, v.description) for v in other.variables
    ]
