"""What an FMU does to the process of a run: it ends with a reason, and its rounding mode is its own."""

import ctypes
import os
import signal
import subprocess
import sys
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import pytest

from fmus.files import write_archive
from orchestration.run import simulate
from orchestration.system.system import System
from tests.described_fmus import XML, members
from tests.foreign_fmus import Misdeed
from tests.orchestration.rogue_systems import doing
from tests.shared_builds import Build


def beside_a_lag(linear: Build, rogue: Build) -> System:
    return System({"rogue": rogue(), "lag": linear(a=-0.1)})


def lag_beside(misdeed: Misdeed, system: System) -> list[float]:
    """The outputs of the lag in a run in which the rogue misbehaves."""
    inputs = {"rogue.u": 1.0, "lag.u[1]": 0.1}
    return simulate(system, replace(doing(misdeed), inputs=inputs))["lag.y[1]"].tolist()


def in_another_process(script: str, folder: Path) -> tuple[int, str, str]:
    """Status, standard output and errors; in the folder stays what was unpacked."""
    command, environment = [sys.executable, "-c", script], {**os.environ, "TMPDIR": str(folder)}
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=environment)
    return done.returncode, done.stdout, done.stderr


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
    status, output, errors = in_another_process(script, tmp_path)
    assert (status, output) == (70, "")
    assert errors.startswith(
        "l1-depth: bad ended the process (it called exit); with a timeout FMUs have a process of their own\n"
    )


@pytest.mark.slow
def test_a_process_that_ends_by_itself_during_or_after_a_run_is_not_blamed(
    rogue: Build, tmp_path: Path
) -> None:
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
    assert in_another_process(script, tmp_path) == (3, "", "")


def test_a_run_ends_in_its_folder_with_its_handler_of_interrupts(
    linear: Build, rogue: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results go where they are expected, and the next interrupt is one."""
    monkeypatch.chdir(tmp_path)
    for misdeed in (Misdeed.CHANGE_FOLDER, Misdeed.IGNORE_INTERRUPTS):
        lag_beside(misdeed, beside_a_lag(linear, rogue))
    assert Path.cwd() == tmp_path
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


def test_a_rounding_mode_does_not_reach_other_fmus(linear: Build, rogue: Build, tmp_path: Path) -> None:
    """Nor that of an FMU which names this project as its tool: it is guarded like any other."""
    system = beside_a_lag(linear, rogue)
    named = System({name: named_as_ours(path, tmp_path) for name, path in system.components.items()})
    nearest = lag_beside(Misdeed.NONE, system)
    for rounding in (system, named):
        assert lag_beside(Misdeed.ROUND_UPWARD, rounding) == nearest
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
