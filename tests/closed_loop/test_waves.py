"""The vehicle in waves: what a particle of the water does, and what the sensor makes of it."""

import math
from typing import Any

import numpy as np
import pytest

from fmus.registry import Flavour, fmu_path
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.system.experiment import Experiment
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.system import System
from plant_fmu import waves

W = 2.0 * math.pi / 5.0  # rad/s
K = W * W / 9.81
DEPTH, STEP = 3.0, 2e-4  # m, s
FLOATING: dict[str, Any] = {
    "net_weight": 0.0, "free_surface": False, "thruster_ideal": True, "sensor_ideal": True,
    "initial_depth": DEPTH, "internal_step": STEP,
}  # fmt: skip
NO_DRAG = {"linear_damping": 0.0, "quadratic_damping": 0.0}
BLOCKS = {"plant": "RovDepthPlant", "waves": "WaveSource"}
INPUTS = ("wave_velocity", "wave_acceleration", "wave_pressure_head")


def in_waves(amplitude: float, joined: tuple[str, ...], sea: bool = False, **plant: Any) -> Recording:
    """A neutral vehicle at 3 m, for two periods: under a wave of this amplitude, or a sea of its variance.

    It begins with the velocity of the water.
    """
    height = 4.0 * amplitude / math.sqrt(2.0)
    drawn = waves.jonswap_sea(height, 5.0, 3.3, 1) if sea else waves.regular_wave(amplitude, 5.0, 0.7)
    velocity = waves.water_motion(0.0, DEPTH, drawn).velocity if "wave_velocity" in joined else 0.0
    chosen = {"kind": "jonswap" if sea else "regular", "wave_amplitude": amplitude, "start_phase": 0.7}
    parameters = {f"waves.{name}": value for name, value in (chosen | {"significant_height": height}).items()}
    given = FLOATING | {"initial_heave_velocity": velocity} | plant
    parameters |= {f"plant.{name}": value for name, value in given.items()}
    names = ("plant.depth", "plant.measured_depth", "waves.wave_pressure_head")
    fmus = {name: fmu_path(block, Flavour.NATIVE) for name, block in BLOCKS.items()}
    connections = [("plant.depth", "waves.depth"), *((f"waves.{name}", f"plant.{name}") for name in joined)]
    experiment = Experiment(10.0, STEP, parameters=parameters, record=names, open_inputs=OpenInputs.START)
    return simulate(System(fmus, connections), experiment)


@pytest.mark.parametrize("drag", [{}, NO_DRAG], ids=["drag", "no drag"])
@pytest.mark.parametrize("sea", [False, True], ids=["regular", "sea"])
def test_a_neutral_vehicle_moves_with_the_water_and_its_sensor_reads_a_constant(
    scenario_fmus: None, sea: bool, drag: dict[str, float]
) -> None:
    """To first order in the amplitude: half of it leaves a quarter of the residue."""
    residues = []
    for amplitude in (0.04, 0.02):
        run = in_waves(amplitude, INPUTS, sea, **drag)
        moved = np.ptp(run["plant.depth"])
        assert moved > 1.2 * amplitude * math.exp(-K * DEPTH)  # a wave of 5 s moves it by 2 a exp(-k z)
        reading = run["plant.measured_depth"]
        residues.append(np.abs(reading - reading[0]).max())
        assert residues[-1] < 0.1 * moved
    # third order: k a of the next; and a held input is half a step late, 1e-4 s w of the motion
    assert residues[0] / residues[1] == pytest.approx(4.0, rel=0.05)


def test_whatever_its_inertia_a_neutral_vehicle_moves_with_the_water(scenario_fmus: None) -> None:
    """rho V + A is the whole inertia M_z then: a depth sensor cannot tell it from a vehicle at rest."""
    light, heavy = (in_waves(0.01, INPUTS, inertia=inertia)["plant.depth"] for inertia in (3.5, 50.0))
    assert np.ptp(light) > 0.01
    # second order: 5 % were measured at four times the amplitude
    np.testing.assert_allclose(heavy, light, rtol=0.0, atol=0.02 * np.ptp(light))


def test_a_vehicle_that_holds_still_reads_bernoullis_linear_pressure(scenario_fmus: None) -> None:
    """Only the pressure acts: a exp(-k z) cos(w t + phase), a communication step late."""
    run = in_waves(0.1, ("wave_pressure_head",))
    assert np.ptp(run["plant.depth"]) == 0.0
    head = 0.1 * math.exp(-K * DEPTH) * np.cos(W * run.time + 0.7)
    np.testing.assert_allclose(run["plant.measured_depth"] - DEPTH, head, rtol=0.0, atol=0.1 * W * STEP)


def test_in_deep_water_nothing_moves(scenario_fmus: None) -> None:
    """At k z = 4 a wave of 0.1 m moves it by 0.1 m exp(-4) at most, to either side."""
    run = in_waves(0.1, INPUTS, initial_depth=4.0 / K, initial_heave_velocity=0.0)
    assert 0.0 < np.ptp(run["plant.depth"]) < 3.0 * 0.1 * math.exp(-4.0)
