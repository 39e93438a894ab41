"""Differences of two FMUs: their levels, where results differ, and the exit status."""

import json
import re
import zipfile
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path

import numpy as np
import pytest

from fmus.block import Block, variable
from fmus.files import write_archive
from fmus.fmi.description import describe
from fmus.generate import builder
from fmus.numerics import where
from orchestration.cli.commands import run_command
from orchestration.cli.package_fmus import build_started
from orchestration.diff import behaviour
from orchestration.diff.behaviour import _of_recordings, _signal, speed
from orchestration.diff.change import Change, Level
from orchestration.diff.command import _changes
from orchestration.diff.interface import file_changes, interface_changes
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.described_fmus import XML, described, members, redescribed
from tests.shared_builds import Fmus


@pytest.fixture
def _in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each run of a comparison starts a process, which takes longer than the run."""

    def here(system: System, experiment: Experiment, timeout: float, statistics: bool = False) -> Recording:
        return simulate(system, experiment, statistics=statistics)

    monkeypatch.setattr(behaviour, "simulate", here)


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
        ("u", "m", 'causality="output"', 'causality="local"', Level.MAJOR, "y: causality output -> local"),
        ("u", "m", 'guid="none"', 'guid="x" numberOfEventIndicators="2"', Level.PATCH, "numberOfEvent"),
        (
            "u",
            "m",
            "<ModelVariables>",
            '<DefaultExperiment stepSize="0.5"/><ModelVariables>',
            Level.MINOR,
            "default experiment: stepSize None -> 0.5",
        ),
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


@pytest.mark.parametrize("column", [0, 1])
def test_a_value_that_is_no_number_in_one_run_alone_is_the_largest_difference(column: int) -> None:
    time, values = np.array([0.0, 0.1]), np.array([[1.0, 2.0], [1.0, np.nan]])
    other = np.array([[1.5, 2.5], [1.0, np.nan]])
    other[1, column] = 3.0 if column else np.nan
    one, two = (Recording(("a.y", "a.z"), ("", ""), time, v) for v in (values, other))
    (change,) = _of_recordings(one, two)
    assert f"at most by nan of {('a.y', 'a.z')[column]} at t = 0.1 s" in change.text
    assert change.level is Level.MINOR
    assert _of_recordings(two, two) == []


def test_a_run_that_ends_earlier_is_a_major_change() -> None:
    time = np.array([0.0, 0.1, 0.2])
    whole = Recording(("a.y",), ("",), time, np.ones((3, 1)))
    short = Recording(("a.y",), ("",), time[:2], np.ones((2, 1)))
    (change,) = _of_recordings(whole, short)
    assert (change.level, change.text) == (Level.MAJOR, "ends at t = 0.2 s -> 0.1 s")
    (change,) = _of_recordings(short, whole)
    assert change.level is Level.MINOR


@pytest.mark.usefixtures("_in_this_process")
def test_texts_are_not_compared(foreign: Fmus) -> None:
    assert behaviour.behaviour_changes(foreign["Diary"], foreign["Diary"], 10.0) == []


def test_runs_that_have_no_variable_in_common_do_not_differ() -> None:
    one, other = (Recording((name,), ("",), np.zeros(1), np.ones((1, 1))) for name in ("a.y", "a.z"))
    assert _of_recordings(one, other) == []


@pytest.mark.usefixtures("_in_this_process")
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


@pytest.mark.slow
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
    assert "minor  behaviour  ModelExchange: differs first at t = " in printed[0]
    assert "behaviour" not in printed[1]


@pytest.mark.slow
@pytest.mark.usefixtures("_in_this_process")
def test_an_fmu_that_no_longer_runs_is_a_major_change(built: Fmus, tmp_path: Path) -> None:
    whole = built["ExamplePlant"]
    files = {name: content for name, content in members(whole).items() if not name.startswith("binaries/")}
    broken = write_archive(tmp_path / "broken.fmu", files)
    for pair, level in (((whole, broken), Level.MAJOR), ((broken, whole), Level.MINOR)):
        changes = [c for c in compared(*pair) if c.part == "behaviour" and "a whole run" in c.text]
        assert [change.level for change in changes] == [level] * 2  # of both interfaces


class Mode(IntEnum):
    """What the output does."""

    HOLD = 1
    RISE = 2


@dataclass(frozen=True)
class ModeInputs:
    enabled: bool = variable(False, "Whether the output moves")
    mode: Mode = variable(Mode.HOLD, "Mode")


@dataclass(frozen=True)
class Ramp:
    y: float = variable(0.0, "Output")


@pytest.mark.slow
@pytest.mark.usefixtures("_in_this_process")
@pytest.mark.parametrize("name", ["enabled", "mode"])
def test_a_gain_that_acts_behind_a_boolean_or_an_item_is_found(tmp_path: Path, name: str) -> None:
    """At the start values of these inputs the output is 0."""

    def built_with(gain: float) -> Path:
        def step(t: float, h: float, s: Ramp, u: ModeInputs, p: object, c: object) -> Ramp:
            moves = u.enabled if name == "enabled" else u.mode == Mode.RISE
            return Ramp(s.y + where(moves, h * gain, 0.0))

        block = Block(
            "Switched",
            "A ramp that an input starts",
            inputs=ModeInputs,
            state=Ramp,
            outputs=Ramp,
            step=step,
            output=lambda t, s, p, c: s,
        )
        return builder.build_block(block, tmp_path / str(gain))

    slow, fast = built_with(1.0), built_with(1.5)
    (change,) = (c for c in compared(slow, fast) if c.part == "behaviour")
    assert change.level is Level.MINOR
    assert re.match(
        r"differs first at t = 0\.51 s in fmu\.y; at most by 0\.25 of fmu\.y at t = 1 s", change.text
    )


def compared(old: Path, new: Path) -> list[Change]:
    return _changes(old, new, 30.0, "", "")


@pytest.mark.slow
@pytest.mark.usefixtures("_in_this_process")
def test_of_an_fmu_with_both_interfaces_both_are_compared(built: Fmus, tmp_path: Path) -> None:
    def changed(name: str, old: str, new: str) -> Path:
        return redescribed(built["WaveSource"], tmp_path / name, lambda xml: re.sub(old, new, xml, count=1))

    whole = built["WaveSource"]
    alone = changed("alone.fmu", "(?s)<ModelExchange.*</ModelExchange>", "")
    assert compared(whole, alone) == [Change(Level.MAJOR, "interface", "ModelExchange is gone")]
    assert compared(alone, whole) == [Change(Level.MINOR, "interface", "ModelExchange is new")]
    saving = 'canGetAndSetFMUstate="true" canSerializeFMUstate="true"'
    lacking = changed("lacking.fmu", f"(?<=<ModelExchange )(.*?){saving}", r"\1")
    assert [(level, text) for level, _, text in compared(whole, lacking)] == [
        (Level.MAJOR, "ModelExchange: canGetAndSetFMUstate true -> false"),
        (Level.MAJOR, "ModelExchange: canSerializeFMUstate true -> false"),
    ]


@pytest.mark.usefixtures("_in_this_process")
def test_one_block_in_both_standards_gives_the_same_results(built: Fmus, fmi3_built: Fmus) -> None:
    """An importer of FMI 2.0 alone cannot read the other; arrays have the names of their scalars."""
    found = compared(built["ExamplePlant"], fmi3_built["ExamplePlant"])
    assert [c.text for c in found if c.level is Level.MAJOR and c.part == "interface"] == ["FMI 2.0 -> 3.0"]
    assert {c.part for c in found} == {"interface", "files"}
    assert not [c for c in found if " is gone" in c.text]
    assert [c.text for c in found if " is new" in c.text] == ["independent time is new"]


@pytest.mark.slow
def test_an_array_in_place_of_a_scalar_is_named(tmp_path: Path) -> None:
    array = (
        '<Float64 name="u" valueReference="1" causality="input" start="0"><Dimension start="2"/></Float64>'
    )
    description = (
        '<fmiModelDescription fmiVersion="3.0" modelName="f" instantiationToken="none">'
        f'<CoSimulation modelIdentifier="described"/><ModelVariables>{array}</ModelVariables>'
        "<ModelStructure/></fmiModelDescription>"
    )
    new = write_archive(tmp_path / "array.fmu", {XML: description.encode()})
    texts = [c.text for c in compared(fmu(tmp_path), new)]
    assert [text for text in texts if "input" in text] == [
        "input u is gone",
        "input u[1] is new",
        "input u[2] is new",
    ]


@pytest.mark.slow
def test_the_speed_is_told_and_is_no_difference(
    built: Fmus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plant = built["ExamplePlant"]
    other = redescribed(plant, tmp_path / "other.fmu", lambda xml: xml + "<!-- same -->")
    assert run_command(["diff", str(plant), str(other)]) == 0
    told, verdict = capsys.readouterr().out.splitlines()
    assert re.fullmatch(r"speed  a step takes \S+ times the CPU time: \S+ us -> \S+ us", told)
    assert verdict.endswith(": equal")


@pytest.mark.slow
def test_the_speed_is_the_ratio_of_the_new_one_to_the_old_one(built: Fmus, tmp_path: Path) -> None:
    plant = built["ExamplePlant"]
    (step,) = (float(v.start or 0) for v in describe(plant).modelVariables if v.name == "internal_step")
    slow = build_started(plant, {"internal_step": step / 60.0}, tmp_path)
    # 4 here: a call, and reading the clock, take time whatever the internal step is
    assert float(speed(plant, slow, 30.0).split()[3]) > 2.0
    assert float(speed(slow, plant, 30.0).split()[3]) < 0.5


@pytest.mark.parametrize("start", ["0.0", "2.0", "-1.0"])
def test_inputs_move_inside_their_declared_range_also_where_they_start_at_its_end(
    tmp_path: Path, start: str
) -> None:
    def limited(xml: str) -> str:
        return xml.replace('<Real start="0.0"/>', f'<Real start="{start}" min="-1" max="2"/>', 1)

    (u, *_) = describe(redescribed(fmu(tmp_path), tmp_path / "limited.fmu", limited)).modelVariables
    values = _signal(u, 0, 10.0).at(np.linspace(0.0, 10.0, 1000))
    assert -1.0 <= values.min() < values.max() <= 2.0
    assert np.ptp(values) > 1.0  # a third of the range: two sines of a quarter and an eighth of it
