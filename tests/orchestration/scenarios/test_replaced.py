"""A component of a scenario is replaced by another FMU: what it inherits, and what is left out."""

import shutil
from pathlib import Path

import pytest

from fmus.registry import fmu_path
from orchestration.errors import OrchestrationError, ScenarioError, ScenarioWarning
from orchestration.results.metric_units import metric_units
from orchestration.scenarios import scenario
from orchestration.scenarios.scenario import Scenario
from orchestration.system.prepared_run import prepare
from orchestration.system.quantities import StatedValue
from tests.described_fmus import described, redescribed

INPUTS = ("depth_reference", "measured_depth")
VOLTAGES = ("voltage[1]", "voltage[2]")


def child(folder: Path, text: str = "", base: str = "nominal-extended") -> Path:
    path = folder / "child.toml"
    path.write_text(f'base = "{base}"\n' + text)
    return path


def with_controller(folder: Path, text: str = "", parameters: tuple[str, ...] = ()) -> Scenario:
    described(folder / "pid.fmu", INPUTS, VOLTAGES, ("internal_step", *parameters))
    path = child(folder, '[components]\ncontroller = "pid.fmu"\n' + text)
    return scenario.load(path)


def test_what_fits_stays_and_the_rest_is_left_out_without_a_word(tmp_path: Path) -> None:
    loaded = with_controller(tmp_path)
    ours = scenario.load(scenario.find("nominal-extended"))
    of_controller = [name for name in loaded.experiment.parameters if name.startswith("controller.")]
    assert of_controller == ["controller.internal_step"]
    assert "controller.roll" not in loaded.experiment.inputs
    assert list(loaded.experiment.signals) == ["controller.depth_reference"]
    dropped = ("plant.depth_rate", "controller.measured_depth_rate")
    assert loaded.system.connections == tuple(c for c in ours.system.connections if c != dropped)
    assert [n for n in loaded.experiment.record if n.startswith("c")] == ["controller.depth_reference"]
    assert set(ours.metrics) - set(loaded.metrics) == {"total_variation"}
    assert loaded.resolved["record"] == list(loaded.experiment.record)


def warnings_of(caught: pytest.WarningsRecorder) -> list[str]:
    return [str(warning.message) for warning in caught]


def test_a_line_names_what_the_scenario_does_not_mark_optional(tmp_path: Path) -> None:
    """Followed, each of its two hints ends it."""
    fmu = described(tmp_path / "deaf.fmu", ("depth_reference",), (*VOLTAGES, "z"))
    path, settings = scenario.find("nominal-extended"), {"controller": str(fmu)}
    with pytest.warns(ScenarioWarning) as caught:
        scenario.load(path, settings=settings)
    assert warnings_of(caught) == [
        "controller is deaf.fmu, which lacks measured_depth: left out; name those that stand for others by "
        "--map controller.measured_depth=NAME or in [components.controller.names]; list those that it may "
        'lack in [interface], optional = ["controller.measured_depth"]'
    ]
    optional = {"interface": {"optional": ["controller.measured_depth"]}}
    loaded = scenario.load(path, optional, settings=settings)
    assert "interface" not in loaded.resolved
    described(tmp_path / "deaf.fmu", ("depth_reference", "z"), VOLTAGES)
    names = {"components": {"controller": {"names": {"measured_depth": "z"}}}}
    scenario.load(path, names, settings=settings)


def test_a_signal_on_an_input_that_is_lacking_ends_its_line_by_the_hint_in_a_file_above(
    tmp_path: Path,
) -> None:
    """What the base marks optional does not cover a disturbance of a file above it."""
    fmu = described(
        tmp_path / "deaf.fmu", VOLTAGES, ("depth", "measured_depth", "depth_rate"), ("initial_depth",)
    )
    with pytest.warns(ScenarioWarning, match="lacks current_velocity: left out"):
        scenario.load(scenario.find("hold-current"), settings={"plant": str(fmu)})
    scenario.load(
        child(tmp_path, '[interface]\noptional = ["plant.current_velocity"]\n', "hold-current"),
        settings={"plant": str(fmu)},
    )


def test_a_line_names_a_few_of_many(tmp_path: Path) -> None:
    names = "".join(f'"controller.k{i}" = 1.0\n' for i in range(9))
    fmu = described(tmp_path / "pid.fmu", INPUTS, VOLTAGES)
    with pytest.warns(ScenarioWarning, match=r"lacks k0, k1, k2, k3, k4, k5 and 3 more: left out; "):
        scenario.load(child(tmp_path, f"[parameters]\n{names}"), settings={"controller": str(fmu)})


def test_a_line_names_the_parameters_that_the_new_fmu_takes(tmp_path: Path) -> None:
    """Gains that were chosen for another controller are not taken in silence; its hint ends the line."""
    fmu = described(tmp_path / "pid.fmu", INPUTS, VOLTAGES, ("proportional_gain",))
    path, settings = scenario.find("nominal-extended"), {"controller": str(fmu)}
    with pytest.warns(ScenarioWarning) as caught:
        gain = scenario.load(path, settings=settings).experiment.parameters["controller.proportional_gain"]
    assert warnings_of(caught) == [
        f"controller is pid.fmu, which takes proportional_gain = {gain} of the scenario; its own by "
        "--set controller.proportional_gain=0.0"
    ]
    scenario.load(path, settings={**settings, "controller.proportional_gain": StatedValue("0.0")})


def test_a_copy_of_the_controller_takes_all_without_a_word(scenario_fmus: None, tmp_path: Path) -> None:
    copy = shutil.copy(fmu_path("L1DepthController"), tmp_path / "copy.fmu")
    ours = scenario.load(scenario.find("nominal-extended"))
    loaded = scenario.load(scenario.find("nominal-extended"), settings={"controller": str(copy)})
    assert loaded.experiment.parameters == ours.experiment.parameters


def test_a_variable_of_another_causality_or_range_does_not_fit(tmp_path: Path) -> None:
    described(tmp_path / "pid.fmu", INPUTS, (*VOLTAGES, "augmentation"), ("roll", "internal_step:Integer"))
    loaded_path = child(tmp_path, '[components]\ncontroller = "pid.fmu"\n')
    loaded = scenario.load(loaded_path)
    assert not [n for n in (*loaded.experiment.parameters, *loaded.experiment.inputs) if n[0] == "c"]


def test_what_the_replacing_scenario_gives_is_never_dropped(tmp_path: Path) -> None:
    loaded = with_controller(
        tmp_path, '[parameters]\n"controller.kp" = 3.0\n"controller.kd" = 1.0\n', ("kp",)
    )
    assert loaded.experiment.parameters["controller.kp"] == 3.0
    assert loaded.experiment.parameters["controller.kd"] == 1.0  # an error when the run is prepared


def test_what_fits_the_last_fmu_counts_whatever_stood_between(tmp_path: Path) -> None:
    with_controller(tmp_path, '[parameters]\n"controller.kp" = 3.0\n', ("kp",))
    with pytest.warns(ScenarioWarning, match=r"L1DepthController, which lacks kp: left out"):
        loaded = scenario.load(tmp_path / "child.toml", settings={"controller": "L1DepthController"})
    ours = scenario.load(scenario.find("nominal-extended"))
    assert (loaded.system, loaded.experiment) == (ours.system, ours.experiment)


def test_settings_name_components_parameters_and_inputs(tmp_path: Path) -> None:
    settings = {"controller.adaptation_gain": 50.0, "plant.buoyancy_change": 0.1}
    loaded = scenario.load(scenario.find("nominal-l1"), settings=settings)
    assert loaded.experiment.parameters["controller.adaptation_gain"] == 50.0
    assert loaded.experiment.inputs["plant.buoyancy_change"] == 0.1


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("contrller", r"no component 'contrller' to replace; nearest is 'controller'"),
        ("contrller.kp", r"no component 'contrller'; nearest is 'controller'"),
        ("controller.adaption_gain", r"parameter or an input; nearest is 'controller.adaptation_gain'"),
        ("controller.demanded_force", r"= 'x.fmu': expected a parameter or an input"),
        ("controller", r"no FMU at .*x.fmu"),
    ],
)
def test_a_misspelt_setting_offers_the_nearest(name: str, message: str) -> None:
    with pytest.raises(Exception, match=message) as caught:
        scenario.load(scenario.find("nominal-l1"), settings={name: "x.fmu"})
    assert isinstance(caught.value, OrchestrationError)


def test_events_faults_and_a_sweep_of_a_replaced_component_are_dropped_too(tmp_path: Path) -> None:
    described(tmp_path / "pid.fmu", INPUTS, VOLTAGES)
    base = """
[[events]]
time = 1.0
set = { "controller.adaptation_gain" = 1.0, "plant.roll" = 0.1 }
[[events]]
time = 2.0
set = { "controller.adaptation_gain" = 1.0 }
[[faults]]
input = "controller.measured_depth_rate"
kind = "freeze"
[[faults]]
input = "controller.measured_depth"
kind = "freeze"
[sweep]
vary = { "controller.adaptation_gain" = { values = [1.0] }, "plant.inertia" = { values = [5.0] } }
"""
    with pytest.warns(ScenarioWarning, match="which lacks adaptation_gain: left out"):
        loaded = scenario.load(child(tmp_path, base), settings={"controller": str(tmp_path / "pid.fmu")})
    assert [dict(event.values) for event in loaded.experiment.events] == [{"plant.roll": 0.1}]
    assert [fault.input for fault in loaded.experiment.faults] == ["controller.measured_depth"]
    assert list(loaded.sweep["vary"]) == ["plant.inertia"]


def test_a_shipped_base_has_a_name(tmp_path: Path) -> None:
    loaded = scenario.load(child(tmp_path, base="vehicle"))
    assert loaded.resolved["components"] == {"plant": "RovDepthPlant", "controller": "L1DepthController"}
    with pytest.raises(ScenarioError, match=r"no scenario 'vehicl'; nearest is 'vehicle'"):
        scenario.load(child(tmp_path, base="vehicl"))


def test_what_the_new_fmu_can_take_is_not_dropped_for_its_causality(tmp_path: Path) -> None:
    """Any variable can be recorded, and an output with initial = "exact" has a start value to set."""
    plain = described(tmp_path / "plain.fmu", INPUTS, VOLTAGES, ("internal_step", "u_m"))
    parameter, output = 'parameter" variability="tunable"', 'output" variability="continuous"'
    exact = f'{output} initial="exact"'
    fmu = redescribed(plain, tmp_path / "pid.fmu", lambda xml: xml.replace(parameter, exact, 1))
    loaded = scenario.load(child(tmp_path), settings={"controller": str(fmu)})
    assert loaded.experiment.parameters["controller.internal_step"] == 0.02
    assert "controller.u_m" in loaded.experiment.record


def test_an_event_on_what_is_fixed_in_the_new_fmu_is_dropped(tmp_path: Path) -> None:
    event = '[[events]]\ntime = 1.0\nset = { "controller.internal_step" = 0.04 }\n'
    with_controller(tmp_path, event)
    loaded = scenario.load(tmp_path / "child.toml", settings={"controller": "L1DepthController"})
    assert loaded.experiment.events == ()


@pytest.mark.parametrize("name", [name for name in scenario.shipped() if not name.startswith("example")])
def test_metrics_have_their_units_with_a_controller_that_states_none(
    scenario_fmus: None, tmp_path: Path, name: str
) -> None:
    """The interface fixes them."""
    fmu = described(tmp_path / "pid.fmu", INPUTS, ("control_force",))
    loaded = scenario.load(scenario.find(name), settings={"controller": str(fmu)})
    ports = prepare(loaded.system, loaded.experiment).system.ports
    units = metric_units(loaded.metrics, {n: port.variable.unit or "" for n, port in ports.items()})
    assert units["total_variation"] == "N"
    assert all(units.values())
