"""What an FMU changes in the process of a run reaches no other FMU, and does not stay."""

import ctypes
import locale
import os
import signal
import subprocess
import sys
import zipfile
from collections.abc import Callable, Iterator
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import fmpy
import numpy as np
import pytest

from orchestration.errors import FmuWarning, OrchestrationError
from orchestration.run import Simulator, simulate
from orchestration.run.loop_data import Report
from orchestration.run.process_guard import ProcessGuard
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed

Build = Callable[..., Path]


def doing(misdeed: Misdeed) -> Experiment:
    parameters = {"bad.misdeed": int(misdeed), "bad.misdeed_time": 0.5}
    return Experiment(1.0, 0.1, parameters=parameters, inputs={"bad.u": 1.0, "good.u[1]": 0.1})


def pair(linear: Build, rogue: Build) -> System:
    return System({"bad": rogue(), "good": linear(a=-0.1)})


def test_an_fmu_that_ends_the_process_is_named_and_the_status_is_not_0(linear: Build, rogue: Build) -> None:
    script = f"""
from orchestration import Experiment, System, simulate
parameters = {{"bad.misdeed": {int(Misdeed.EXIT)}, "bad.misdeed_time": 0.5}}
system = System({{"good": {str(linear())!r}, "bad": {str(rogue())!r}}})
simulate(system, Experiment(1.0, 0.1, parameters=parameters, inputs={{"bad.u": 1.0, "good.u[1]": 0.0}}))
print("written")
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert done.returncode == 70
    assert done.stdout == ""
    assert done.stderr.startswith("l1-depth: bad ended the process (it called exit): the run is lost")


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


@pytest.fixture
def _as_before(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.chdir(tmp_path)
    before = locale.setlocale(locale.LC_ALL)
    locale.setlocale(locale.LC_ALL, "C.UTF-8")
    yield
    locale.setlocale(locale.LC_ALL, before)


@pytest.mark.usefixtures("_as_before")
@pytest.mark.parametrize(
    ("misdeed", "changed"),
    [
        (Misdeed.CHANGE_FOLDER, "the working directory"),
        (Misdeed.CHANGE_LOCALE, "the locale"),
        (Misdeed.IGNORE_INTERRUPTS, "the handler of SIGINT"),
    ],
)
def test_what_an_fmu_changes_is_restored_with_a_warning(
    linear: Build, rogue: Build, tmp_path: Path, misdeed: Misdeed, changed: str
) -> None:
    with pytest.warns(FmuWarning, match=f"one of bad, good changed {changed} of this process"):
        simulate(pair(linear, rogue), doing(misdeed))
    assert Path.cwd() == tmp_path
    assert "UTF-8" in locale.setlocale(locale.LC_CTYPE)
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


def test_after_a_run_that_is_led_step_by_step_an_interrupt_is_one_again(linear: Build, rogue: Build) -> None:
    def lead() -> None:
        with Simulator(pair(linear, rogue)) as simulator:
            simulator.start(doing(Misdeed.IGNORE_INTERRUPTS))
            for _ in range(10):
                simulator.step()

    with pytest.warns(FmuWarning, match="changed the handler of SIGINT of this process"):
        lead()
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.filterwarnings("error::orchestration.errors.FmuWarning")
def test_a_handler_that_python_changes_during_a_run_is_no_fault_of_an_fmu(
    linear: Build, rogue: Build
) -> None:
    def change(done: int, total: int) -> None:
        signal.signal(signal.SIGALRM, signal.SIG_IGN)

    before = signal.getsignal(signal.SIGALRM)
    try:
        simulate(pair(linear, rogue), doing(Misdeed.NONE), progress=change)
        assert signal.getsignal(signal.SIGALRM) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGALRM, before)


def test_a_run_ends_whose_fmu_closes_files_of_the_process(rogue: Build) -> None:
    script = f"""
import os, sys
from orchestration import Experiment, SimulationError, System, simulate
os.dup2(1, 200)
for misdeed in ({int(Misdeed.CLOSE_OUTPUT)}, {int(Misdeed.CLOSE_FILES)}):
    parameters = {{"bad.misdeed": misdeed, "bad.misdeed_time": 0.5}}
    system = System({{"bad": {str(rogue())!r}}})
    try:
        simulate(system, Experiment(1.0, 0.1, parameters=parameters, inputs={{"bad.u": 1.0}}))
    except SimulationError as error:
        print(error, len(error.recording.time) >= 5, file=sys.stderr)
    if misdeed == {int(Misdeed.CLOSE_OUTPUT)}:
        os.dup2(200, 1)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    lines = done.stderr.splitlines()
    assert len(lines) == 2, done.stderr
    for line in lines:
        assert line.startswith("bad closed files of this process: expected its own ones alone")
        assert line.endswith(" True")  # what was recorded until then is there


def test_a_guard_whose_file_an_fmu_has_closed_closes_no_file_of_another_guard() -> None:
    """Whose file has the number that became free."""
    before = _descriptors()
    first = ProcessGuard(["one"], np.zeros(len(Report), np.int64))
    (closed,) = _descriptors() - before
    os.close(closed)
    second = ProcessGuard(["two"], np.zeros(len(Report), np.int64))
    assert _descriptors() == before | {closed}
    with pytest.raises(OrchestrationError, match="one closed files of this process"):
        first.restore("one")
    first.close()
    second.restore("two")
    second.close()
    assert _descriptors() == before


def _descriptors() -> set[int]:
    """The numbers of this process's open files."""
    numbers = range(512)
    return {number for number in numbers if _is_open(number)}


def _is_open(number: int) -> bool:
    try:
        os.fstat(number)
    except OSError:
        return False
    return True


def test_a_rounding_mode_does_not_reach_other_fmus(linear: Build, rogue: Build) -> None:
    system = pair(linear, rogue)
    upward = simulate(system, doing(Misdeed.ROUND_UPWARD))
    nearest = simulate(system, doing(Misdeed.NONE))
    assert np.array_equal(upward["good.y[1]"], nearest["good.y[1]"])
    assert 1.0 + 1e-30 == 1.0
    assert fmpy.platform != "linux64" or ctypes.CDLL(None).fegetround() == 0  # also for numbers that C prints


def named_as_ours(fmu: Path, folder: Path) -> Path:
    """A copy that names this project as its tool, and sources to compile, as native FMUs of ours do."""
    path = folder / f"{fmu.stem}-named.fmu"
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(path, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == "modelDescription.xml":
                root = ElementTree.fromstring(content)
                root.set("generationTool", f"l1-depth {version('l1-depth')}")
                interface = root.find("CoSimulation")
                assert interface is not None
                ElementTree.SubElement(
                    ElementTree.SubElement(interface, "SourceFiles"), "File", name="fmi2.c"
                )
                content = ElementTree.tostring(root)
            target.writestr(name, content)
        target.writestr("sources/fmi2.c", "")
    return path


def test_an_fmu_that_names_this_project_as_its_tool_is_guarded_like_any_other(
    linear: Build, rogue: Build, tmp_path: Path
) -> None:
    system = pair(linear, rogue)
    named = System({name: named_as_ours(path, tmp_path) for name, path in system.components.items()})
    upward = simulate(named, doing(Misdeed.ROUND_UPWARD))
    nearest = simulate(system, doing(Misdeed.NONE))
    assert np.array_equal(upward["good.y[1]"], nearest["good.y[1]"])
