"""What an FMU changes in the process of a run reaches no other FMU, and does not stay."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orchestration.errors import FmuWarning
from orchestration.master import simulate
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


def test_the_working_directory_is_restored_with_a_warning(
    linear: Build, rogue: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.warns(FmuWarning, match="one of bad, good changed the working directory of this process"):
        simulate(pair(linear, rogue), doing(Misdeed.CHANGE_FOLDER))
    assert Path.cwd() == tmp_path


def test_a_rounding_mode_does_not_reach_other_fmus(linear: Build, rogue: Build) -> None:
    system = pair(linear, rogue)
    upward = simulate(system, doing(Misdeed.ROUND_UPWARD))
    nearest = simulate(system, doing(Misdeed.NONE))
    assert np.array_equal(upward["good.y[1]"], nearest["good.y[1]"])
    assert 1.0 + 1e-30 == 1.0
