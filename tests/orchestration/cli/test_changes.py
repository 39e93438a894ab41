"""Options that change a scenario: --controller and --set."""

import json
import shlex
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fmus.fmi.description import describe
from orchestration.cli import chosen_scenario
from orchestration.cli.changes import Changes
from orchestration.errors import FmuWarning, ScenarioError, ScenarioWarning
from orchestration.report.result import read_sweep
from orchestration.sweep import table
from orchestration.sweep.plan import plan
from orchestration.system.open_inputs import OpenInputs
from orchestration.system.quantities import StatedValue, read_value
from tests.described_fmus import described

Command = Callable[..., Any]


def test_a_controller_of_the_interface_runs_without_a_warning(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    inputs = ("setpoint", "measured_depth", "enable:Boolean")
    described(tmp_path / "my.fmu", inputs, ("voltage[1]", "voltage[2]"))
    options = ("--controller", "my.fmu", "--map", "depth_reference=setpoint", "--open-inputs", "start")
    done = command("run", "short.toml", *options, expect=1)
    open_inputs, error = done.stderr.splitlines()
    assert open_inputs == "l1-depth: open inputs at their start values: controller.enable = False"
    assert "my.fmu has no binary" in error


def test_what_is_lacking_is_one_line_also_if_the_scenario_is_refused(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario(more="[step_sizes]\nplant = 0.03\n")
    described(tmp_path / "my.fmu", ("depth_reference",), ("voltage[1]", "voltage[2]"))
    error = command("run", "short.toml", "--controller", "my.fmu", expect=1).stderr
    lacking, refusal = error.splitlines()
    assert lacking.startswith(
        "l1-depth: warning: controller is my.fmu, which lacks measured_depth: left out; "
    )
    assert "step size of plant, 0.03 s: expected a multiple" in refusal


@pytest.mark.parametrize(
    ("category", "printed"),
    [
        (ScenarioWarning, "l1-depth: warning: a part is old\n"),
        (FmuWarning, "l1-depth: warning: a part is old\n"),
        (DeprecationWarning, ""),
    ],
)
def test_a_warning_of_a_scenario_or_an_fmu_is_a_line_and_any_other_stays_one_of_python(
    command: Command, monkeypatch: pytest.MonkeyPatch, category: type[Warning], printed: str
) -> None:
    def load(*arguments: Any, **options: Any) -> Any:
        warnings.warn_explicit("a part is old", category, "part.py", 0)
        raise ScenarioError("no more is loaded")

    monkeypatch.setattr(chosen_scenario.scenario, "load", load)
    with warnings.catch_warnings(record=True) as others:
        warnings.simplefilter("always")
        done = command("run", "nominal-l1", expect=1)
    assert done.stderr == f"{printed}l1-depth: no more is loaded\n"
    assert [w.category for w in others] == ([] if printed else [category])


def test_set_changes_parameters_and_inputs(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario()
    settings = ("--set", "controller.augmentation=none", "--set", "plant.buoyancy_change = 0.2")
    command("run", "short.toml", *settings, "--formats", "none")
    scenario = json.loads((tmp_path / "results" / "short.json").read_text())["scenario"]
    assert scenario["parameters"]["controller.augmentation"] == "none"
    assert scenario["inputs"]["plant.buoyancy_change"] == 0.2
    assert scenario["title"] == "Short, controller.augmentation=none, plant.buoyancy_change=0.2"


def test_a_sweep_takes_the_same_options(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path
) -> None:
    short_scenario(more='[sweep.vary."plant.inertia"]\nvalues = [5.0]\n')
    command("sweep", "short.toml", "--sample", "0", "--set", "plant.buoyancy_change=0.2")
    document = json.loads((tmp_path / "results" / "short.sample-0.json").read_text())
    assert document["scenario"]["inputs"]["plant.buoyancy_change"] == 0.2


def test_a_report_has_the_command_that_runs_a_sample_again_with_its_options(
    command: Command, short_scenario: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    short_scenario(more='[sweep.vary."plant.inertia"]\nvalues = [5.0, 6.0]\n')
    changes = Changes.of_options("L1DepthController", ["plant.buoyancy_change=0.2"])
    swept = plan(chosen_scenario.load("short.toml", changes=changes))
    rows = [{"sample": i, **swept.values(i), "error": "not run"} for i in range(swept.count)]
    table.write(
        (json.dumps(row).encode() for row in rows),
        table.schema(swept, None),
        tmp_path / "short.sweep.parquet",
    )
    again = read_sweep(tmp_path / "short.sweep.parquet").command.replace("{sample}", "1")
    program, *arguments = shlex.split(again)
    assert program == "l1-depth"
    command(*arguments)
    document = json.loads((tmp_path / "results" / f"{swept.of_sample(1).name}.json").read_text())
    assert document["scenario"] == {**swept.of_sample(1).resolved}
    assert document["scenario"]["inputs"]["plant.buoyancy_change"] == 0.2


@pytest.mark.parametrize(
    ("assignment", "fmi_type", "value"),
    [
        ("a.p=3", "Real", 3),
        ("a.p = -1e3", "Real", -1e3),
        ("a.p=true", "Boolean", True),
        ("a.p=pi", "Enumeration", "pi"),
        ('a.p="3"', "String", "3"),
        ("a.p=1.50", "String", "1.50"),
        ("a.p=true", "String", "true"),
        ("a.p=x=y", "String", "x=y"),
        ("a.p=[1]", "String", "[1]"),
    ],
)
def test_a_value_is_written_as_in_toml_and_a_text_needs_no_quotes(
    tmp_path: Path, assignment: str, fmi_type: str, value: object
) -> None:
    (text,) = Changes.of_options("", [assignment]).settings.values()
    assert isinstance(text, StatedValue)
    variable = replace(describe(described(tmp_path / "a.fmu", ["p"])).modelVariables[0], type=fmi_type)
    assert read_value(text, variable) == value


@pytest.mark.parametrize(
    ("settings", "parameters"),
    [
        (["my.version=1.50", "my.gain=1.50"], {"my.version": "1.50", "my.gain": 1.5}),
        (["my.gain=1=5", "my.version=gain=1"], {"my.gain=1": 5.0, "my.version": "gain=1"}),
        (["my.x=y=3 "], {"my.x=y": 3.0}),
    ],
)
def test_the_longest_name_is_set_and_a_string_keeps_what_the_command_line_has(
    tmp_path: Path, settings: list[str], parameters: dict[str, Any]
) -> None:
    described(tmp_path / "my.fmu", ("u",), ("y",), parameters=("version:String", "gain", "gain=1", "x=y"))
    (tmp_path / "one.toml").write_text(
        f"[components]\nmy = '{tmp_path / 'my.fmu'}'\n[experiment]\nstop_time = 1\nstep_size = 0.1\n"
        '[inputs]\n"my.u" = 0.0\n'
    )
    changes = Changes.of_options(settings=settings)
    loaded = chosen_scenario.load(str(tmp_path / "one.toml"), changes=changes)
    assert loaded.experiment.parameters == parameters


def test_the_options_of_changes_make_them_again() -> None:
    given = ("--set", "controller=my pid.py", "--set", "plant.version=1.50", "--map", "plant.u=v")
    changes = Changes.of_options("my pid.py", ["plant.version = 1.50"], ["plant.u=v"], OpenInputs.START)
    assert changes.options() == (*given, "--open-inputs", "start")


def test_a_parameter_file_gives_values_below_those_of_set(tmp_path: Path) -> None:
    path = tmp_path / "gains.toml"
    path.write_text(
        '[parameters."controller.filter_bandwidth"]\nvalue = 1.5\nunit = "rad/s"\n'
        '[parameters."controller.augmentation"]\nvalue = "none"\n'
        '[parameters."plant.sensor_ideal"]\nvalue = true\n'
    )
    settings = ["controller.filter_bandwidth=2.5"]
    changes = Changes.of_options(settings=settings, parameters=str(path))
    loaded = chosen_scenario.load("nominal-extended", changes=changes)
    given = loaded.experiment.parameters
    names = "controller.filter_bandwidth", "controller.augmentation", "plant.sensor_ideal"
    assert [given[name] for name in names] == [2.5, "none", True]
    again = chosen_scenario.load(
        "nominal-extended", changes=Changes.of_options(settings=_assignments(changes))
    )
    assert again.experiment == loaded.experiment


@pytest.mark.parametrize(
    "arguments",
    ["run nominal-l1", "sweep monte-carlo", "margins nominal-l1", "package nominal-l1",
     "score PidDepthController"],
)  # fmt: skip
def test_a_parameter_file_is_read_by_every_command_that_runs_or_writes_gains(
    refused: Command, arguments: str
) -> None:
    """None of them ignores it: one that is not there is named."""
    assert "no file gains.toml" in refused(*arguments.split(), "--parameters", "gains.toml")


def _assignments(changes: Changes) -> list[str]:
    """Returns the arguments of --set among the options that make the changes."""
    options = changes.options()
    return [value for option, value in zip(options[::2], options[1::2], strict=True) if option == "--set"]


def test_parameters_of_a_scenario_are_a_file(command: Command) -> None:
    done = command("run", "nominal-l1", "--parameters", "gains", expect=1)
    assert "--parameters gains: expected a file that ends in .toml, or an .ssp package" in done.stderr


@pytest.mark.parametrize("assignment", ["a.p", "=3", "a.p=", ""])
def test_an_assignment_without_name_or_value_is_refused(assignment: str) -> None:
    with pytest.raises(ScenarioError, match=r"expected component\.variable=value or component=FMU"):
        Changes.of_options("", [assignment])


def test_what_is_changed_is_in_name_and_title_of_the_results() -> None:
    changes = Changes.of_options("lib/pid.fmu", ["plant=Other", "plant.inertia=3"])
    assert changes.name("nominal") == "nominal-pid-Other"
    assert changes.title("nominal") == "nominal, controller pid, plant Other, plant.inertia=3"
    assert Changes.of_options(settings=["controller.kp=3"]).title("Plain L1") == "Plain L1, controller.kp=3"
    assert Changes().title("Plain L1") == "Plain L1"


def test_a_mapped_name_begins_with_its_component() -> None:
    changes = Changes.of_options(mapped=["controller.pid.x=y", "plant.u=v", "r=w"])
    assert changes.mapping == {"controller": {"pid.x": "y", "r": "w"}, "plant": {"u": "v"}}
