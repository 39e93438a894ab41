"""The linear plant of another vehicle follows from the description beside its FMU."""

from pathlib import Path
from typing import Any

from fmus.block.block_file import write_new_block
from orchestration.margins.l1_design import design_of
from orchestration.margins.l1_loop import Plant
from orchestration.scenarios import scenario
from tests.described_fmus import described

DESCRIPTION = '[variables]\ninertia = "mass"\ndamping = "drag"\n'


def test_thrusters_with_a_table_and_a_transfer_function_have_one_lag() -> None:
    settings: dict[str, Any] = {"plant": "BlueRov2Plant"}
    line = {**settings, "controller.thruster_tabulated": False}
    not_inverted = scenario.load(scenario.find("nominal-l1"), settings=line)
    assert design_of(not_inverted, 0.8, 0.8) is None
    design = design_of(scenario.load(scenario.find("nominal-l1"), settings=settings), 0.8, 0.8)
    assert design is not None
    assert design.plant.gains == (0.5, 0.5)
    assert design.plant.lags == ((9258.0 - 6136.0) / 108700.0,) * 2


def test_a_vehicle_that_takes_a_force_has_the_plant_of_its_description(tmp_path: Path) -> None:
    fmu = described(tmp_path / "boat.fmu", ("control_force",), ("depth", "depth_rate"), ("mass", "drag"))
    settings = {"plant": str(fmu), "plant.mass": 32.0, "plant.drag": 16.0}
    chosen = scenario.load(scenario.find("nominal-l1"), settings=settings)
    assert design_of(chosen, 0.8, 0.8) is None
    fmu.with_suffix(".vehicle.toml").write_text(DESCRIPTION)
    design = design_of(chosen, 0.8, 0.8)
    assert design is not None
    assert design.plant == Plant(a=((0.0, 1.0), (0.0, -0.5)), b=(0.0, 1.0 / 32.0))


def test_the_description_beside_a_python_file_is_found(tmp_path: Path) -> None:
    write_new_block("rover", tmp_path, vehicle=True)
    (tmp_path / "rover.vehicle.toml").write_text(
        '[variables]\ninertia = "mass"\ndamping = "linear_drag"\nlag = ["thruster_lag"]\n'
    )
    settings = {"plant": str(tmp_path / "rover.py"), "plant.mass": 32.0, "plant.linear_drag": 16.0}
    design = design_of(scenario.load(scenario.find("nominal-l1"), settings=settings), 0.8, 0.8)
    assert design is not None
    assert design.plant == Plant(a=((0.0, 1.0), (0.0, -0.5)), b=(0.0, 1.0 / 32.0), lags=(0.05,))


def test_a_vehicle_with_voltages_needs_no_input_for_faults(tmp_path: Path) -> None:
    """The controller is told the gains, so that half of a unit of force comes from each thruster."""
    fmu = described(
        tmp_path / "boat.fmu",
        ("voltage[1]", "voltage[2]"),
        ("depth", "depth_rate"),
        ("mass", "fore", "aft"),
    )
    fmu.with_suffix(".vehicle.toml").write_text('[variables]\ninertia = "mass"\ngain = ["fore", "aft"]\n')
    gains = {"plant.fore": 4.0, "plant.aft": 2.0}
    settings = {"plant": str(fmu), "plant.mass": 32.0, **gains}
    design = design_of(scenario.load(scenario.find("nominal-l1"), settings=settings), 0.8, 0.8)
    assert design is not None
    assert design.plant.gains == (0.5, 0.5)


def test_a_vehicle_with_one_thruster_gives_the_whole_demand(tmp_path: Path) -> None:
    """The controller is told two of half its gain; a fault of its own takes that share of the loop."""
    inputs = "voltage[1]", "thruster_efficiency[1]"
    fmu = described(tmp_path / "boat.fmu", inputs, ("depth", "depth_rate"), ("mass", "k", "slow"))
    fmu.with_suffix(".vehicle.toml").write_text(
        '[variables]\ninertia = "mass"\ngain = ["k"]\nlag = ["slow"]\n'
    )
    settings: dict[str, Any] = {"plant": str(fmu), "plant.mass": 32.0, "plant.k": 4.0, "plant.slow": 0.2}
    for efficiency in (1.0, 0.75):
        faulty = {**settings, "plant.thruster_efficiency[1]": efficiency}
        design = design_of(scenario.load(scenario.find("nominal-l1"), settings=faulty), 0.8, 0.8)
        assert design is not None
        assert (design.plant.gains, design.plant.lags) == ((efficiency,), (0.2,))
