"""The pages of both interfaces: an FMU with all variables of their tables stands in every scenario."""

import re
import warnings
from pathlib import Path

import pytest

from orchestration.errors import ScenarioWarning
from orchestration.scenarios import scenario
from orchestration.scenarios.vehicle import PLANT
from orchestration.studies.vehicle import Vehicle
from tests.described_fmus import described

REFERENCE = Path(__file__).parents[3] / "docs" / "reference"
# of one actuator, a vehicle and a controller have voltages or a force
VOLTAGES, FORCE = {"voltage[1]", "voltage[2]"}, {"control_force"}


def names(page: str, causality: str) -> list[str]:
    """The names in the first column of the table of inputs, outputs or parameters."""
    text = (REFERENCE / f"{page}-interface.md").read_text(encoding="utf-8")
    (table,) = re.findall(rf"^\| {causality} \|.*\n\|[-|]+\n((?:\|.*\n)+)", text, re.M)
    return [name for row in table.splitlines() for name in re.findall(r"`([^`]+)`", row.split("|")[1])]


def with_all(folder: Path, page: str, without: set[str]) -> Path:
    """An FMU with all variables of a page but some; one that is in two tables is an input."""
    inputs, outputs, parameters = (
        [n for n in names(page, one) if n not in without] for one in ("input", "output", "parameter")
    )
    outputs = [name for name in outputs if name not in inputs]
    return described(folder / f"{page}.fmu", inputs, outputs, parameters)


def scenarios_of_the_vehicle() -> list[str]:
    return [name for name, path in scenario.shipped().items() if not path.stem.startswith("example")]


@pytest.mark.parametrize("without", [VOLTAGES, FORCE], ids=["force", "voltages"])
@pytest.mark.parametrize(("page", "component"), [("vehicle", PLANT), ("depth-control", "controller")])
def test_an_fmu_with_the_whole_interface_takes_the_place_of_ours_in_every_scenario(
    scenario_fmus: None, tmp_path: Path, page: str, component: str, without: set[str]
) -> None:
    fmu = with_all(tmp_path, page, without)
    for name in scenarios_of_the_vehicle():
        with warnings.catch_warnings():
            # of values that were chosen for our vehicle; heave-pitch has inputs of the pitch besides
            warnings.simplefilter("ignore", ScenarioWarning)
            loaded = scenario.load(scenario.find(name), settings={component: str(fmu)})
        assert loaded.system.components[component] == fmu
        assert loaded.prepared


@pytest.mark.parametrize(
    ("lacks", "hint"),
    [
        ("depth", r"which lacks depth: left out"),
        ("depth_rate", r"which lacks depth_rate: left out"),
        ("initial_depth", r"which lacks initial_depth: left out"),
        ("measured_depth", ""),
        ("measured_depth_rate", ""),
        ("sensor_seed", ""),
        ("total_force", ""),
        ("external_force", ""),
        ("roll", ""),
    ],
)
def test_what_a_missing_variable_of_a_vehicle_means(
    scenario_fmus: None, tmp_path: Path, lacks: str, hint: str
) -> None:
    """The column "if the vehicle lacks it", in a scenario that starts at 1 m."""
    fmu = with_all(tmp_path, "vehicle", FORCE | {lacks})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ScenarioWarning)
        name = "hold-force-step" if lacks != "external_force" else "hold-current"
        loaded = scenario.load(scenario.find(name), settings={PLANT: str(fmu)})
    told = [str(one.message) for one in caught if lacks in str(one.message)]
    assert bool(told) == bool(hint), told
    assert all(re.search(hint, message) for message in told)
    assert loaded.prepared
    joined = {target: source for source, target, *_ in loaded.system.connections}
    depth = "measured_depth" if lacks != "measured_depth" else "depth"
    rate = "measured_depth_rate" if lacks != "measured_depth_rate" else "depth_rate"
    assert joined["controller.measured_depth"] == f"plant.{depth}"
    assert joined["controller.measured_depth_rate"] == f"plant.{rate}"


def test_without_any_rate_of_the_vehicle_that_of_the_controller_is_0(
    scenario_fmus: None, tmp_path: Path
) -> None:
    fmu = with_all(tmp_path, "vehicle", FORCE | {"depth_rate", "measured_depth_rate"})
    with pytest.warns(ScenarioWarning, match="lacks depth_rate"):
        loaded = scenario.load(scenario.find("nominal-l1"), settings={PLANT: str(fmu)})
    assert loaded.experiment.inputs["controller.measured_depth_rate"] == 0.0


def test_a_score_refuses_a_vehicle_without_depth(tmp_path: Path) -> None:
    with pytest.raises(Exception, match=r"lacks plant.depth, so it is no vehicle"):
        Vehicle.of(str(with_all(tmp_path, "vehicle", FORCE | {"depth"})))
