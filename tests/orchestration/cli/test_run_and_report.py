"""What the commands run and report write, and what is kept of a run that fails."""

import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario

Command = Callable[..., Any]


@pytest.mark.slow
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


def test_run_prints_and_keeps_its_statistics_if_asked(
    command: Command, short_scenario: Command, tmp_path: Path
) -> None:
    printed = command("run", short_scenario(), "--out", "out", "--statistics").stdout
    found = json.loads((tmp_path / "out" / "short.json").read_text())["run"]["statistics"]
    assert {name: fmu["steps"] for name, fmu in found["fmus"].items()} == {"plant": 10, "controller": 10}
    assert list(found["phases_s"]) == ["loading", "initialisation", "stepping", "writing"]
    rows = {row.split("  ")[0].strip() or row.split()[0]: row.split() for row in printed.splitlines()}
    for name, fmu in found["fmus"].items():
        each = f"{1e5 * fmu['wall_s']:.3g}"  # us, of ten steps
        assert rows[name] == [name, "10", f"{1e3 * fmu['wall_s']:.3f}", each]
    for phase, wall_s in found["phases_s"].items():
        assert rows[phase] == [phase, f"{1e3 * wall_s:.3f}"]
    assert f"0.2 s at {float(format(found['real_time_factor'], '.3g')):g} times real time" in printed


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
    assert "&#34;controller.internal_step&#34; = 0.02" in text  # the resolved scenario
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


def test_a_run_that_succeeds_removes_what_a_failed_one_left_in_any_format(
    command: Command, short_scenario: Command, tmp_path: Path
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    for name in ("short.partial.csv", "short.partial.parquet", "other.partial.csv"):
        (out / name).touch()
    command("run", short_scenario(), "--out", "out", "--formats", "none")
    assert sorted(path.name for path in out.iterdir()) == ["other.partial.csv", "short.csv", "short.json"]


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
    message = refused("run", short_scenario(), "--out", "out")
    assert f"{Path('out/short.csv')}: the recording needs about" in message
    assert not list((tmp_path / "out").iterdir())


@pytest.mark.slow
def test_a_run_needs_nothing_that_draws_and_says_which_extra_a_figure_needs(
    command: Command, short_scenario: Command, tmp_path: Path
) -> None:
    path = str(short_scenario())
    code = f"""
import sys
from orchestration.cli.commands import run_command
sys.modules["matplotlib"] = None
for formats in ("none", "pdf"):
    run_command(["run", {path!r}, "--formats", formats, "--out", {str(tmp_path / "out")!r}])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr == "l1-depth: no figure: a figure needs matplotlib: pip install 'l1-depth[figures]'\n"
    assert {file.suffix for file in (tmp_path / "out").iterdir()} == {".csv", ".json"}


def test_a_run_that_an_fmu_terminates_is_complete(
    command: Command, stair: Callable[..., Path], tmp_path: Path
) -> None:
    scenario_of_a_stair = f"""
        components = {{ stair = '{stair(saves_state=True)}' }}
        experiment = {{ stop_time = 20.0, step_size = 0.5 }}
        metrics.last = {{ function = "mean", signal = "stair.counter", window = [15.0, 20.0] }}
    """
    (tmp_path / "stair.toml").write_text(scenario_of_a_stair)
    printed = command("run", "stair.toml", "--out", "out").stdout
    assert "stair terminated the simulation at t = 9 s\n" in printed
    assert re.search(r"last +not a number", printed)
    assert Recording.read(tmp_path / "out" / "stair.csv")["stair.counter"][-1] == 10.0
    document = json.loads((tmp_path / "out" / "stair.json").read_text())
    assert document["run"]["terminated"] == {"component": "stair", "time_s": 9.0, "messages": []}
    assert document["metrics"]["last"]["value"] is None
