"""The linear plant of another vehicle follows from the description beside its FMU."""

from pathlib import Path

from orchestration.margins.l1_design import design_of
from orchestration.margins.l1_loop import Plant
from orchestration.scenarios import scenario
from tests.described_fmus import described

DESCRIPTION = '[variables]\ninertia = "mass"\ndamping = "drag"\n'


def test_thrusters_with_a_table_and_a_transfer_function_have_one_lag() -> None:
    chosen = scenario.load(scenario.find("nominal-l1"), settings={"plant": "BlueRov2Plant"})
    design = design_of(chosen.prepared, 0.8, 0.8)
    assert design is not None
    assert design.plant.gains == (1.0,)
    assert design.plant.lags == ((9258.0 - 6136.0) / 108700.0,)


def test_a_vehicle_that_takes_a_force_has_the_plant_of_its_description(tmp_path: Path) -> None:
    fmu = described(tmp_path / "boat.fmu", ("control_force",), ("depth", "depth_rate"), ("mass", "drag"))
    settings = {"plant": str(fmu), "plant.mass": 32.0, "plant.drag": 16.0}
    chosen = scenario.load(scenario.find("nominal-l1"), settings=settings)
    assert design_of(chosen.prepared, 0.8, 0.8) is None
    fmu.with_suffix(".vehicle.toml").write_text(DESCRIPTION)
    design = design_of(chosen.prepared, 0.8, 0.8)
    assert design is not None
    assert design.plant == Plant(a=((0.0, 1.0), (0.0, -0.5)), b=(0.0, 1.0 / 32.0))
