"""A BlueROV2 Heavy: RovHeavePitchPlant with the published numbers, which stand here once more."""

from typing import Any

import pytest

from plant_fmu.blue_rov2_plant import BLOCK as PLANT
from plant_fmu.heave_pitch_plant import BLOCK as HEAVE_PITCH

KGF = 9.80665
PUBLISHED = {
    "inertia": 13.5 + 18.68, "linear_damping": 33.0, "quadratic_damping": 190.0, "weight": 13.5 * 9.82,
    "net_weight": (13.5 - 13.4) * 9.82, "water_density": 1000.0, "pitch_inertia": 0.23 + 0.135,
    "metacentric_height": 0.01, "pitch_linear_damping": 0.8, "pitch_quadratic_damping": 0.47,
    "thruster_lever[1]": 0.12, "thruster_lever[2]": -0.12, "thruster_scale[1]": 2.0, "thruster_scale[2]": 2.0,
    "thruster_transfer[1]": 6136.0, "thruster_transfer[2]": 89.0, "thruster_transfer[3]": 9258.0,
    "thruster_transfer[4]": 108700.0, "sensor_period": 0.04, "sensor_resolution": 0.002,
}  # fmt: skip


def test_its_numbers_are_the_published_ones() -> None:
    starts = {v.name: v.start for v in PLANT.variables}
    assert {name: starts[name] for name in PUBLISHED} == pytest.approx(PUBLISHED, rel=1e-12)


def test_the_guide_states_the_forces_that_follow_from_them() -> None:
    guide = str(PLANT.guide)
    up, down = (4.0 * kgf * KGF for kgf in (T200[-1], -T200[0]))
    assert f"{down:.0f} N down at 12 V and {up:.0f} N up at -12 V" in guide
    in_sea_water = (13.5 - 1027.0 * 0.0134) * 9.82
    assert f"Sea water: net_weight {in_sea_water:.1f} N and water_density 1027 kg/m3" in guide


# force [kgf] from 1100 us by 40 us, forward thrust positive: Blue Robotics, T200 at 16 V, September 2019
T200 = (
    -4.07, -3.66, -2.99, -2.45, -1.94, -1.44, -1.02, -0.65, -0.32, -0.07, 0.0,
    0.08, 0.40, 0.82, 1.28, 1.82, 2.43, 3.11, 3.82, 4.65, 5.25,
)  # fmt: skip


def test_the_table_is_the_published_one_at_every_pulse(driver: Any) -> None:
    """Forward thrust is up, so 12 V are 1100 us; without a transfer function the force follows at once.

    A pulse of 900 us is beyond the table, and limited to its end.
    """
    still = {"sensor_ideal": True, "initial_depth": 5.0, "thruster_transfer[4]": 0.0}
    plant = driver(PLANT, **still).begin()
    for i, thrust in (-5, T200[0]), *enumerate(T200):
        pulse = 1100 + 40 * i
        plant["voltage[1]"] = (1500 - pulse) * 12.0 / 400.0
        plant.step(0.005)
        # two thrusters of a pair; between two of the published pulses the table has more points
        assert plant["thruster_force[1]"] == pytest.approx(-2.0 * thrust * KGF, abs=1e-9), pulse


def test_every_number_that_is_not_published_says_so() -> None:
    """No source is one of RovHeavePitchPlant, which are of the paper's vehicle."""
    sources = {v.name.partition("[")[0]: v.source for v in PLANT.variables if v.causality == "parameter"}
    published = {name for name, source in sources.items() if source.startswith("published: ")}
    numbers = {name.partition("[")[0] for name in PUBLISHED}
    kinds = {"thruster_table_force", "thruster_ideal", "thruster_tabulated", "sensor_ideal"}
    assert published == numbers | kinds
    others = ("chosen", "guess: ", "estimate: ", "assumed", "left out: ", "without effect beside the table")
    assert all(source.startswith(others) for name, source in sources.items() if name not in published)
    assert not [name for name, source in sources.items() if "paper" in source or "(11)" in source]


def test_only_start_values_differ_from_rov_heave_pitch_plant() -> None:
    assert PLANT.step is HEAVE_PITCH.step
    own, other = (
        [(v.name, v.unit, v.minimum, v.description) for v in b.variables] for b in (PLANT, HEAVE_PITCH)
    )
    assert own == other
