"""How another controller is joined to the vehicle: the depth control interface, and other names."""

from pathlib import Path
from typing import Any

import pytest

from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import prepare
from tests.described_fmus import described

REFERENCE, DEPTH = "depth_reference", "measured_depth"
VOLTAGES = ("voltage[1]", "voltage[2]")
MAPPED = {"depth_reference": "r", "measured_depth": "z", "voltage[1]": "v1", "voltage[2]": "v2"}


def with_fmu(folder: Path, inputs: Any, outputs: Any, **overrides: Any) -> Scenario:
    fmu = described(folder / "my.fmu", inputs, outputs, ("kp",))
    path = scenario.find("nominal-extended")
    return scenario.load(path, overrides, settings={"controller": str(fmu)})


def test_a_force_is_joined_through_the_allocation(tmp_path: Path) -> None:
    loaded = with_fmu(tmp_path, (REFERENCE, DEPTH), ("control_force",))
    assert loaded.resolved["components"]["allocation"] == "ThrustAllocation"
    assert loaded.system.connections == (
        ("plant.measured_depth", "controller.measured_depth"),
        ("controller.control_force", "allocation.control_force"),
        ("allocation.voltage[1]", "plant.voltage[1]"),
        ("allocation.voltage[2]", "plant.voltage[2]"),
    )
    assert "controller.control_force" in loaded.experiment.record
    assert loaded.metrics["total_variation"]["signal"] == "controller.control_force"
    prepare(loaded.system, loaded.experiment)
    assert not {"mapping", "when_replaced"} & loaded.resolved.keys()


@pytest.mark.parametrize("outputs", [VOLTAGES, (*VOLTAGES, "control_force")])
def test_voltages_need_no_allocation(tmp_path: Path, outputs: tuple[str, ...]) -> None:
    loaded = with_fmu(tmp_path, (REFERENCE, DEPTH), outputs)
    assert list(loaded.system.components) == ["plant", "controller"]
    prepare(loaded.system, loaded.experiment)


def test_parameters_of_the_allocation_can_be_set(tmp_path: Path) -> None:
    fmu = described(tmp_path / "my.fmu", (REFERENCE, DEPTH), ("control_force",))
    settings = {"controller": str(fmu), "allocation.voltage_limit": 6.0}
    loaded = scenario.load(scenario.find("nominal-l1"), settings=settings)
    assert loaded.experiment.parameters["allocation.voltage_limit"] == 6.0


def test_optional_inputs_are_driven_where_the_controller_has_them(tmp_path: Path) -> None:
    optional = (
        "measured_depth_rate",
        "depth_reference_rate",
        "depth_reference_acceleration",
        "roll",
        "pitch",
    )
    loaded = with_fmu(tmp_path, (REFERENCE, DEPTH, *optional), VOLTAGES)
    assert ("plant.depth_rate", "controller.measured_depth_rate") in loaded.system.connections
    assert set(loaded.experiment.inputs) >= {"controller.roll", "controller.pitch"}
    signals = loaded.experiment.signals
    assert signals["controller.depth_reference_rate"](20.0) == 0.8 / 40.0
    assert signals["controller.depth_reference_acceleration"](20.0) == 0.0
    prepare(loaded.system, loaded.experiment)


def test_the_reference_rate_is_that_of_the_reference_of_the_scenario(tmp_path: Path) -> None:
    fmu = described(tmp_path / "my.fmu", (REFERENCE, DEPTH, "depth_reference_rate"), VOLTAGES)
    smooth = scenario.load(scenario.find("nominal-extended-smooth"), settings={"controller": str(fmu)})
    assert smooth.experiment.signals["controller.depth_reference_rate"](20.0) == pytest.approx(
        1.875 * 0.8 / 40.0, rel=1e-15
    )


def test_mapped_names_stand_for_those_of_the_scenario(tmp_path: Path) -> None:
    mapping = {"controller": MAPPED}
    loaded = with_fmu(tmp_path, ("r", "z"), ("v1", "v2"), mapping=mapping)
    assert list(loaded.experiment.signals) == ["controller.r"]
    assert ("controller.v1", "plant.voltage[1]") in loaded.system.connections
    assert loaded.metrics["rmse"]["reference"] == "controller.r"
    prepare(loaded.system, loaded.experiment)


def test_a_mapped_force_is_joined_through_the_allocation(tmp_path: Path) -> None:
    mapping = {"controller": {"control_force": "u"}}
    loaded = with_fmu(tmp_path, (REFERENCE, DEPTH), ("u",), mapping=mapping)
    assert ("controller.u", "allocation.control_force") in loaded.system.connections
    assert loaded.metrics["total_variation"]["signal"] == "controller.u"
    prepare(loaded.system, loaded.experiment)


def test_one_mapping_serves_scenarios_that_name_less(scenario_fmus: None, tmp_path: Path) -> None:
    """Nothing names the initial depth in a dive from the surface; in a hold at 1 m something does."""
    outputs = ("depth", "depth_rate", "measured_depth")
    fmu = described(tmp_path / "boat.fmu", ("voltage[1]", "voltage[2]", "external_force"), outputs, ("z0",))
    mapping = {"mapping": {"plant": {"initial_depth": "z0"}}}
    dive, held = (
        scenario.load(scenario.find(name), mapping, settings={"plant": str(fmu)})
        for name in ("nominal-extended", "hold-force-step")
    )
    assert "plant.z0" not in dive.experiment.parameters
    assert held.experiment.parameters["plant.z0"] == 1.0


def test_a_mapping_in_a_file_is_of_its_base_and_of_its_own_fmu(tmp_path: Path) -> None:
    described(tmp_path / "my.fmu", ("r", "z"), ("v1", "v2"), ("kp",))
    (tmp_path / "mine.toml").write_text(
        'base = "nominal-l1"\n[components]\ncontroller = "my.fmu"\n[mapping.controller]\n'
        + "".join(f'"{name}" = "{own}"\n' for name, own in MAPPED.items())
        + '[parameters]\n"controller.kp" = 1.0\n'
    )
    loaded = scenario.load(tmp_path / "mine.toml")
    assert list(loaded.experiment.signals) == ["controller.r"]
    ours = scenario.load(tmp_path / "mine.toml", settings={"controller": "L1DepthController"})
    assert ours.system == scenario.load(scenario.find("nominal-l1")).system


def test_two_connections_to_one_input_in_an_entry_are_refused(tmp_path: Path) -> None:
    described(tmp_path / "my.fmu", (REFERENCE, DEPTH), ("v1", "v2"))
    (tmp_path / "base.toml").write_text(
        'base = "nominal-l1"\n\n[[when_replaced]]\ncomponent = "controller"\nhas = ["v1"]\nconnections = [\n'
        '    ["controller.v1", "plant.voltage[1]", { factor = 2.0 }],\n'
        '    ["controller.v2", "plant.voltage[1]"],\n    ["controller.v2", "plant.voltage[2]"],\n]\n'
    )
    loaded = scenario.load(tmp_path / "base.toml", settings={"controller": str(tmp_path / "my.fmu")})
    with pytest.raises(SystemDefinitionError, match=r"plant.voltage\[1\] is driven 2 times"):
        prepare(loaded.system, loaded.experiment)


def test_a_reference_that_a_connection_drives_needs_its_rate_from_there(tmp_path: Path) -> None:
    fmu = described(tmp_path / "my.fmu", (REFERENCE, DEPTH, "depth_reference_rate"), VOLTAGES)
    connected = {
        "components": {"reference": "DepthReference"},
        "connections": {"controller.depth_reference": "reference.depth_reference"},
    }
    path = scenario.find("nominal-l1")
    with pytest.raises(ScenarioError, match=r"but reference.depth_reference drives it: connect the output"):
        scenario.load(path, connected, settings={"controller": str(fmu)})
    rate = {"inputs": {"controller.depth_reference_rate": 0.0}}
    loaded = scenario.load(path, connected | rate, settings={"controller": str(fmu)})
    assert loaded.experiment.inputs["controller.depth_reference_rate"] == 0.0
    assert not loaded.experiment.signals


LACKING = (
    r"my.fmu, which lacks depth_reference, measured_depth, measured_depth_rate, voltage\[1\], voltage\[2\]; "
    r"nothing drives its r, z, its outputs are v1, v2: name .* by --map controller.depth_reference=NAME or "
    r"in \[mapping.controller\]; --open-inputs start leaves its inputs at their start values$"
)


@pytest.mark.parametrize(
    ("mapping", "message"),
    [
        ({}, LACKING),
        ({**MAPPED, "voltage[2]": "v3"}, r"mapping.controller: controller has no variable 'v3'; known: "),
        ({**MAPPED, "depth_refrence": "r"}, r"names controller.depth_refrence; nearest is 'controller.dep"),
        ({"depth_reference": "r", "measured_depth": "z"}, r"lacks voltage\[1\], voltage\[2\]; .*NAME or in"),
        ({n: o for n, o in MAPPED.items() if o != "z"}, r"lacks measured_depth, .* drives its z, its outp"),
    ],
)
def test_an_fmu_that_is_not_joined_is_refused_with_its_names(
    tmp_path: Path, mapping: dict[str, str], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        with_fmu(tmp_path, ("r", "z"), ("v1", "v2"), mapping={"controller": mapping} if mapping else {})


def test_open_inputs_take_start_values_if_asked(tmp_path: Path) -> None:
    inputs = (REFERENCE, DEPTH, "enable:Boolean")
    loaded = with_fmu(tmp_path, inputs, VOLTAGES, experiment={"open_inputs": "start"})
    prepared = prepare(loaded.system, loaded.experiment)
    assert [port.name for port in prepared.system.open_inputs] == ["controller.enable"]
    assert {port.name: value for port, value in prepared.settings}["controller.enable"] is False
    with pytest.raises(ScenarioError, match=r"nothing drives its enable, .* --open-inputs start leaves"):
        with_fmu(tmp_path, inputs, VOLTAGES)


FORCE = '[[when_replaced]]\ncomponent = "controller"\nhas = ["control_force"]\n'


@pytest.mark.parametrize("own", ["", '[record]\n"plant.depth_rate" = false\n'])
def test_entries_for_other_fmus_join_what_their_file_inherits(tmp_path: Path, own: str) -> None:
    fmu = described(tmp_path / "my.fmu", (REFERENCE, DEPTH, "roll"), ("control_force",))
    more = 'record = ["allocation.voltage[1]"]\nconnections = [["plant.depth", "controller.roll"]]\n'
    (tmp_path / "middle.toml").write_text(f'base = "nominal-extended"\n{own}{FORCE}{more}')
    loaded = scenario.load(tmp_path / "middle.toml", settings={"controller": str(fmu)})
    plain = with_fmu(tmp_path, (REFERENCE, DEPTH, "roll"), ("control_force",))
    inherited = [name for name in plain.experiment.record if not own or name != "plant.depth_rate"]
    assert list(loaded.experiment.record) == [*inherited, "allocation.voltage[1]"]
    assert loaded.system.connections == (*plain.system.connections, ("plant.depth", "controller.roll"))
    assert "controller.roll" not in loaded.experiment.inputs


def test_two_names_for_one_variable_are_recorded_once(tmp_path: Path) -> None:
    mapping = {"controller": {"u_m": "u", "u_a": "u"}}
    loaded = with_fmu(tmp_path, (REFERENCE, DEPTH), (*VOLTAGES, "u"), mapping=mapping)
    assert [name for name in loaded.experiment.record if name == "controller.u"] == ["controller.u"]


def test_two_values_for_one_variable_are_refused(tmp_path: Path) -> None:
    mapping = {"controller": {"one": "kp", "two": "kp"}}
    base = '[parameters]\n"controller.one" = 0.5\n"controller.two" = 2.0\n'
    (tmp_path / "middle.toml").write_text('base = "nominal-extended"\n' + base)
    fmu = described(tmp_path / "my.fmu", (REFERENCE, DEPTH), VOLTAGES, ("kp",))
    message = (
        r"middle.toml:4: parameters: controller.one and controller.two both stand for "
        r"controller.kp: expected one value, got 0.5 and 2.0$"
    )
    with pytest.raises(ScenarioError, match=message):
        scenario.load(tmp_path / "middle.toml", {"mapping": mapping}, settings={"controller": str(fmu)})
