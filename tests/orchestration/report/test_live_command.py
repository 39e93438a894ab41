"""What the command live refuses before it compiles, and its sliders; report/test_live.py opens its pages."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from orchestration.report.live_page import default_sliders
from orchestration.scenarios import scenario

GAINS = (
    "depth_feedback_gain",
    "rate_feedback_gain",
    "filter_bandwidth",
    "proportional_gain",
    "integral_gain",
)


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["--slider", "plant.mas"], "a constant input of type Real; nearest is 'plant.inertia'"),
        (["--slider", "plant.depth"], "--slider plant.depth: expected a parameter or a constant input"),
        (["--slider", "plant.voltage[1]"], "--slider plant.voltage[1]: expected a parameter or a constant"),
        (["--slider", "controller.depth_reference"], "--slider controller.depth_reference: expected a"),
        (["--slider", "plant.sensor_seed"], "--slider plant.sensor_seed: expected a parameter"),
        (["--slider", "plant.inertia=7:5"], "plant.inertia=7:5: expected finite limits, the lower one first"),
        (["--slider", "plant.inertia=5"], "--slider plant.inertia=5: expected NAME or NAME=LOW:HIGH"),
        (["--slider", "plant.inertia=-5:5"], "--slider plant.inertia=-5:5: expected limits within"),
        (["--beside", "controller.augmentation"], "expected component.variable=value"),
    ],
)
def test_what_does_not_fit_is_refused(
    options: list[str], expected: str, refused: Callable[..., str], scenario_fmus: None, tmp_path: Path
) -> None:
    assert expected in refused("live", "nominal-extended", *options, "--out", "page.html")
    assert not (tmp_path / "page.html").exists()


def test_runs_of_other_systems_are_refused(command: Callable[..., Any], scenario_fmus: None) -> None:
    done = command("live", "nominal-extended", "--beside", "controller=PidDepthController", expect=1)
    assert "expected the same system and experiment but for values of parameters" in done.stderr


def test_gains_vehicle_and_disturbances_have_sliders(scenario_fmus: None) -> None:
    sliders = {s.name: s for s in default_sliders(scenario.load(scenario.find("nominal-extended")))}
    names = [f"controller.{name}" for name in GAINS]
    names += [f"plant.{name}" for name in ("sensor_noise", "inertia", "linear_damping", "quadratic_damping")]
    names += [f"plant.{name}" for name in ("buoyancy_change", "thrust", "delay")]
    assert [*sliders] == [*names, "plant.external_force", "plant.current_velocity"]
    assert sliders["plant.thrust"].variables == ("plant.thruster_gain[1]", "plant.thruster_gain[2]")
    assert (sliders["plant.thrust"].low, sliders["plant.thrust"].high) == (0.2, 0.3)
    gain = sliders["controller.proportional_gain"]
    assert gain.high / gain.low == pytest.approx(16.0, rel=1e-15)


def test_a_range_of_a_slider_ends_where_that_of_its_variable_does(scenario_fmus: None) -> None:
    one = scenario.load(scenario.find("nominal-extended"), settings={"controller.voltage_limit": 9e5})
    (slider,) = [s for s in default_sliders(one) if s.name == "controller.voltage_limit"]
    assert (slider.low, slider.high) == (9e5 / 4.0, 1e6)


def test_thrusters_that_differ_have_no_slider_in_common(scenario_fmus: None) -> None:
    one = scenario.load(scenario.find("nominal-extended"), settings={"plant.thruster_gain[1]": 0.2})
    assert "plant.thrust" not in {s.name for s in default_sliders(one)}


def test_an_input_that_something_drives_has_no_slider(scenario_fmus: None) -> None:
    loaded = scenario.load(scenario.find("hold-force-step"))
    assert "plant.external_force" in loaded.experiment.signals
    assert "plant.external_force" not in {s.name for s in default_sliders(loaded)}


@pytest.mark.parametrize(
    ("name", "options", "runs"),
    [
        ("nominal-extended", [], ["Nominal, extended L1 (PI)", "controller.augmentation=none"]),
        ("nominal-l1", [], ["Nominal, plain L1"]),
        ("nominal-l1", ["--beside", "plant.inertia=7"], ["Nominal, plain L1", "plant.inertia=7"]),
    ],
)
def test_the_run_beside_has_another_value(
    name: str,
    options: list[str],
    runs: list[str],
    command: Callable[..., Any],
    scenario_fmus: None,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """By default a controller whose extension is on stands beside itself without."""
    # the first program that a machine compiles for WebAssembly takes half a minute
    monkeypatch.setattr("orchestration.report.live_page.program", lambda prepared, settings: b"\0asm")
    assert command("live", name, *options, "--out", "page.html").stdout == "page.html\n"
    text = Path("page.html").read_text(encoding="utf-8")
    (data,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text)
    written = json.loads(data)["runs"]
    assert [run["label"] for run in written] == runs
    differences = [pair for pair in zip(*(run["values"] for run in written), strict=True) if len({*pair}) > 1]
    assert len(differences) == len(runs) - 1
