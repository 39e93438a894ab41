"""Differences of two FMUs: their levels, where results differ, and the exit status."""

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from orchestration.cli.commands import run_command
from orchestration.cli.package_fmus import build_started
from orchestration.diff.behaviour import _of_recordings
from orchestration.diff.change import Level
from orchestration.diff.interface import file_changes, interface_changes
from orchestration.results.recording import Recording
from tests.described_fmus import described, redescribed
from tests.shared_builds import Fmus


def fmu(folder: Path, inputs: str = "u", units: str = "m") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return described(folder / "f.fmu", inputs.split(), ["y"], ["k"], {"y": units})


@pytest.mark.parametrize(
    ("inputs", "units", "old", "new", "level", "text"),
    [
        ("v", "m", "", "", Level.MAJOR, "input u is gone"),
        ("u v", "m", "", "", Level.MINOR, "input v is new"),
        ("u", "cm", "", "", Level.MAJOR, "y: unit m -> cm"),
        (
            "u",
            "m",
            'start="0.0"/></ScalarVariable></M',
            'start="2"/></ScalarVariable></M',
            Level.MINOR,
            "k: start",
        ),
        ("u", "m", ' canHandleVariableCommunicationStepSize="true"', "", Level.MAJOR, "canHandleVariable"),
    ],
)
def test_a_difference_of_the_interface_has_its_level(
    tmp_path: Path, inputs: str, units: str, old: str, new: str, level: Level, text: str
) -> None:
    one, plain = fmu(tmp_path / "one"), fmu(tmp_path / "other", inputs, units)
    other = redescribed(plain, tmp_path / "new.fmu", lambda xml: xml.replace(old, new) if old else xml)
    found = interface_changes(one, other)
    assert [c.level for c in found if c.text.startswith(text)] == [level]
    assert interface_changes(one, one) == []


def test_no_number_hides_one_file_alone(tmp_path: Path) -> None:
    one, other = fmu(tmp_path / "one"), fmu(tmp_path / "other")
    for count, end in ((4, "d.c"), (5, "c.c and 2 more")):
        with zipfile.ZipFile(other, "a") as archive:
            for name in "abcde"[4 * (count > 4) : count]:
                archive.writestr(f"sources/{name}.c", "")
        (text,) = (change.text for change in file_changes(one, other) if change.text.startswith("new: "))
        assert text.endswith(f"sources/{end}"), text


@pytest.mark.parametrize(("gap", "level"), [(0.5, Level.MINOR), (1e-12, Level.PATCH)])
def test_results_differ_at_an_instant_in_a_variable_and_by_rounding_at_most_is_a_patch(
    gap: float, level: Level
) -> None:
    time = np.array([0.0, 0.1, 0.2])
    values, gaps = np.array([[1.0, 2.0]] * 3), np.array([[0.0, 0.0], [0.0, 1.0], [0.5, 2.0]])
    one = Recording(("a.y", "a.z"), ("", ""), time, values)
    other = Recording(("a.y", "a.z"), ("", ""), time, values + gap * gaps)
    (change,) = _of_recordings(one, other)
    assert change.level is level
    assert "differs first at t = 0.1 s in a.z; at most by" in change.text
    assert "of a.z at t = 0.2 s" in change.text
    assert _of_recordings(one, one) == []


def test_the_exit_status_is_1_from_the_level_on_that_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The described FMUs have no library, so that neither runs, which the output states."""
    one, other = str(fmu(tmp_path / "one")), str(fmu(tmp_path / "other", "u v"))
    assert run_command(["diff", one, one]) == 0
    assert run_command(["diff", one, other, "--fail-on", "major"]) == 0
    assert run_command(["diff", one, other, "--fail-on", "minor", "--format", "github"]) == 1
    assert f"::warning file={other},title=minor interface::input v is new" in capsys.readouterr().out
    assert run_command(["diff", one, other, "--format", "json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == "minor"
    assert any("neither runs" in change["text"] for change in found["changes"])


def test_a_file_that_is_no_fmu_is_wrong_use(tmp_path: Path) -> None:
    (tmp_path / "text.fmu").write_text("no zip")
    with pytest.raises(SystemExit) as ended:
        run_command(["diff", str(fmu(tmp_path)), str(tmp_path / "text.fmu")])
    assert ended.value.code == 2


def test_one_changed_gain_of_two_builds_is_said_in_a_line(
    built: Fmus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Alone the results differ; in the scenario, whose parameters state the gain, they are equal."""
    name = "L1DepthController"
    new = build_started(built[name], {"rate_feedback_gain": 25.0}, tmp_path)
    alone = ["diff", str(built[name]), str(new)]
    printed = []
    for options in ([], ["--scenario", "nominal-extended"]):
        assert run_command([*alone, *options]) == 1
        printed.append(capsys.readouterr().out)
        assert "minor  interface  rate_feedback_gain: start 20.23 -> 25.0\n" in printed[-1]
        assert printed[-1].endswith(": minor\n")
    assert "minor  behaviour  differs first at t = 0.04 s in fmu." in printed[0]
    assert "behaviour" not in printed[1]
