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
import psutil
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
from tests.orchestration.linear_systems import coupled
from tests.shared_builds import Build

TIMEOUT = 2.0
pytestmark = pytest.mark.usefixtures("importable")


def test_it_is_the_same_run(linear: Build, temporary: Path) -> None:
    """Also of a signal that no file could name."""
    system = System({"one": linear()})
    experiment = Experiment(1.0, 0.01, signals={"one.u[1]": lambda t: t * t})
    progress: list[tuple[int, int]] = []
    there = simulate(system, experiment, lambda done, total: progress.append((done, total)), timeout=TIMEOUT)
    here = simulate(system, experiment)
    assert np.array_equal(there.values, here.values)
    assert there.provenance == here.provenance
    assert progress[-1] == (100, 100)
    assert all(done < total == 100 for done, total in progress[:-1])
    assert not list(temporary.iterdir())


@pytest.mark.parametrize(
    ("misdeed", "words"),
    [
        (Misdeed.HANG, r"did not return within 2 s, and its process was ended"),
        (Misdeed.SEGFAULT, r"ended its process with SIGSEGV"),
        (Misdeed.ABORT, r"ended its process with SIGABRT"),
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
    uninterrupted = simulate(system, Experiment(1.0, 0.1))
    assert np.array_equal(recording.time, uninterrupted.time[:6])
    assert np.array_equal(recording.values, uninterrupted.values[:6])
    assert not list(temporary.iterdir())
    assert set(psutil.Process().children(recursive=True)) <= before


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
    system = System({"good": linear(saves_state=True), "bad": rogue(saves_state=True)})
    whole = Experiment(1.0, 0.1, -0.5, inputs={"bad.u": -2.0, "good.u[1]": 1.0})
    bad = replace(whole, parameters={"bad.misdeed": int(misdeed)})
    with pytest.warns(FmuWarning, match=f"^bad after the run: {words}; the recording is not affected$"):
        recording = simulate(system, bad, timeout=1.0)
    expected = simulate(system, whole)
    assert recording["bad.y"][-1] == pytest.approx(-3.0, rel=1e-12)
    assert np.array_equal(recording.values, expected.values)
    assert recording.provenance == expected.provenance
    assert not list(temporary.iterdir())


def test_an_error_comes_back_as_it_is(rogue: Build, temporary: Path) -> None:
    experiment = Experiment(1.0, 0.1, parameters={"bad.misdeed": int(Misdeed.ERROR)}, inputs={"bad.u": 1.0})
    with pytest.raises(SimulationError) as here:
        simulate(System({"bad": rogue()}), experiment)
    with pytest.raises(SimulationError) as there:
        simulate(System({"bad": rogue()}), experiment, timeout=TIMEOUT)
    assert str(there.value) == str(here.value)
    assert np.array_equal(there.value.recording.values, here.value.recording.values)


def raises(error: BaseException, after: int = 10) -> Callable[[int, int], None]:
    """A progress that fails."""

    def progress(done: int, total: int) -> None:
        if done > after:
            raise error

    return progress


LONG = Experiment(2e4, 0.01)


def test_an_interrupt_ends_both_processes(linear: Build, temporary: Path) -> None:
    with pytest.raises(SimulationError, match="interrupted") as caught:
        simulate(coupled(linear), LONG, raises(KeyboardInterrupt()), timeout=TIMEOUT)
    assert len(caught.value.recording.time) > 10
    assert not list(temporary.iterdir())


def test_an_interrupt_after_the_last_point_is_one(linear: Build) -> None:
    with pytest.raises(SimulationError, match="interrupted") as caught:
        simulate(coupled(linear), Experiment(1.0, 0.1), raises(KeyboardInterrupt(), after=9), timeout=TIMEOUT)
    assert len(caught.value.recording.time) == 11


@pytest.mark.parametrize("interrupts", [1, 2])
def test_an_interrupt_at_the_terminal_does_not_cut_off_a_checkpoint(
    linear: Build, tmp_path: Path, interrupts: int
) -> None:
    """It reaches every process of the group, and more than once where a shell or a launcher passes it on."""
    script = f"""
        import time
        from dataclasses import dataclass
        from orchestration.errors import SimulationError
        from orchestration.run import simulate
        from orchestration.run.checkpoint import Checkpoints
        from orchestration.system.system import System

        class Slow(Checkpoints):
            def save(self, run):
                time.sleep(0.5)
                super().save(run)

        try:
            simulate(
                System({{"one": {str(linear(saves_state=True, serialises_state=True))!r}}}),
                stop_time=1e6, step_size=1.0, inputs={{"one.u[1]": 0.0}}, real_time=10.0,
                timeout={TIMEOUT}, checkpoints=Slow({str(tmp_path / "checkpoint")!r}),
                progress=lambda done, total: print(done, flush=True),
            )
        except SimulationError as error:
            print(error)
    """
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(script)],
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert process.stdout
    process.stdout.readline()  # it runs
    for _ in range(interrupts):
        os.killpg(process.pid, signal.SIGINT)
        time.sleep(0.3)
    said = process.communicate(timeout=60)[0]
    assert said.splitlines()[-1] == f"interrupted; saved in {tmp_path / 'checkpoint'}"
    assert read_checkpoint(tmp_path / "checkpoint").position > 0


def test_a_second_interrupt_ends_what_hangs(rogue: Build, temporary: Path) -> None:
    def interrupt(done: int, total: int) -> None:
        if not timers:
            for after in (0.1, 1.5):
                timers.append(threading.Timer(after, os.kill, (os.getpid(), signal.SIGINT)))
                timers[-1].start()

    timers: list[threading.Timer] = []
    parameters = {"bad.misdeed": int(Misdeed.HANG), "bad.misdeed_time": 0.5}
    experiment = Experiment(1.0, 0.1, parameters=parameters, inputs={"bad.u": 1.0})
    words = "bad at t = 0.5 s: did not return after an interrupt"
    with pytest.raises(SimulationError, match=words) as caught:
        simulate(System({"bad": rogue()}), experiment, interrupt, timeout=60.0)
    assert len(caught.value.recording.time) == 6
    assert not list(temporary.iterdir())


@pytest.mark.parametrize("error", [ValueError("no bar"), OrchestrationError("no bar")])
def test_a_progress_that_fails_is_the_same_failure(linear: Build, error: Exception) -> None:
    messages = []
    for seconds in (None, TIMEOUT):
        with pytest.raises(SimulationError) as caught:
            simulate(coupled(linear), LONG, raises(error), timeout=seconds)
        assert len(caught.value.recording.time) > 10
        assert caught.value.__cause__ is error
        messages.append(str(caught.value))
    assert messages[0] == messages[1]


class Sleeps:
    """A signal that takes its time once."""

    def __init__(self, seconds: float) -> None:
        self.seconds = seconds

    def __call__(self, t: float) -> float:
        if t == 0.0:
            time.sleep(self.seconds)
        return t


class SlowCheckpoints(Checkpoints):
    def save(self, run: Any) -> None:
        time.sleep(SHORT + 0.5)
        super().save(run)


SHORT = 0.3


def test_only_what_fmus_do_counts(linear: Build, tmp_path: Path) -> None:
    """Not what signals, checkpoints and real time take."""
    system = System({"one": linear(saves_state=True, serialises_state=True)})
    experiment = Experiment(1.0, 0.5, signals={"one.u[1]": Sleeps(SHORT + 0.5)})
    checkpoints = SlowCheckpoints(tmp_path / "checkpoint", every=0.5)
    recording = simulate(system, experiment, timeout=SHORT, real_time=1.0, checkpoints=checkpoints)
    assert recording.time.tolist() == [0.0, 0.5, 1.0]


def test_an_interrupt_of_the_preparation_ends_the_run(linear: Build) -> None:
    """While the process begins, or the first signal is asked."""
    system, experiment = System({"one": linear()}), Experiment(1e6, 1.0, signals={"one.u[1]": Sleeps(2.5)})
    timer = threading.Timer(1.5, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()
    with pytest.raises(SimulationError, match="interrupted") as caught:
        simulate(system, experiment, timeout=TIMEOUT)
    assert len(caught.value.recording.time) < 1_000_000


def test_what_comes_after_the_last_point_does_not_count(linear: Build) -> None:
    experiment = Experiment(4e6, 1.0, inputs={"one.u[1]": 0.0})
    recording = simulate(System({"one": linear()}), experiment, timeout=0.1)  # no less: a busy machine
    assert len(recording.time) == 4_000_001


def test_shorter_steps_between_two_points_each_count_alone(rogue: Build) -> None:
    """All of them take longer than the limit."""
    parameters = {"bad.misdeed": int(Misdeed.DISCARD), "bad.longest_step": 2e-5}
    experiment = Experiment(1.0, 1.0, parameters=parameters, inputs={"bad.u": 1.0})
    begun = time.monotonic()
    recording = simulate(System({"bad": rogue(saves_state=True)}), experiment, timeout=SHORT)
    assert time.monotonic() - begun > 2 * SHORT
    assert recording["bad.y"][-1] == pytest.approx(1.0, abs=1e-9)  # rounding of 5e4 sums


@pytest.mark.parametrize("compiled", [True, False])
def test_every_call_is_counted(linear: Build, compiled: bool) -> None:
    """In the loop and outside: each has a time limit of its own."""
    storage = Storage(np.empty((11, 2)), np.zeros(len(Report), np.int64))
    experiment = Experiment(1.0, 0.1, signals={"one.u[1]": lambda t: t})
    with Simulator(System({"one": linear()}), compiled) as simulator:
        simulator.run(experiment, storage=storage)
    initial = ["setup", "enter initialisation mode", "set the input", "leave it", "read"]
    assert storage.report[Report.CALLS] == len(initial) + 10 * len(["write", "step", "read"]) + len(
        ["end", "free"]
    )
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


@pytest.mark.parametrize(
    ("where", "words", "recorded"),
    [
        ("loading", "last in the initialisation: did not return within 3 s", 0),
        ("initialisation", "last in the initialisation: did not return within 1 s", 0),
    ],
)
def test_who_hangs_elsewhere_is_named(
    linear: Build, hangs: Path, monkeypatch: pytest.MonkeyPatch, where: str, words: str, recorded: int
) -> None:
    monkeypatch.setattr(apart, "_LOADING_S", 3.0)
    monkeypatch.setenv("HANGS_IN", where)
    system = System({"first": linear(), "last": hangs}, (("last.y", "first.u[1]"),))
    with pytest.raises(SimulationError, match=words) as caught:
        simulate(system, Experiment(1.0, 0.1), timeout=1.0)
    assert len(caught.value.recording.time) == recorded


def test_a_process_that_does_not_end_by_itself_is_ended(linear: Build) -> None:
    """Something in it waits for ever."""

    def leaves_a_thread(t: float) -> float:
        if t == 0.0:
            threading.Thread(target=time.sleep, args=(1e4,)).start()
        return t

    experiment = Experiment(1.0, 0.1, signals={"one.u[1]": leaves_a_thread})
    recording = simulate(System({"one": linear()}), experiment, timeout=SHORT)
    assert len(recording.time) == 11
