"""The linear plant of another vehicle follows from the description beside its FMU."""

from pathlib import Path
from typing import Any

import pytest

from fmus.block.block_file import write_new_block
from orchestration.scenarios import scenario
from orchestration.studies.margins.l1_design import design_of
from orchestration.studies.margins.l1_loop import Plant
from tests.described_fmus import described

INERTIA = '[variables]\ninertia = "mass"\n'


def plant_of(vehicle: object, **parameters: Any) -> Plant | None:
    """The linear plant of the design of plain L1 for a vehicle with these parameters and inputs."""
    settings = {"plant": str(vehicle)} | {f"plant.{name}": value for name, value in parameters.items()}
    design = design_of(scenario.load_scenario("nominal-l1", settings=settings), 0.8, 0.8)
    return design and design.plant


def test_thrusters_with_a_table_and_a_transfer_function_have_one_lag() -> None:
    line = {"plant": "BlueRov2Plant", "controller.thruster_tabulated": False}
    not_inverted = scenario.load(scenario.find("nominal-l1"), settings=line)
    assert design_of(not_inverted, 0.8, 0.8) is None
    plant = plant_of("BlueRov2Plant")
    assert plant
    assert plant.gains == (0.5, 0.5)
    assert plant.lags == ((9258.0 - 6136.0) / 108700.0,) * 2


def test_a_vehicle_that_takes_a_force_has_the_plant_of_its_description(tmp_path: Path) -> None:
    fmu = described(tmp_path / "boat.fmu", ("control_force",), ("depth", "depth_rate"), ("mass", "drag"))
    assert plant_of(fmu, mass=32.0, drag=16.0) is None
    fmu.with_suffix(".vehicle.toml").write_text(f'{INERTIA}damping = "drag"\n')
    expected = Plant(a=((0.0, 1.0), (0.0, -0.5)), b=(0.0, 1.0 / 32.0))
    assert plant_of(fmu, mass=32.0, drag=16.0) == expected


@pytest.mark.slow
def test_the_description_beside_a_python_file_is_found(tmp_path: Path) -> None:
    write_new_block("rover", tmp_path, kind="vehicle")
    description = f'{INERTIA}damping = "linear_drag"\nlag = ["thruster_lag"]\n'
    (tmp_path / "rover.vehicle.toml").write_text(description)
    expected = Plant(a=((0.0, 1.0), (0.0, -0.5)), b=(0.0, 1.0 / 32.0), lags=(0.05,))
    assert plant_of(tmp_path / "rover.py", mass=32.0, linear_drag=16.0) == expected


def test_a_vehicle_with_voltages_needs_no_input_for_faults(tmp_path: Path) -> None:
    """The controller is told the gains, so that half of a unit of force comes from each thruster."""
    inputs, parameters = ("voltage[1]", "voltage[2]"), ("mass", "fore", "aft")
    fmu = described(tmp_path / "boat.fmu", inputs, ("depth", "depth_rate"), parameters)
    fmu.with_suffix(".vehicle.toml").write_text(f'{INERTIA}gain = ["fore", "aft"]\n')
    plant = plant_of(fmu, mass=32.0, fore=4.0, aft=2.0)
    assert plant
    assert plant.gains == (0.5, 0.5)


@pytest.mark.parametrize("efficiency", [1.0, 0.75])
def test_a_vehicle_with_one_thruster_gives_the_whole_demand(tmp_path: Path, efficiency: float) -> None:
    """The controller is told two of half its gain; a fault of its own takes that share of the loop."""
    inputs = "voltage[1]", "thruster_efficiency[1]"
    fmu = described(tmp_path / "boat.fmu", inputs, ("depth", "depth_rate"), ("mass", "k", "slow"))
    fmu.with_suffix(".vehicle.toml").write_text(f'{INERTIA}gain = ["k"]\nlag = ["slow"]\n')
    plant = plant_of(fmu, mass=32.0, k=4.0, slow=0.2, **{"thruster_efficiency[1]": efficiency})
    assert plant
    assert (plant.gains, plant.lags) == ((efficiency,), (0.2,))
