"""What the commands print and write, and what a mistake is answered with."""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import typer

from fmus import catalogue, registry
from orchestration.cli.app import app
from orchestration.master import simulate
from orchestration.results.recording import Recording
from orchestration.scenarios import identify as identification
from orchestration.scenarios import scenario

Command = Callable[..., Any]


def test_help_names_every_command(command: Command) -> None:
    text = command("--help").stdout
    assert all(f" {info.callback.__name__} " in text for info in app.registered_commands if info.callback)


def test_build_check_inspect(command: Command, built: Mapping[str, Path]) -> None:
    done = command("build", "ExamplePlant", "--flavour", "python", "--out", "out")
    assert done.stdout == "out/ExamplePlant.fmu\n"
    assert "disturbance" in command("inspect", "out/ExamplePlant.fmu").stdout
    judged = command("check", built["L1Controller"]).stdout
    assert " passed" in judged
    assert "error" not in judged
    lines = command("inspect", built["L1Controller"]).stdout.splitlines()
    (augmentation,) = [line for line in lines if "augmentation" in line]
    assert "1 (none), 2 (pi), 3 (nonlinear_p)" in augmentation


def test_build_with_reference_writes_the_files_of_the_cross_check(command: Command, tmp_path: Path) -> None:
    options = ("--flavour", "python", "--out", "out", "--with-reference")
    printed = command("build", "ExamplePlant", *options).stdout.split()
    files = sorted(f"ExamplePlant{end}" for end in (".fmu", "_in.csv", "_ref.csv", "_ref.opt"))
    assert sorted(printed) == [str(Path("out") / file) for file in files]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == files


def test_new_and_build_make_the_fmu_of_a_file_beside_that_of_an_installed_block(command: Command) -> None:
    assert command("new", "pid").stdout == "pid.py\ntest_pid.py\n"
    done = command("build", "pid.py", "DepthReference", "--flavour", "python", "--out", "out")
    assert done.stdout == "out/Pid.fmu\nout/DepthReference.fmu\n"


def test_the_block_that_new_writes_runs_in_the_papers_loop_and_passes_every_rule(
    command: Command, short_scenario: Command
) -> None:
    command("new", "pid")
    command("run", short_scenario(stop=4.0), "--controller", "pid.py", "--out", "results")
    recording = Recording.read(Path("results", "short-Pid.csv"))
    assert 0.0 < recording["plant.total_force"][-1] <= 6.0
    fmu = catalogue.fmu_of_file(Path("pid.py"))
    assert re.search(r": \d+ passed, \d+ not applicable\n$", command("check", fmu).stdout)


def test_a_broken_block_of_another_package_is_named_and_stops_no_other(
    command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    points = registry.block_entry_points()
    broken = EntryPoint("Broken", "no_such_package:BLOCK", registry.GROUP)
    offered = [broken, points["DepthReference"]]
    monkeypatch.setattr(registry, "entry_points", lambda group: offered)
    done = command("build", "--flavour", "python", "--out", "out", expect=1)
    assert done.stdout == "out/DepthReference.fmu\n"
    assert "'Broken': its entry point no_such_package:BLOCK cannot be loaded" in done.stderr


def test_two_blocks_that_would_be_written_to_one_file_are_refused(command: Command, refused: Command) -> None:
    command("new", "pid")
    text = Path("pid.py").read_text()
    Path("a").mkdir()
    Path("a", "pid.py").write_text(text.replace('"Pid"', '"PID"'))
    message = refused("build", "pid.py", "a/pid.py")
    assert (
        "a/pid.py: block 'PID' would replace the FMU of block 'Pid' of pid.py: expected names that differ"
        in message
    )
    assert not Path("fmus-built").exists()


@pytest.mark.slow
def test_build_without_names_builds_all_that_ship(command: Command, tmp_path: Path) -> None:
    command("build", "--out", "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "AdrcDepthController.fmu", "DepthReference.fmu", "ExamplePlant.fmu", "L1Controller.fmu",
        "L1DepthController.fmu", "MracDepthController.fmu", "PidDepthController.fmu", "RovDepthPlant.fmu",
        "SlidingModeDepthController.fmu", "SuperTwistingDepthController.fmu", "ThrustAllocation.fmu",
    ]  # fmt: skip


def test_run_writes_recording_metrics_provenance_and_figure(
    command: Command, short_scenario: Command, tmp_path: Path
) -> None:
    done = command("run", short_scenario(), "--out", "out")
    assert done.stderr == ""  # no bar where nobody looks
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "short.csv", "short.json", "short.png",
    ]  # fmt: skip
    recording = Recording.read(tmp_path / "out" / "short.csv")
    assert recording.time[-1] == 0.2
    assert recording.unit("plant.depth") == "m"
    document = json.loads((tmp_path / "out" / "short.json").read_text())
    assert document["scenario"]["parameters"]["controller.augmentation"] == "pi"
    assert len(document["run"]["fmus"]["plant"]["guid"]) == 36
    assert set(document["metrics"]) >= {"rmse", "holding_thrust"}


def test_run_estimates_its_error_if_asked(command: Command, short_scenario: Command, tmp_path: Path) -> None:
    printed = command("run", short_scenario(), "--out", "out", "--error-estimate").stdout
    document = json.loads((tmp_path / "out" / "short.json").read_text())
    assert document["scenario"]["experiment"]["error_estimate"] is True
    estimated = document["run"]["error_estimate"]["quantities"]
    recording = Recording.read(tmp_path / "out" / "short.csv")
    assert recording.unit("error_estimate.plant.depth") == "m"
    assert recording["error_estimate.plant.depth"][-1] == estimated["plant.depth"]["at_end"]
    (row,) = [line for line in printed.splitlines() if "plant.depth " in line]
    assert f"{estimated['plant.depth']['maximum']:.2g}" in row


def test_run_writes_parquet_with_the_provenance_inside(
    command: Command, short_scenario: Command, tmp_path: Path
) -> None:
    command("run", short_scenario(), "--out", "out", "--format", "parquet", "--formats", "svg")
    assert not (tmp_path / "out" / "short.csv").exists()
    recording = Recording.read(tmp_path / "out" / "short.parquet")
    loaded = scenario.load(tmp_path / "short.toml")
    expected = simulate(loaded.system, loaded.experiment)
    assert (recording.names, recording.units) == (expected.names, expected.units)
    np.testing.assert_array_equal(recording.values, expected.values)
    assert recording.provenance["algorithm"] == "jacobi"


@pytest.mark.slow
def test_report_writes_one_page_of_what_run_wrote(
    command: Command, refused: Command, short_scenario: Command, tmp_path: Path
) -> None:
    command("run", short_scenario(), "--out", "out")
    done = command("report", "out", "--out", "pages/report.html", "--title", "Mine")
    assert (done.stdout, done.stderr) == ("pages/report.html\n", "")
    assert [path.name for path in (tmp_path / "pages").iterdir()] == ["report.html"]
    text = (tmp_path / "pages" / "report.html").read_text()
    assert "<title>Mine</title>" in text
    assert "&#34;plant.internal_step&#34; = 0.02" in text  # the resolved scenario
    assert "nearest is 'short.json'" in refused("report", "out/short.jsn")


def test_a_run_that_fails_keeps_what_was_recorded(
    refused: Command, short_scenario: Command, tmp_path: Path
) -> None:
    failing = '\n[[events]]\ntime = 0.1\nset = { "plant.sensor_noise" = 1e3, "plant.inertia" = 0.1 }\n'
    failing += '\n[[events]]\ntime = 0.12\nset = { "plant.external_force" = 1e300 }\n'
    message = refused("run", short_scenario(more=failing), "--out", "out")
    assert "plant at t = 0.12 s: fmi2DoStep returned" in message
    partial = Recording.read(tmp_path / "out" / "short.partial.csv")
    assert partial.time[-1] == pytest.approx(0.12)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["short.partial.csv"]


def test_a_recording_that_cannot_be_written_is_kept_elsewhere(
    refused: Command, short_scenario: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "out" / "short.csv").mkdir(parents=True)  # which no file replaces
    message = refused("run", short_scenario(), "--out", "out")
    match = re.search(r"short\.csv: .*; the recording is in (\S+)", message)
    assert match
    assert len(Recording.read(match[1]).time) > 1
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["short.csv"]


def test_a_run_without_room_for_its_recording_is_refused_before_it_begins(
    refused: Command, short_scenario: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=100))
    assert "out/short.csv: the recording needs about" in refused("run", short_scenario(), "--out", "out")
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nominal-l2"], "no scenario 'nominal-l2'; nearest is 'nominal-l1'"),
        (["run", "none.toml"], "no file none.toml"),
        (["build", "Exampleplan"], "no block named 'Exampleplan'; nearest is 'ExamplePlant'"),
        (["package", "nominal-l1.ssp"], "no scenario 'nominal-l1.ssp'; nearest is 'nominal-l1'"),
        (["run", "none.ssp", "--flavour", "python"], "a package: expected none, it holds its own FMUs"),
        (["build", "--platform", "linux46"], "no platform 'linux46'; nearest is 'linux64'"),
        (["build", "--platform", "linux64,"], "no platform ''"),
        (["build", "--platform", "win64", "--all-platforms"], "--platform: no effect with --all-platforms"),
        (["build", "--flavour", "python", "--platform", "win64"], "python flavour: expected none"),
        (["check", "none.fmu"], "no FMU at none.fmu"),
        (["inspect", "broken.fmu"], "broken.fmu is not an FMU: expected a zip"),
        (["check", "broken.fmu"], "1 error found: expected none"),
        (
            ["identify", "--evaluations", "5", "--starts", "9"],
            "evaluations 5: expected more than the 9 starts",
        ),
        (["build", "ExamplePlant", "--out", "broken.fmu"], "broken.fmu"),
    ],
)
def test_a_failure_is_one_line_and_exit_status_1(
    refused: Command, tmp_path: Path, arguments: list[str], message: str
) -> None:
    (tmp_path / "broken.fmu").write_text("not a zip")
    assert message in refused(*arguments)


def test_a_value_out_of_range_is_refused_before_the_run(refused: Command, short_scenario: Command) -> None:
    path = short_scenario(more='\n[parameters]\n"plant.inertia" = -1.0\n')
    assert "short.toml:26: plant.inertia = -1.0: expected 0.1..1e+06 kg" in refused("run", path)


def test_a_very_long_number_is_told_in_short(refused: Command, short_scenario: Command) -> None:
    path = short_scenario(more=f'\n[parameters]\n"plant.inertia" = 1{"0" * 4000}\n')
    assert re.search(r"plant\.inertia = 1000[0.]{30,40}: expected", refused("run", path))


def test_a_mistyped_name_offers_the_nearest(command: Command, refused: Command) -> None:
    assert "'build'" in command("buidl", expect=2).stderr
    assert "--out" in command("run", "nominal-l1", "--oot", "x", expect=2).stderr
    assert "nearest is 'pdf'" in refused("run", "nominal-l1", "--formats", "png,pfd")


def test_bad_usage_is_exit_status_2(command: Command) -> None:
    done = command("run", expect=2)
    assert "SCENARIO" in done.stderr
    done = command("build", "--flavour", "wasm", expect=2)
    assert "'wasm' is not one of 'native', 'python'" in done.stderr


def test_help_and_bad_usage_load_nothing_heavy() -> None:
    """Nothing of these is what takes the time of a command that runs nothing."""
    code = """
import contextlib, sys
from orchestration.cli.commands import run_command
for arguments in (["--help"], ["run", "-h"], ["buidl"], ["--version"]):
    with contextlib.suppress(SystemExit):
        run_command(arguments)
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    loaded = {name.partition(".")[0] for name in done.stdout.splitlines()[-1].split()}
    assert "typer" in loaded
    assert not loaded & {"numpy", "scipy", "matplotlib", "fmpy", "casadi", "pandas", "pyarrow", "dask"}


def test_a_run_without_figures_loads_nothing_that_draws(command: Command, tmp_path: Path) -> None:
    code = f"""
import sys
from orchestration.cli.commands import run_command
run_command(["run", "nominal-extended", "--formats", "none", "--out", {str(tmp_path / "out")!r}])
print(*sys.modules)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "matplotlib" not in done.stdout.splitlines()[-1].split()
    assert {file.suffix for file in (tmp_path / "out").iterdir()} == {".csv", ".json"}


def test_sweep_help_names_the_table_of_the_file(command: Command) -> None:
    assert "[sweep]" in command("sweep", "--help").stdout


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("run nominal-extended-", "nominal-extended-smooth"),
        ("build Rov", "RovDepthPlant"),
        ("rep", "reproduce"),
    ],
)
def test_shells_complete_commands_scenarios_and_blocks(
    command: Command, monkeypatch: pytest.MonkeyPatch, words: str, offered: str
) -> None:
    monkeypatch.setenv("_L1_DEPTH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", f"l1-depth {words}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    assert offered in command().stdout.split()


def _help_texts() -> dict[str, list[str]]:
    """Command -> its description, and the help of each argument and option."""
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    texts = {"": ["".join(typer.main.get_command(app).help or "")]}
    for name, described in commands.items():
        texts[name] = [described.help, *(parameter.help for parameter in described.params)]
    return texts


@pytest.mark.parametrize("name", _help_texts())
def test_help_is_whole_sentences_and_loses_no_word_to_markup(
    command: Command, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr("typer.rich_utils.MAX_WIDTH", 400)  # nothing is wrapped
    printed = " ".join(command(*name.split(), "--help").stdout.split())
    for text in _help_texts()[name]:
        assert " ".join(text.split()) in printed
        assert text[0].isupper()
        assert text.endswith(".")


def test_inspect_prints_json_for_programs(command: Command, built: Mapping[str, Path]) -> None:
    document = json.loads(command("inspect", built["L1Controller"], "--json").stdout)
    assert (document["name"], document["fmi_version"]) == ("L1Controller", "2.0")
    variables = {variable["name"]: variable for variable in document["variables"]}
    assert variables["augmentation"]["permitted"] == {"1": "none", "2": "pi", "3": "nonlinear_p"}
    gain = variables["adaptation_gain"]
    assert (gain["causality"], gain["type"]) == ("parameter", "Real")
    assert float(gain["start"]) > 0.0
    assert set(gain) == {"name", "causality", "type", "unit", "start", "permitted", "description"}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["run", "nominal-l1", "--every", "1"], "--every 1: expected --checkpoint FILE beside it"),
        (["sweep", "monte-carlo", "--sample", "1", "--restart"], "--restart: no effect with --sample"),
        (["sweep", "monte-carlo", "--sample", "1", "--recordings", "all"], "--recordings: no effect with"),
        (["sweep", "monte-carlo", "--sample", "1", "--workers", "2"], "--workers: no effect with --sample"),
        (
            ["sweep", "monte-carlo", "--scheduler", "a", "--workers", "2"],
            "--workers: no effect with --scheduler",
        ),
        (["sweep", "monte-carlo", "--recordings", "plant.dpeth"], "'plant.dpeth'; nearest is 'plant.depth'"),
    ],
)
def test_an_option_without_effect_is_refused(refused: Command, arguments: list[str], message: str) -> None:
    assert message in refused(*arguments)


def test_identify_writes_to_the_working_folder_and_not_into_the_package(
    command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    gains = {gain.name: gain.low for gain in identification.GAINS}
    fit = identification.Fit(gains, {}, {}, cost=0.0, evaluations=2, seed=1)
    monkeypatch.setattr(identification, "identify", lambda *arguments: fit)
    shipped = scenario.SHIPPED / "parameters" / "identified.toml"
    before = shipped.read_bytes()
    assert command("identify").stdout.endswith("\nidentified.toml\n")
    assert scenario.parameter_values(tmp_path / "identified.toml") == gains
    assert shipped.read_bytes() == before


def test_a_run_that_an_fmu_terminates_is_complete(
    command: Command, stair: Callable[..., Path], tmp_path: Path
) -> None:
    scenario_of_a_stair = f"""
        components = {{ stair = "{stair(saves_state=True)}" }}
        experiment = {{ stop_time = 20.0, step_size = 0.5 }}
        metrics.last = {{ function = "mean", signal = "stair.counter", window = [15.0, 20.0] }}
    """
    (tmp_path / "stair.toml").write_text(scenario_of_a_stair)
    printed = command("run", "stair.toml", "--out", "out").stdout
    assert "stair terminated the simulation at t = 9 s\n" in printed
    assert re.search(r"last +│ +not a number", printed)
    assert Recording.read(tmp_path / "out" / "stair.csv")["stair.counter"][-1] == 10.0
    document = json.loads((tmp_path / "out" / "stair.json").read_text())
    assert document["run"]["terminated"] == {"component": "stair", "time_s": 9.0, "messages": []}
    assert document["metrics"]["last"]["value"] is None
