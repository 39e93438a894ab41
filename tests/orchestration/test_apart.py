"""FMUs that hang or crash in a process of their own take nothing else with them."""

import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
import pytest

from orchestration.errors import SimulationError, SystemDefinitionError
from orchestration.experiment import Experiment
from orchestration.master import simulate
from orchestration.system import System
from tests.orchestration.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import coupled

Build = Callable[..., Path]
TIMEOUT = 2.0


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def test_it_is_the_same_run(linear: Build, temporary: Path) -> None:
    """Also of a signal that no file could name."""
    system = System({"one": linear()})
    experiment = Experiment(1.0, 0.01, signals={"one.u[1]": lambda t: t * t})
    seen: list[tuple[int, int]] = []
    apart = simulate(system, experiment, lambda done, total: seen.append((done, total)), timeout=TIMEOUT)
    here = simulate(system, experiment)
    assert np.array_equal(apart.values, here.values)
    assert apart.provenance == here.provenance
    assert all(total == 100 for _, total in seen)
    assert not list(temporary.iterdir())


@pytest.mark.parametrize(
    ("misdeed", "words"),
    [
        (Misdeed.HANG, r"did not return within 2 s, and its process was ended"),
        (Misdeed.SEGFAULT, r"ended its process with signal SIGSEGV"),
        (Misdeed.ABORT, r"ended its process with signal SIGABRT"),
    ],
)
def test_the_record_until_then_is_kept(
    linear: Build, rogue: Build, temporary: Path, misdeed: Misdeed, words: str
) -> None:
    before = set(psutil.Process().children(recursive=True))
    system = System({"good": linear(), "bad": rogue()}, (("good.y[1]", "bad.u"), ("bad.y", "good.u[1]")))
    parameters = {"bad.misdeed": int(misdeed), "bad.misdeed_time": 0.5}
    with pytest.raises(SimulationError, match=rf"bad at t = 0.5 s: {words}") as caught:
        simulate(system, Experiment(1.0, 0.1, parameters=parameters), timeout=TIMEOUT)
    recording = caught.value.recording
    whole = simulate(system, Experiment(1.0, 0.1))
    assert np.array_equal(recording.time, whole.time[:6])
    assert np.array_equal(recording.values, whole.values[:6])
    assert not list(temporary.iterdir())
    assert set(psutil.Process().children(recursive=True)) <= before


def test_an_error_comes_back_as_it_is(rogue: Build, temporary: Path) -> None:
    experiment = Experiment(1.0, 0.1, parameters={"bad.misdeed": int(Misdeed.ERROR)}, inputs={"bad.u": 1.0})
    with pytest.raises(SimulationError) as here:
        simulate(System({"bad": rogue()}), experiment)
    with pytest.raises(SimulationError) as apart:
        simulate(System({"bad": rogue()}), experiment, timeout=TIMEOUT)
    assert str(apart.value) == str(here.value)
    assert np.array_equal(apart.value.recording.values, here.value.recording.values)


def test_an_interrupt_ends_both_processes(linear: Build, temporary: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        if done > 10:
            raise KeyboardInterrupt

    with pytest.raises(SimulationError, match="interrupted") as caught:
        simulate(coupled(linear), Experiment(2e4, 0.01), interrupt, timeout=TIMEOUT)
    assert len(caught.value.recording.time) > 10
    assert not list(temporary.iterdir())


def test_what_does_not_fit_is_said_before_a_process_starts(linear: Build) -> None:
    with pytest.raises(SystemDefinitionError, match="driven by nothing"):
        simulate(System({"one": linear()}), Experiment(1.0, 0.1), timeout=TIMEOUT)
    with pytest.raises(SystemDefinitionError, match="timeout 0 s: expected more than 0"):
        simulate(coupled(linear), Experiment(1.0, 0.1), timeout=0)
