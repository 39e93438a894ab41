"""What a run in a process of its own receives and sends: signals, errors, warnings, the record."""

import errno
import importlib
import os
import sys
import threading
import types
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from orchestration.errors import FmuWarning, OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.run import simulate
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import alone, coupled
from tests.orchestration.rogue_systems import doing, pair
from tests.shared_builds import Build

TIMEOUT = 2.0
pytestmark = pytest.mark.usefixtures("importable")


def of_signal(signal: Callable[[float], float]) -> Experiment:
    return Experiment(1.0, 0.1, signals={"one.u[1]": signal})


def test_a_signal_may_be_of_a_module_beside_a_script(
    linear: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "beside.py").write_text("def twice(t):\n    return 2.0 * t\n")
    monkeypatch.syspath_prepend(tmp_path)
    beside = importlib.import_module("beside")
    recording = simulate(alone(linear), of_signal(beside.twice), timeout=TIMEOUT)
    assert recording["one.u[1]"].tolist() == (2.0 * recording.time).tolist()


def test_what_cannot_travel_is_named(linear: Build, monkeypatch: pytest.MonkeyPatch) -> None:
    lock = threading.Lock()
    with pytest.raises(OrchestrationError, match=r"the signal of one.u\[1\] cannot be given .*lock"):
        simulate(alone(linear), of_signal(lambda t: float(lock.locked())), timeout=TIMEOUT)
    nowhere = types.ModuleType("nowhere")
    exec("def signal(t):\n    return t", nowhere.__dict__)
    monkeypatch.setitem(sys.modules, "nowhere", nowhere)
    with pytest.raises(OrchestrationError, match=r"cannot be loaded .*No module named 'nowhere'"):
        simulate(alone(linear), of_signal(nowhere.signal), timeout=TIMEOUT)


class Stubborn(BaseException):
    """Cannot be loaded again: it takes two arguments, and keeps one."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(first + second)


def failing(error: Callable[[], BaseException]) -> Experiment:
    def signal(t: float) -> float:
        raise error()

    return of_signal(signal)


@pytest.mark.parametrize("error", [ZeroDivisionError, SystemExit])
def test_what_a_signal_raises_is_the_same(linear: Build, error: type[BaseException]) -> None:
    errors = []
    for seconds in (TIMEOUT, None):
        with pytest.raises((SystemDefinitionError, SystemExit), match="no draught") as caught:
            simulate(alone(linear), failing(lambda: error("no draught")), timeout=seconds)
        errors.append((caught.type, str(caught.value)))
    assert errors[0] == errors[1]


def test_an_error_that_does_not_travel_is_told(linear: Build) -> None:
    with pytest.raises(OrchestrationError) as caught:
        simulate(alone(linear), failing(lambda: Stubborn("no ", "draught")), timeout=TIMEOUT)
    assert str(caught.value) == "Stubborn: no draught"


WARNS = doing(Misdeed.WARNING, 0.2)


def test_a_warning_is_the_same(linear: Build, rogue: Build) -> None:
    heard = []
    for seconds in (TIMEOUT, None):
        with pytest.warns(FmuWarning) as warned:
            simulate(pair(linear, rogue), WARNS, timeout=seconds)
        heard.append((str(warned[0].message), warned[0].filename))
    assert heard[0] == heard[1]


def test_a_warning_is_heard_of_a_process_that_crashed(rogue: Build) -> None:
    worse = {"worse.misdeed": int(Misdeed.SEGFAULT), "worse.misdeed_time": 0.5}
    experiment = replace(WARNS, parameters={**WARNS.parameters, **worse}, open_inputs="start")
    system = System({"rogue": rogue(), "worse": rogue()})
    message = r"worse at t = 0.5 s: ended its process with SIGSEGV"
    with pytest.warns(FmuWarning) as heard, pytest.raises(SimulationError, match=message):
        simulate(system, experiment, real_time=100.0, timeout=TIMEOUT)
    before = [str(warning.message).partition(":")[0] for warning in heard]
    assert before == [f"rogue at t = {t} s" for t in (0.2, 0.3, 0.4)]


@pytest.mark.filterwarnings("error::orchestration.errors.FmuWarning")
def test_a_warning_that_is_an_error_keeps_the_recording(linear: Build, rogue: Build) -> None:
    with pytest.raises(SimulationError, match=r"FmuWarning.*the battery is low") as caught:
        simulate(pair(linear, rogue), WARNS, timeout=TIMEOUT)
    assert len(caught.value.recording.time) > 2


def test_a_process_that_cannot_begin_is_no_fault_of_an_fmu(
    linear: Build, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = coupled(linear)  # built by this Python
    broken = temporary.parent / "broken python"
    broken.write_text("#!/bin/sh\nexit 3\n")
    broken.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(broken))
    with pytest.raises(OrchestrationError, match=r"could not begin: .* exit status 3"):
        simulate(system, Experiment(1.0, 0.1), timeout=TIMEOUT)


def refuse(done: int, total: int) -> None:
    raise ValueError("no bar")


@pytest.mark.parametrize("progress", [None, refuse])
def test_no_file_stays_mapped(linear: Build, rogue: Build, progress: Any) -> None:
    """Windows does not remove one that is."""
    with pytest.raises(SimulationError) as caught:
        simulate(pair(linear, rogue), doing(Misdeed.SEGFAULT), progress, real_time=1.0, timeout=TIMEOUT)
    assert caught.tb  # with all that its frames refer to
    assert "l1-depth-run-" not in Path("/proc/self/maps").read_text()


def test_what_does_not_fit_is_said_before_a_process_starts(linear: Build) -> None:
    with pytest.raises(SystemDefinitionError, match="driven by nothing"):
        simulate(alone(linear), Experiment(1.0, 0.1), timeout=TIMEOUT)
    with pytest.raises(SystemDefinitionError, match="timeout 0 s: expected more than 0"):
        simulate(coupled(linear), Experiment(1.0, 0.1), timeout=0)


@pytest.mark.skipif(not hasattr(os, "posix_fallocate"), reason="macOS and Windows cannot reserve room")
def test_a_record_without_room_is_refused_before_the_run(
    linear: Build, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a temporary folder that is too small, where a mapped file would end the process with SIGBUS."""

    def full(descriptor: int, offset: int, length: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(OrchestrationError, match=r"no room for a record of .* MB, .*No space left"):
        simulate(coupled(linear), Experiment(1.0, 0.1), timeout=TIMEOUT)
    assert not list(temporary.iterdir())
