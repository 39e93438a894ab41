"""What an FMU does to the process of a run: it ends with a reason, and its rounding mode is its own."""

import ctypes
import os
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest

from fmus.files import write_archive
from orchestration.run import simulate
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.described_fmus import XML, members
from tests.foreign_fmus import Misdeed
from tests.shared_builds import Build


def doing(misdeed: Misdeed) -> Experiment:
    parameters = {"bad.misdeed": int(misdeed), "bad.misdeed_time": 0.5}
    return Experiment(1.0, 0.1, parameters=parameters, inputs={"bad.u": 1.0, "good.u[1]": 0.1})


def pair(linear: Build, rogue: Build) -> System:
    return System({"bad": rogue(), "good": linear(a=-0.1)})


def test_an_fmu_that_ends_the_process_is_named_and_the_status_is_not_0(
    linear: Build, rogue: Build, tmp_path: Path
) -> None:
    script = f"""
from orchestration import Experiment, System, simulate
parameters = {{"bad.misdeed": {int(Misdeed.EXIT)}, "bad.misdeed_time": 0.5}}
system = System({{"good": {str(linear())!r}, "bad": {str(rogue())!r}}})
simulate(system, Experiment(1.0, 0.1, parameters=parameters, inputs={{"bad.u": 1.0, "good.u[1]": 0.0}}))
print("written")
"""
    # what is unpacked stays behind
    environment = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, check=False, env=environment
    )
    assert done.returncode == 70
    assert done.stdout == ""
    assert done.stderr.startswith(
        "l1-depth: bad ended the process (it called exit); with a timeout FMUs have a process of their own\n"
    )


def test_a_process_that_ends_by_itself_during_or_after_a_run_is_not_blamed(rogue: Build) -> None:
    """Also where a thread still runs FMUs."""
    script = f"""
import threading, time
from orchestration import Experiment, Simulator, System
simulator = Simulator(System({{"one": {str(rogue())!r}}}))
simulator.run(Experiment(1.0, 0.1, inputs={{"one.u": 0.0}}))
long = Experiment(1e6, 0.01, inputs={{"one.u": 0.0}}, record=["one.y"])
threading.Thread(target=simulator.run, args=(long,), daemon=True).start()
time.sleep(0.2)
raise SystemExit(3)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (3, "")


def test_a_run_ends_in_its_folder_with_its_handler_of_interrupts(
    linear: Build, rogue: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results go where they are expected, and the next interrupt is one."""
    monkeypatch.chdir(tmp_path)
    for misdeed in (Misdeed.CHANGE_FOLDER, Misdeed.IGNORE_INTERRUPTS):
        simulate(pair(linear, rogue), doing(misdeed))
    assert Path.cwd() == tmp_path
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


def test_a_rounding_mode_does_not_reach_other_fmus(linear: Build, rogue: Build) -> None:
    system = pair(linear, rogue)
    upward = simulate(system, doing(Misdeed.ROUND_UPWARD))
    nearest = simulate(system, doing(Misdeed.NONE))
    assert np.array_equal(upward["good.y[1]"], nearest["good.y[1]"])
    assert 1.0 + 1e-30 == 1.0
    assert fmpy.platform != "linux64" or ctypes.CDLL(None).fegetround() == 0  # also for numbers that C prints


def named_as_ours(fmu: Path, folder: Path) -> Path:
    """A copy that names this project as its tool, and sources to compile, as native FMUs of ours do."""
    content = members(fmu)
    root = ElementTree.fromstring(content[XML])
    root.set("generationTool", f"l1-depth {version('l1-depth')}")
    interface = root.find("CoSimulation")
    assert interface is not None
    ElementTree.SubElement(ElementTree.SubElement(interface, "SourceFiles"), "File", name="fmi2.c")
    ours = {XML: ElementTree.tostring(root), "sources/fmi2.c": b""}
    return write_archive(folder / f"{fmu.stem}-named.fmu", content | ours)


def test_an_fmu_that_names_this_project_as_its_tool_is_guarded_like_any_other(
    linear: Build, rogue: Build, tmp_path: Path
) -> None:
    system = pair(linear, rogue)
    named = System({name: named_as_ours(path, tmp_path) for name, path in system.components.items()})
    upward = simulate(named, doing(Misdeed.ROUND_UPWARD))
    nearest = simulate(system, doing(Misdeed.NONE))
    assert np.array_equal(upward["good.y[1]"], nearest["good.y[1]"])
