"""Runs in a process of their own: what a misbehaving FMU does to it is told, and done to nothing else."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import psutil
import pytest

from orchestration.errors import SweepError
from orchestration.many.job import ClosedError, Done, Failure, Job, Run
from orchestration.many.runners import Isolated
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

TIMEOUT_S = 3.0
RUN = Experiment(1.0, 0.01, inputs={"r.u": 2.0})
GOOD = replace(RUN, inputs={"r.u": 3.0})
Make = Callable[..., Isolated]


def does(misdeed: str) -> Experiment:
    return replace(RUN, parameters={"r.misdeed": misdeed, "r.misdeed_time": 0.5})


def means(runs: Recording) -> list[tuple[float, list[float]]]:
    """Returns mean and values of each run."""
    return [(float(run.mean()), run.tolist()) for run in runs["r.y"]]


def failed(done: Done) -> str | None:
    return done.result.reason if isinstance(done.result, Failure) else None


def run(runner: Isolated, experiment: Experiment = GOOD) -> Done:
    (done,) = runner.run([Run(0, experiment, means)])
    return done


@pytest.fixture
def job(rogue: Callable[..., Path]) -> Job:
    return Job(System({"r": rogue()}), RUN, TIMEOUT_S)


@pytest.fixture
def runner(job: Job, tmp_path: Path) -> Iterator[Isolated]:
    """Where runs are made; nothing is left of it afterwards but the FMU."""
    folder, others = tmp_path / "worker", processes()
    folder.mkdir()
    opened = Isolated(job, folder)
    yield opened
    opened.close()
    assert processes() <= others
    assert not list(folder.iterdir())


def processes() -> set[psutil.Process]:
    """Under this one; other tests may have left some, as multiprocessing does its resource tracker."""
    return set(psutil.Process().children(recursive=True))


def child() -> int:
    """The process of the runs, the one that was started last."""
    return max(processes(), key=lambda process: process.create_time()).pid


def test_a_run_has_the_result_of_the_same_run_in_this_process(runner: Isolated, job: Job) -> None:
    alone = simulate(job.system, GOOD)["r.y"]
    assert run(runner, does("warning")).warned == ("r",)
    for done in (run(runner), run(runner)):  # whatever ran before
        assert done.result == (float(alone.mean()), alone.tolist())
        assert done.warned == ()


def test_the_process_and_its_fmus_stay_from_run_to_sample(runner: Isolated) -> None:
    run(runner)
    first = child()
    assert failed(run(runner, does("error")))
    run(runner)
    assert child() == first


@pytest.mark.parametrize(
    ("misdeed", "error"),
    [
        ("error", "r at t = 0.5 s: fmi2DoStep returned error: the rudder is stuck"),
        ("hang", f"it took longer than the timeout of {TIMEOUT_S:g} s"),
    ],
)
def test_what_an_fmu_does_is_told_and_the_next_run_runs(runner: Isolated, misdeed: str, error: str) -> None:
    assert failed(run(runner, does(misdeed))) == error
    assert failed(run(runner)) is None


@pytest.mark.slow
def test_a_process_killed_by_somebody_else_is_replaced_and_its_run_run_again(
    runner: Isolated,
) -> None:
    run(runner)
    before = child()
    os.kill(before, signal.SIGSTOP)  # so that the sample cannot end before it is killed
    threading.Timer(0.3, os.kill, (before, signal.SIGKILL)).start()
    assert failed(run(runner)) is None
    assert child() != before


@pytest.mark.slow
def test_closing_ends_a_run_that_runs(runner: Isolated) -> None:
    run(runner)
    threading.Timer(0.3, runner.close).start()
    begin = time.monotonic()
    with pytest.raises(ClosedError):
        run(runner, does("hang"))
    assert time.monotonic() - begin < TIMEOUT_S


@pytest.mark.slow
def test_an_fmu_that_cannot_be_loaded_is_told_without_the_place_where_it_was_unpacked(
    job: Job, tmp_path: Path
) -> None:
    unpacked = job.with_packed_fmus().with_unpacked_fmus(tmp_path / "worker")
    (path,) = unpacked.system.components.values()
    path.write_bytes(b"no zip any more")
    opened = Isolated(unpacked, tmp_path / "worker")
    error = failed(run(opened)) or ""
    opened.close()
    assert error.startswith(f"{path.name} is not an FMU: expected a zip")


def test_a_python_that_cannot_run_runs_is_told_at_once(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "numpy.py").write_text("raise ImportError('not this one')")
    monkeypatch.syspath_prepend(tmp_path)
    opened = Isolated(job, tmp_path)
    with pytest.raises(SweepError, match="cannot start: ImportError: not this one"):
        run(opened)
    opened.close()
