"""The derivatives of the reference drive a controller that uses them."""

from pathlib import Path

import pytest

from orchestration.errors import ScenarioError
from orchestration.scenarios import scenario
from orchestration.system.prepared_run import prepare
from tests.described_fmus import described

RATE, ACCELERATION = "controller.depth_reference_rate", "controller.depth_reference_acceleration"
FEEDFORWARD = "controller.reference_feedforward"
# those of our controller; another one with inputs for the rates gets them always
VEHICLE = [n for n in scenario.shipped() if not n.startswith("example") and n != "heave-pitch"]

pytestmark = pytest.mark.usefixtures("scenario_fmus")


@pytest.mark.parametrize("name", [name for name in VEHICLE if name != "nominal-feedforward"])
def test_a_feedforward_drives_the_derivatives_in_every_scenario_of_the_vehicle(name: str) -> None:
    without = scenario.load(scenario.find(name)).experiment
    assert not {RATE, ACCELERATION} & without.signals.keys()
    assert (without.inputs[RATE], without.inputs[ACCELERATION]) == (0.0, 0.0)
    for value in ("inside", 3):
        loaded = scenario.load(scenario.find(name), settings={FEEDFORWARD: value})
        assert {RATE, ACCELERATION} <= loaded.experiment.signals.keys()
        assert not {RATE, ACCELERATION} & loaded.experiment.inputs.keys()
    prepare(loaded.system, loaded.experiment)


def test_they_are_those_of_the_reference_of_the_scenario() -> None:
    smooth = scenario.load(scenario.find("nominal-extended-smooth"), settings={FEEDFORWARD: "inside"})
    assert smooth.experiment.signals[RATE](20.0) == pytest.approx(1.875 * 0.8 / 40.0, rel=1e-15)
    example = scenario.load(
        scenario.find("example-l1"), {"parameters": {"controller.reference_feedforward": "outside"}}
    )
    assert example.experiment.signals["controller.reference_acceleration"](0.0) == pytest.approx(-4.0)


def test_a_scenario_that_drives_them_itself_does_so(tmp_path: Path) -> None:
    text = f'base = "nominal-l1"\n[parameters]\n"{FEEDFORWARD}" = "inside"\n[inputs]\n"{RATE}" = 0.1\n'
    (tmp_path / "mine.toml").write_text(text)
    experiment = scenario.load(tmp_path / "mine.toml").experiment
    assert experiment.inputs[RATE] == 0.1
    assert RATE not in experiment.signals
    by_block = scenario.load(scenario.find("nominal-feedforward"))
    assert ("reference.depth_reference_rate", RATE) in by_block.system.connections
    assert not by_block.experiment.signals


def test_a_reference_whose_derivatives_nobody_knows_is_refused(tmp_path: Path) -> None:
    """Rather than run with derivatives of 0."""
    text = (
        f'base = "nominal-l1"\n[components]\nreference = "DepthReference"\n'
        f'[connections]\n"controller.depth_reference" = "reference.depth_reference"\n'
        f'[parameters]\n"{FEEDFORWARD}" = "inside"\n'
    )
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(ScenarioError, match=rf"{RATE}.*expected an input that has a signal"):
        scenario.load(tmp_path / "mine.toml")


@pytest.mark.parametrize(
    "drawn", ['values = ["none", "inside"]', 'distribution = "integers"\nlow = 1\nhigh = 3']
)
def test_a_sweep_over_the_parameter_drives_them(tmp_path: Path, drawn: str) -> None:
    sweep = f'[sweep]\nsamples = 3\n[sweep.vary."{FEEDFORWARD}"]\n{drawn}\n'
    text = f'base = "nominal-l1"\n{sweep}'
    (tmp_path / "mine.toml").write_text(text)
    assert RATE in scenario.load(tmp_path / "mine.toml").experiment.signals


def test_another_controller_without_the_inputs_gets_none_of_them(tmp_path: Path) -> None:
    fmu = described(tmp_path / "my.fmu", ("depth_reference", "measured_depth"), ("voltage[1]", "voltage[2]"))
    settings = {"controller": str(fmu)}
    loaded = scenario.load(scenario.find("nominal-feedforward"), settings=settings)
    prepare(loaded.system, loaded.experiment)
    assert not loaded.experiment.signals
