"""An interrupt ends a run between two steps, never inside an FMU."""

import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from orchestration.errors import SimulationError
from orchestration.run import simulate
from orchestration.run.checkpoint import Checkpoints, read_checkpoint
from orchestration.run.process_guard import deferred_interrupt
from orchestration.system.experiment import Experiment
from orchestration.system.system import System
from tests.orchestration.linear_systems import RESUMABLE, coupled
from tests.shared_builds import Build

Progress = Callable[[int, int], None]


@pytest.fixture
def interrupt_soon() -> Iterator[Progress]:
    """A progress that raises SIGINT some time after the run has begun."""
    timer = threading.Timer(0.2, lambda: signal.raise_signal(signal.SIGINT))

    def progress(done: int, total: int) -> None:
        if timer.ident is None:
            timer.start()

    yield progress
    if timer.ident:
        timer.join()


def test_an_interrupt_waits_for_the_end_of_a_step(
    python_built: Mapping[str, Path], interrupt_soon: Progress
) -> None:
    """Inside an FMU it would strike the FMU's Python and look like the FMU's failure."""
    inputs = {"p.control": 0.0, "p.disturbance": 0.0}
    before = signal.getsignal(signal.SIGINT)
    system, experiment = System({"p": python_built["ExamplePlant"]}), Experiment(100.0, 1e-3, inputs=inputs)
    with pytest.raises(SimulationError, match=r"^interrupted$") as caught:
        simulate(system, experiment, interrupt_soon)
    assert len(caught.value.recording.time) > 1
    assert signal.getsignal(signal.SIGINT) is before


def test_runs_in_other_threads_do_not_touch_signals(linear: Build) -> None:
    with ThreadPoolExecutor(1) as thread:
        recording = thread.submit(simulate, coupled(linear), Experiment(0.1, 0.1)).result()
    assert len(recording.time) == 2


def test_an_interrupt_of_the_last_stretch_is_not_lost() -> None:
    """It comes when nothing looks at it any more."""
    with pytest.raises(KeyboardInterrupt), deferred_interrupt():
        signal.raise_signal(signal.SIGINT)


def test_an_interrupt_ends_shorter_steps_between_two_points(
    linear: Build, tmp_path: Path, interrupt_soon: Progress
) -> None:
    """And the system goes back to the point before them, from where it can go on."""
    system, checkpoints = coupled(linear, **RESUMABLE), Checkpoints(tmp_path / "c")
    with pytest.raises(SimulationError, match="interrupted; saved in"):
        simulate(system, Experiment(2.0, 2.0, tolerance=1e-7), interrupt_soon, checkpoints=checkpoints)
    assert read_checkpoint(tmp_path / "c").position == 0


def test_an_interrupt_ends_a_wait_for_the_clock(linear: Build, interrupt_soon: Progress) -> None:
    begun = time.monotonic()
    with pytest.raises(SimulationError, match="interrupted"):
        simulate(coupled(linear), Experiment(600.0, 300.0), interrupt_soon, real_time=1.0)
    assert time.monotonic() - begun < 60.0  # and not 600
