"""How components are joined by an interface, and another controller by the depth control interface."""

from pathlib import Path
from typing import Any

import pytest

from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.scenarios import fmu_files, scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import prepare
from tests.described_fmus import described

REFERENCE, DEPTH = "depth_reference", "measured_depth"
VOLTAGES = ("voltage[1]", "voltage[2]")
MAPPED = {"depth_reference": "r", "measured_depth": "z", "voltage[1]": "v1", "voltage[2]": "v2"}


def with_fmu(
    folder: Path, inputs: Any, outputs: Any, names: dict[str, str] | None = None, **overrides: Any
) -> Scenario:
    fmu = described(folder / "my.fmu", inputs, outputs, ("kp",))
    path = scenario.find("nominal-extended")
    if names:
        overrides["components"] = {"controller": {"names": names}}
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
    assert not {"names", "interface"} & loaded.resolved.keys()


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
    loaded = with_fmu(tmp_path, ("r", "z"), ("v1", "v2"), MAPPED)
    assert list(loaded.experiment.signals) == ["controller.r"]
    assert ("controller.v1", "plant.voltage[1]") in loaded.system.connections
    assert loaded.metrics["rmse"]["reference"] == "controller.r"
    prepare(loaded.system, loaded.experiment)


def test_a_mapped_force_is_joined_through_the_allocation(tmp_path: Path) -> None:
    loaded = with_fmu(tmp_path, (REFERENCE, DEPTH), ("u",), {"control_force": "u"})
    assert ("controller.u", "allocation.control_force") in loaded.system.connections
    assert loaded.metrics["total_variation"]["signal"] == "controller.u"
    prepare(loaded.system, loaded.experiment)


def test_one_set_of_names_serves_scenarios_that_name_less(scenario_fmus: None, tmp_path: Path) -> None:
    """Nothing names the initial depth in a dive from the surface; in a hold at 1 m something does."""
    outputs = ("depth", "depth_rate", "measured_depth")
    fmu = described(tmp_path / "boat.fmu", ("voltage[1]", "voltage[2]", "external_force"), outputs, ("z0",))
    names = {"components": {"plant": {"names": {"initial_depth": "z0"}}}}
    dive, held = (
        scenario.load(scenario.find(name), names, settings={"plant": str(fmu)})
        for name in ("nominal-extended", "hold-force-step")
    )
    assert "plant.z0" not in dive.experiment.parameters
    assert held.experiment.parameters["plant.z0"] == 1.0


def test_names_in_a_file_are_of_its_base_and_of_its_own_fmu(tmp_path: Path) -> None:
    described(tmp_path / "my.fmu", ("r", "z"), ("v1", "v2"), ("kp",))
    (tmp_path / "mine.toml").write_text(
        'base = "nominal-l1"\n[components.controller]\nfmu = "my.fmu"\n[components.controller.names]\n'
        + "".join(f'"{name}" = "{own}"\n' for name, own in MAPPED.items())
        + '[parameters]\n"controller.kp" = 1.0\n'
    )
    loaded = scenario.load(tmp_path / "mine.toml")
    assert list(loaded.experiment.signals) == ["controller.r"]
    ours = scenario.load(tmp_path / "mine.toml", settings={"controller": "L1DepthController"})
    assert ours.system == scenario.load(scenario.find("nominal-l1")).system


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
    r"my.fmu, which lacks depth_reference, measured_depth, measured_depth_rate, voltage\[1\]; nothing drives "
    r"controller.r, controller.z, plant.voltage\[1\], plant.voltage\[2\]; its outputs are v1, v2: name .* by "
    r"--map controller.depth_reference=NAME or in \[components.controller.names\]; --open-inputs start "
    r"leaves its inputs at their start values$"
)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ({}, LACKING),
        ({**MAPPED, "voltage[2]": "v3"}, r"names of controller: controller has no variable 'v3'; known: "),
        ({**MAPPED, "depth_refrence": "r"}, r"names controller.depth_refrence; nearest is 'controller.dep"),
        (
            {"depth_reference": "r", "measured_depth": "z"},
            r"lacks voltage\[1\]; .*NAME or --map .*NAME or ",
        ),
        (
            {n: o for n, o in MAPPED.items() if o != "z"},
            r"lacks measured_depth, .* drives controller.z; ",
        ),
    ],
)
def test_an_fmu_that_is_not_joined_is_refused_with_its_names(
    tmp_path: Path, names: dict[str, str], message: str
) -> None:
    with pytest.raises(ScenarioError, match=message):
        with_fmu(tmp_path, ("r", "z"), ("v1", "v2"), names)


def test_open_inputs_take_start_values_if_asked(tmp_path: Path) -> None:
    inputs = (REFERENCE, DEPTH, "enable:Boolean")
    loaded = with_fmu(tmp_path, inputs, VOLTAGES, experiment={"open_inputs": "start"})
    prepared = prepare(loaded.system, loaded.experiment)
    assert [port.name for port in prepared.system.open_inputs] == ["controller.enable"]
    assert {port.name: value for port, value in prepared.settings}["controller.enable"] is False
    with pytest.raises(ScenarioError, match=r"nothing drives controller.enable; .* --open-inputs start l"):
        with_fmu(tmp_path, inputs, VOLTAGES)


INTERFACE = """
[interface]
required = [["a.z"]]
optional = ["b.gain"]
between = { gain = "ThrustAllocation" }

[interface.inputs]
"b.x" = ["a.y", { source = "gain.voltage[1]", without = "a.y" }, 3.0]
"b.y" = [{ source = "a.z", where = "b.gain" }, 2.0]
"gain.control_force" = ["a.z"]
"gain.roll" = [0.0]
"""
BASE = """
[components]
a = "one.fmu"
b = "two.fmu"
[experiment]
stop_time = 1.0
step_size = 0.1
"""


def own_interface(
    folder: Path, outputs: tuple[str, ...], text: str = "", gain: tuple[str, ...] = ()
) -> Scenario:
    """A base of two components with an interface of its own, and a file over it."""
    described(folder / "one.fmu", (), outputs)
    described(folder / "two.fmu", ("x", "y"), ("w",), gain)
    (folder / "base.toml").write_text(BASE + INTERFACE)
    (folder / "mine.toml").write_text(f'base = "base.toml"\n{text}')
    return scenario.load(folder / "mine.toml")


def test_an_input_takes_the_first_source_that_is_there_and_whose_conditions_hold(tmp_path: Path) -> None:
    both = own_interface(tmp_path, ("y", "z"))
    assert both.system.connections == (("a.y", "b.x"),)
    assert both.experiment.inputs == {"b.y": 2.0}
    gained = own_interface(tmp_path, ("y", "z"), gain=("gain",))
    assert gained.system.connections == (("a.y", "b.x"), ("a.z", "b.y"))
    between = own_interface(tmp_path, ("z",))
    assert between.system.connections == (("a.z", "gain.control_force"), ("gain.voltage[1]", "b.x"))
    assert [*between.system.components] == ["a", "b", "gain"]
    assert between.experiment.inputs == {"gain.roll": 0.0, "b.y": 2.0}
    neither = own_interface(tmp_path, ())
    assert neither.experiment.inputs == {"b.x": 3.0, "b.y": 2.0}


@pytest.mark.parametrize(
    ("text", "connections", "inputs"),
    [
        ('[inputs]\n"b.x" = 1.0\n', (), {"b.y": 2.0, "b.x": 1.0}),
        ('[connections]\n"b.y" = "a.y"\n', (("a.y", "b.y"), ("a.y", "b.x")), {}),
        ('[connections]\n"b.x" = false\n', (), {"b.y": 2.0}),
        ('[interface.inputs]\n"b.x" = [4.0]\n', (), {"b.x": 4.0, "b.y": 2.0}),
    ],
)
def test_a_file_over_the_base_drives_an_input_otherwise(
    tmp_path: Path, text: str, connections: tuple[object, ...], inputs: dict[str, float]
) -> None:
    loaded = own_interface(tmp_path, ("y", "z"), text)
    assert loaded.system.connections == connections
    assert loaded.experiment.inputs == inputs


def test_an_input_that_loses_its_source_to_another_fmu_takes_that_of_the_interface(tmp_path: Path) -> None:
    fmu = described(tmp_path / "new.fmu", (), ("z",))
    text = '[connections]\n"b.x" = "a.y"\n[signals]\n"b.y" = { kind = "constant", value = 5.0 }\n'
    own_interface(tmp_path, ("y", "z"), text)
    loaded = scenario.load(tmp_path / "mine.toml", settings={"a": str(fmu)})
    assert loaded.system.connections == (("a.z", "gain.control_force"), ("gain.voltage[1]", "b.x"))
    assert [*loaded.experiment.signals] == ["b.y"]


def test_a_name_for_a_variable_that_an_fmu_has_not_ends_the_warning(tmp_path: Path) -> None:
    fmu = described(tmp_path / "deaf.fmu", (REFERENCE,), (*VOLTAGES, "z"))
    names = {"components": {"controller": {"names": {DEPTH: ""}}}}
    loaded = scenario.load(scenario.find("nominal-extended"), names, settings={"controller": str(fmu)})
    prepare(loaded.system, loaded.experiment)


def test_two_names_for_one_variable_are_recorded_once(tmp_path: Path) -> None:
    loaded = with_fmu(tmp_path, (REFERENCE, DEPTH), (*VOLTAGES, "u"), {"u_m": "u", "u_a": "u"})
    assert [name for name in loaded.experiment.record if name == "controller.u"] == ["controller.u"]


def test_two_values_for_one_variable_are_refused(tmp_path: Path) -> None:
    names = {"controller": {"names": {"one": "kp", "two": "kp"}}}
    base = '[parameters]\n"controller.one" = 0.5\n"controller.two" = 2.0\n'
    (tmp_path / "middle.toml").write_text('base = "nominal-extended"\n' + base)
    fmu = described(tmp_path / "my.fmu", (REFERENCE, DEPTH), VOLTAGES, ("kp",))
    message = (
        r"middle.toml:4: parameters: controller.one and controller.two both stand for "
        r"controller.kp: expected one value, got 0.5 and 2.0$"
    )
    with pytest.raises(ScenarioError, match=message):
        scenario.load(tmp_path / "middle.toml", {"components": names}, settings={"controller": str(fmu)})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('[components.a]\nnames = { v = "y" }', r"mine.toml:3: names of a: nothing names a.v; nearest is 'a"),
        ('[components.a]\nnames = { y = "v" }', r"mine.toml:3: names of a: a has no variable 'v'; "),
        (
            '[components.c]\nnames = { y = "z" }',
            r"mine.toml:2: names of c: no component 'c'; known: 'a', 'b'",
        ),
        ('[components.a]\nfmu = ""', r"mine.toml:2: no block '', and a path must end in .fmu"),
        ("[interface.inputs]\n'b.x' = [{}]", r"mine.toml:3: interface.inputs.\"b.x\"\[0\].source is missing"),
        (
            "[interface.inputs]\n'b.x' = ['d.y', 0.0]",
            r"mine.toml:3: interface: no component 'd' for 'd.y'; k",
        ),
        ("[interface.inputs]\n'b.x' = [{ derivative_of = 'b.v' }]", r"signals.\"b.x\": of = 'b.v': expected"),
    ],
)
def test_an_interface_or_a_name_that_fits_nothing_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ScenarioError, match=message):
        own_interface(tmp_path, ("y", "z"), text)


def test_a_component_between_others_is_described_only_if_an_input_needs_it(
    monkeypatch: pytest.MonkeyPatch, vehicle_fmus: None
) -> None:
    """It may not be built: what its block declares takes CasADi to know."""
    described_fmus: list[str] = []

    def variables_of(fmu: str, file: Path) -> Any:
        described_fmus.append(fmu)
        return fmu_files.variables_of(fmu, file)

    monkeypatch.setattr(scenario, "variables_of", variables_of)
    scenario.load(scenario.find("nominal-extended"))
    assert {*described_fmus} == {"L1DepthController", "RovDepthPlant"}


def test_what_a_file_over_the_base_records_has_to_be_there(scenario_fmus: None) -> None:
    """Of the ports of an interface, the base alone records those that some vehicles have."""
    loaded = scenario.load(scenario.find("nominal-l1"), {"record": {"plant.pitch_rate": True}})
    with pytest.raises(SystemDefinitionError, match=r"record: no variable 'plant.pitch_rate'"):
        prepare(loaded.system, loaded.experiment)


def test_components_between_others_that_feed_each_other_are_not_there(tmp_path: Path) -> None:
    text = """
[interface]
between = { gain = "ThrustAllocation", more = "ThrustAllocation" }
[interface.inputs]
"b.x" = ["gain.voltage[1]", 3.0]
"gain.control_force" = ["more.voltage[1]"]
"more.control_force" = ["gain.voltage[1]"]
"""
    loaded = own_interface(tmp_path, ("z",), text)
    assert [*loaded.system.components] == ["a", "b"]
    assert loaded.experiment.inputs == {"b.x": 3.0, "b.y": 2.0}
