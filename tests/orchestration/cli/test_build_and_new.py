"""What the commands build and new write, and which blocks they refuse."""

import re
import zipfile
from collections.abc import Callable, Mapping
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import pytest

from fmus import registry
from fmus.generate import builder
from orchestration.results.recording import Recording
from tests.mutants.mutant import broken_rules as static_broken_rules

Command = Callable[..., Any]


def test_what_is_built_can_be_inspected(command: Command, built: Mapping[str, Path]) -> None:
    command("build", "ExamplePlant", "--flavour", "python", "--out", "out")
    assert "disturbance" in command("inspect", "out/ExamplePlant.fmu").stdout
    lines = command("inspect", built["L1Controller"]).stdout.splitlines()
    (augmentation,) = [line for line in lines if "augmentation" in line]
    assert "1 (none), 2 (pi), 3 (nonlinear_p)" in augmentation


def test_build_with_reference_writes_the_files_of_the_cross_check(command: Command, tmp_path: Path) -> None:
    options = ("--flavour", "python", "--out", "out", "--with-reference")
    printed = command("build", "ExamplePlant", *options).stdout.split()
    files = sorted(f"ExamplePlant{end}" for end in (".fmu", "_in.csv", "_ref.csv", "_ref.opt"))
    assert sorted(printed) == [str(Path("out") / file) for file in files]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == files


def test_build_writes_fmus_of_fmi_3_to_a_folder_of_their_own(command: Command, refused: Command) -> None:
    written = command("build", "ExamplePlant", "--fmi", "3").stdout.replace("\\", "/")
    assert written == "fmus-built/fmi3/ExamplePlant.fmu\n"
    description = zipfile.ZipFile("fmus-built/fmi3/ExamplePlant.fmu").read("modelDescription.xml")
    assert b'<fmiModelDescription fmiVersion="3.0"' in description
    build = ("build", "ExamplePlant", "--fmi", "3")
    assert "--fmi: no effect with --cache" in refused(*build, "--cache")
    assert b'name="state[2]"' not in description
    command(*build, "--scalars")
    description = zipfile.ZipFile("fmus-built/fmi3/ExamplePlant.fmu").read("modelDescription.xml")
    assert b'name="state[2]"' in description
    assert "expected FMI 3.0" in refused("build", "ExamplePlant", "--scalars")
    assert "expected FMI 2.0, or 3.0 in native" in refused(*build, "--flavour", "python")
    assert "expected the native flavour and FMI 2.0" in refused(*build, "--reals-only")


@pytest.mark.slow
def test_new_and_build_make_the_fmu_of_a_file_beside_that_of_an_installed_block(command: Command) -> None:
    assert command("new", "pid").stdout == "pid.py\ntest_pid.py\n"
    done = command("build", "pid.py", "DepthReference", "--flavour", "python", "--out", "out")
    assert done.stdout.replace("\\", "/") == "out/Pid.fmu\nout/DepthReference.fmu\n"


@pytest.mark.slow
def test_new_writes_a_block_without_depth_and_no_two_kinds_at_once(
    command: Command, refused: Command
) -> None:
    assert "--vehicle: no effect with --plain" in refused("new", "room", "--plain", "--vehicle")
    assert not Path("room.py").exists()
    assert command("new", "room", "--plain").stdout == "room.py\ntest_room.py\n"
    written = Path("room.py").read_text() + Path("test_room.py").read_text()
    assert "depth" not in written.replace("l1-depth build", "")
    done = command("build", "room.py", "--flavour", "python", "--out", "out")
    assert done.stdout.replace("\\", "/") == "out/Room.fmu\n"


@pytest.mark.slow
def test_build_writes_the_fmu_of_a_class_and_no_other(command: Command, refused: Command) -> None:
    Path("own.py").write_text(
        "class Own:\n    period = 0.1\n    def reset(self): pass\n"
        "    def step(self, time, inputs): return {'control_force': 1.0}\n"
    )
    assert command("build", "own.py:Own", "--out", "out").stdout.replace("\\", "/") == "out/Own.fmu\n"
    assert "control_force" in command("inspect", "out/Own.fmu").stdout
    built = command("build", "own.py:Own").stdout.replace("\\", "/")
    assert built == "fmus-built/python/Own.fmu\n"
    assert "no effect with own.py:Own, a Python class" in refused("build", "own.py:Own", "--all-platforms")


def test_the_block_that_new_writes_runs_in_the_papers_loop_and_its_files_break_no_rule(
    command: Command, short_scenario: Command
) -> None:
    command("new", "pid")
    command("run", short_scenario(stop=4.0), "--controller", "pid.py", "--formats", "none")
    recording = Recording.read(Path("results", "short-Pid.csv"))
    assert 0.0 < recording["plant.total_force"][-1] <= 6.0
    assert static_broken_rules(builder.fmu_of_file(Path("pid.py"))) == {}


@pytest.mark.slow
def test_the_block_that_new_writes_passes_every_rule(command: Command) -> None:
    command("new", "pid")
    fmu = builder.fmu_of_file(Path("pid.py"))
    assert re.search(r": \d+ passed, \d+ not applicable\n", command("check", fmu).stdout)


@pytest.mark.parametrize("names", [[], ["Broken", "DepthReference", "Wrong"]])
def test_broken_blocks_of_another_package_are_listed_and_stop_no_other(
    names: list[str], command: Command, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    offered = [
        EntryPoint("Broken", "no_such_package:BLOCK", registry.BLOCKS),
        registry.installed(registry.BLOCKS)["DepthReference"],
        EntryPoint("Wrong", "no_such_module:BLOCK", registry.BLOCKS),
    ]
    monkeypatch.setattr(registry, "entry_points", lambda group: offered)
    done = command("build", *names, "--flavour", "python", "--out", "out", expect=1)
    assert done.stdout.replace("\\", "/") == "out/DepthReference.fmu\n"
    assert (
        "2 of 3 not built: Broken, Wrong: block 'Broken': its entry point no_such_package:BLOCK "
        in done.stderr
    )
    assert "'Wrong': its entry point no_such_module:BLOCK cannot be loaded" in done.stderr


@pytest.mark.slow
def test_what_cannot_be_imported_stops_no_other(command: Command) -> None:
    command("new", "good")
    Path("bad.py").write_text("import math\nimport nunpy\n")
    options = ("--flavour", "python", "--out", "out")
    done = command("build", "good.py", "bad.py", "DepthReference", *options, expect=1)
    assert done.stdout.replace("\\", "/") == "out/Good.fmu\nout/DepthReference.fmu\n"
    (line,) = done.stderr.splitlines()
    assert line.startswith("l1-depth: 1 of 3 not built: bad.py: ")
    assert "/bad.py:2: ModuleNotFoundError: No module named 'nunpy'" in line.replace("\\", "/")
    alone = command("build", "bad.py", *options, expect=1)
    assert alone.stderr == line.replace("1 of 3 not built: bad.py: ", "") + "\n"


@pytest.mark.parametrize(
    ("microcontroller", "programs"), [("cortex-m7", ["example.c", "emulator.c"]), ("riscv64", ["example.c"])]
)
def test_a_microcontroller_gets_a_folder_of_its_own(
    command: Command, microcontroller: str, programs: list[str]
) -> None:
    files = command("build", "ThrustAllocation", "--platform", microcontroller).stdout.split()
    folder = Path("fmus-built") / microcontroller / "ThrustAllocation"
    names = "ThrustAllocation.h", "ThrustAllocation.c", *programs, "libThrustAllocation.a", "README.md"
    assert files == [str(folder / name) for name in names]
    assert {*files} == {*map(str, folder.iterdir())}
    # code of this block is some kB, and no frame of it is empty
    code, stack, *_ = re.findall(r"\| ([\d,]+) \|", (folder / "README.md").read_text())
    assert 1000 < int(code.replace(",", "")) < 10_000
    assert 100 < int(stack.replace(",", "")) < 2000


def test_what_has_no_effect_on_a_microcontroller_or_without_one_is_refused(refused: Command) -> None:
    build = "build", "ThrustAllocation", "--platform"
    assert "expected no other platform beside cortex-m7" in refused(*build, "linux64,cortex-m7")
    assert "--float: expected --platform with one of cortex-m4" in refused(*build, "linux64", "--float")
    assert "--fmi: no effect with --platform cortex-m7" in refused(*build, "cortex-m7", "--fmi", "3")
    assert "--scalars: no effect with --platform cortex-m7" in refused(*build, "cortex-m7", "--scalars")


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
        "AdrcDepthController.fmu", "BlueRov2Plant.fmu", "DepthReference.fmu", "ExamplePlant.fmu",
        "L1Controller.fmu", "L1DepthController.fmu", "L1HeavePitchController.fmu", "MracDepthController.fmu",
        "PidDepthController.fmu", "RovDepthPlant.fmu", "RovHeavePitchPlant.fmu",
        "SlidingModeDepthController.fmu", "SuperTwistingDepthController.fmu", "ThrustAllocation.fmu",
        "WaveSource.fmu",
    ]  # fmt: skip
