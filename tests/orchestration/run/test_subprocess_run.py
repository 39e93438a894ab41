"""FMUs that hang or crash in a process of their own take nothing else with them."""

import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pythonfmu.builder import FmuBuilder

from orchestration.errors import FmuWarning, OrchestrationError, SimulationError
from orchestration.run import Simulator, simulate
from orchestration.run import subprocess_run as apart
from orchestration.run.checkpoint import Checkpoints, read_checkpoint
from orchestration.run.loop_data import Report, Storage
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.foreign_fmus import Misdeed
from tests.orchestration.linear_systems import RESUMABLE, alone, coupled
from tests.orchestration.rogue_systems import doing, pair
from tests.orchestration.runs import assert_same_bits
from tests.shared_builds import Build

TIMEOUT = 2.0
pytestmark = pytest.mark.usefixtures("importable")


def test_it_is_the_same_run(linear: Build, temporary: Path) -> None:
    """Also of a signal that no file could name."""
    system, experiment = alone(linear), Experiment(1.0, 0.01, signals={"one.u[1]": lambda t: t * t})
    progress: list[tuple[int, int]] = []
    there = simulate(system, experiment, lambda done, total: progress.append((done, total)), timeout=TIMEOUT)
    here = simulate(system, experiment)
    assert_same_bits(there, here)
    assert there.provenance == here.provenance
    assert progress[-1] == (100, 100)
    assert all(done < total == 100 for done, total in progress[:-1])
    assert not list(temporary.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("misdeed", "words"),
    [
        (Misdeed.CRASH_IN_TERMINATE, "ended its process with SIGSEGV"),
        (Misdeed.CRASH_IN_FREE_OF_STATE, "ended its process with SIGSEGV"),
        (Misdeed.HANG_IN_FREE, "did not return within 1 s, and its process was ended"),
    ],
)
def test_a_crash_after_the_last_row_is_a_warning(
    linear: Build, rogue: Build, temporary: Path, misdeed: Misdeed, words: str
) -> None:
    system = System({"lag": linear(saves_state=True), "rogue": rogue(saves_state=True)})
    whole = replace(doing(Misdeed.NONE), start_time=-0.5, inputs={"rogue.u": -2.0, "lag.u[1]": 1.0})
    bad = replace(whole, parameters=doing(misdeed).parameters)
    with pytest.warns(FmuWarning, match=f"^rogue after the run: {words}; the recording is not affected$"):
        recording = simulate(system, bad, timeout=1.0)
    expected = simulate(system, whole)
    assert recording["rogue.y"][-1] == pytest.approx(-3.0, rel=1e-12)
    assert_same_bits(recording, expected)
    assert recording.provenance == expected.provenance
    assert not list(temporary.iterdir())


def test_an_error_comes_back_as_it_is(linear: Build, rogue: Build) -> None:
    with pytest.raises(SimulationError) as here:
        simulate(pair(linear, rogue), doing(Misdeed.ERROR))
    with pytest.raises(SimulationError) as there:
        simulate(pair(linear, rogue), doing(Misdeed.ERROR), timeout=TIMEOUT)
    assert str(there.value) == str(here.value)
    assert_same_bits(there.value.recording, here.value.recording)


def raises(error: BaseException, after: int = 10) -> Callable[[int, int], None]:
    """A progress that fails."""

    def progress(done: int, total: int) -> None:
        if done > after:
            raise error

    return progress


LONG = Experiment(2e4, 0.01)


@pytest.mark.slow
def test_an_interrupt_ends_both_processes(linear: Build, temporary: Path) -> None:
    with pytest.raises(SimulationError, match="interrupted") as caught:
        simulate(coupled(linear), LONG, raises(KeyboardInterrupt()), timeout=TIMEOUT)
    assert len(caught.value.recording.time) > 10
    assert not list(temporary.iterdir())


def test_an_interrupt_after_the_last_point_is_one(linear: Build) -> None:
    with pytest.raises(SimulationError, match="interrupted") as caught:
        simulate(coupled(linear), Experiment(1.0, 0.1), raises(KeyboardInterrupt(), after=9), timeout=TIMEOUT)
    assert len(caught.value.recording.time) == 11


@pytest.mark.slow
def test_an_interrupt_at_the_terminal_does_not_cut_off_a_checkpoint(linear: Build, tmp_path: Path) -> None:
    """It reaches every process of the group, and more than once where a shell or a launcher passes it on."""
    script = f"""
        import time
        from orchestration.errors import SimulationError
        from orchestration.run import Simulator, simulate
        from orchestration.run.checkpoint import Checkpoints
        from orchestration.system.system import System

        class Slow(Checkpoints):
            def save(self, run):
                time.sleep(0.5)
                super().save(run)

        try:
            simulate(
                System({{"one": {str(linear(**RESUMABLE))!r}}}),
                stop_time=1e6, step_size=1.0, inputs={{"one.u[1]": 0.0}}, real_time=10.0,
                timeout={TIMEOUT}, checkpoints=Slow({str(tmp_path / "checkpoint")!r}),
                progress=lambda done, total: print(done, flush=True),
            )
        except SimulationError as error:
            print(error)
    """
    command = [sys.executable, "-c", textwrap.dedent(script)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stdout
    process.stdout.readline()  # it runs
    for _ in range(2):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.3)
    said = process.communicate(timeout=60)[0]
    assert said.splitlines()[-1] == f"interrupted; saved in {tmp_path / 'checkpoint'}"
    assert read_checkpoint(tmp_path / "checkpoint").position > 0


def test_a_second_interrupt_ends_what_hangs(linear: Build, rogue: Build, temporary: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        if not timers:
            for after in (0.1, 1.5):
                timers.append(threading.Timer(after, os.kill, (os.getpid(), signal.SIGINT)))
                timers[-1].start()

    timers: list[threading.Timer] = []
    words = "rogue at t = 0.5 s: did not return after an interrupt"
    with pytest.raises(SimulationError, match=words) as caught:
        simulate(pair(linear, rogue), doing(Misdeed.HANG), interrupt, timeout=60.0)
    assert len(caught.value.recording.time) == 6
    assert not list(temporary.iterdir())


@pytest.mark.slow
@pytest.mark.parametrize(
    "error", [ValueError("no bar"), pytest.param(OrchestrationError("no bar"), marks=pytest.mark.slow)]
)
def test_a_progress_that_fails_is_the_same_failure(linear: Build, error: Exception) -> None:
    messages = []
    for seconds in (None, TIMEOUT):
        with pytest.raises(SimulationError) as caught:
            simulate(coupled(linear), LONG, raises(error), timeout=seconds)
        assert len(caught.value.recording.time) > 10
        assert caught.value.__cause__ is error
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


def sleeps(seconds: float) -> Callable[[float], float]:
    """A signal that takes its time at the start."""

    def signal(t: float) -> float:
        if t == 0.0:
            time.sleep(seconds)
        return t

    return signal


class SlowCheckpoints(Checkpoints):
    def save(self, run: Any) -> None:
        time.sleep(SHORT + 0.5)
        super().save(run)


SHORT = 0.3


def test_only_what_fmus_do_counts(linear: Build, tmp_path: Path) -> None:
    """Not what signals, checkpoints and real time take."""
    experiment = Experiment(1.0, 0.5, signals={"one.u[1]": sleeps(SHORT + 0.5)})
    options: dict[str, Any] = {"timeout": SHORT, "real_time": 1.0}
    checkpoints = SlowCheckpoints(tmp_path / "checkpoint", every=0.5)
    recording = simulate(alone(linear, **RESUMABLE), experiment, checkpoints=checkpoints, **options)
    assert recording.time.tolist() == [0.0, 0.5, 1.0]


def test_an_interrupt_of_the_preparation_ends_the_run(linear: Build) -> None:
    """While the process begins, or the first signal is asked."""
    system, experiment = alone(linear), Experiment(1e3, 1.0, signals={"one.u[1]": sleeps(2.5)})
    timer = threading.Timer(1.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(SimulationError, match="interrupted") as caught:
        simulate(system, experiment, timeout=TIMEOUT)
    assert len(caught.value.recording.time) < 1000


@pytest.mark.slow
def test_what_comes_after_the_last_point_does_not_count(linear: Build) -> None:
    experiment = Experiment(4e6, 1.0, inputs={"one.u[1]": 0.0})
    recording = simulate(alone(linear), experiment, timeout=0.1)  # no less: a busy machine
    assert len(recording.time) == 4_000_001


@pytest.mark.slow
def test_shorter_steps_between_two_points_each_count_alone(rogue: Build) -> None:
    """All of them take longer than the limit."""
    shorter = replace(doing(Misdeed.DISCARD, 0.0, longest_step=2e-5, h=1.0), inputs={"rogue.u": 1.0})
    begun = time.monotonic()
    recording = simulate(System({"rogue": rogue(saves_state=True)}), shorter, timeout=SHORT)
    assert time.monotonic() - begun > 2 * SHORT
    assert recording["rogue.y"][-1] == pytest.approx(1.0, abs=1e-9)  # rounding of 5e4 sums


def test_every_call_is_counted(linear: Build) -> None:
    """In the loop and outside: each has a time limit of its own."""
    storage = Storage(np.empty((11, 2)), np.zeros(len(Report), np.int64))
    with Simulator(alone(linear)) as simulator:
        simulator.run(Experiment(1.0, 0.1, signals={"one.u[1]": lambda t: t}), storage=storage)
    initial = ["setup", "enter initialisation mode", "set the input", "leave it", "read"]
    each, last = ["write", "step", "read"], ["end", "free"]
    assert storage.report[Report.CALLS] == len(initial) + 10 * len(each) + len(last)
    assert storage.report[Report.BUSY] == 0


HANGS = """
    import os, time
    from pythonfmu import Fmi2Causality, Fmi2Slave, Real

    def perhaps(where):
        if os.environ.get("HANGS_IN") == where:
            time.sleep(1e4)

    class Hangs(Fmi2Slave):
        def __init__(self, **kwargs):
            super().__init__(**kwargs)
            self.y = 0.0
            self.register_variable(Real("y", causality=Fmi2Causality.output))
            perhaps("loading")

        def exit_initialization_mode(self):
            perhaps("initialisation")

        def do_step(self, t, h):
            return True
"""


@pytest.fixture(scope="module")
def hangs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hangs")
    (folder / "hangs.py").write_text(textwrap.dedent(HANGS))
    return Path(FmuBuilder.build_FMU(folder / "hangs.py", folder))


@pytest.mark.parametrize(("where", "seconds"), [("loading", 3), ("initialisation", 1)])
def test_who_hangs_elsewhere_is_named(
    linear: Build, hangs: Path, monkeypatch: pytest.MonkeyPatch, where: str, seconds: int
) -> None:
    monkeypatch.setattr(apart, "_LOADING_S", 3.0)
    monkeypatch.setenv("HANGS_IN", where)
    system = System({"first": linear(), "last": hangs}, (("last.y", "first.u[1]"),))
    words = f"last in the initialisation: did not return within {seconds} s"
    with pytest.raises(SimulationError, match=words) as caught:
        simulate(system, Experiment(1.0, 0.1), timeout=1.0)
    assert not len(caught.value.recording.time)


def test_a_process_that_does_not_end_by_itself_is_ended(linear: Build) -> None:
    """Something in it waits for ever."""

    def leaves_a_thread(t: float) -> float:
        if t == 0.0:
            threading.Thread(target=time.sleep, args=(1e4,)).start()
        return t

    experiment = Experiment(1.0, 0.1, signals={"one.u[1]": leaves_a_thread})
    assert len(simulate(alone(linear), experiment, timeout=SHORT).time) == 11
