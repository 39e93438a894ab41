"""Samples in a process of their own: what a misbehaving FMU does to it is told, and done to nothing else."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest

from orchestration.errors import SweepError
from orchestration.master import simulate
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.scenarios import scenario
from orchestration.sweep.isolated import IsolatedSamples
from orchestration.sweep.plan import plan
from orchestration.sweep.samples import Job

TIMEOUT_S = 3.0
SWEEP = f"[sweep]\ntimeout = {TIMEOUT_S}\n" + '[sweep.vary."r.u"]\nvalues = [1]\n'
SAMPLE = {"inputs": {"r.u": 3.0}}


def does(misdeed: str, **parameters: float) -> dict[str, dict[str, Any]]:
    return {"parameters": {"r.misdeed": misdeed, "r.misdeed_time": 0.5, **parameters}}


@pytest.fixture
def samples(sweep_file: Callable[..., Path], tmp_path: Path) -> Iterator[IsolatedSamples]:
    """Where samples run; nothing is left of it afterwards but the FMU."""
    made = Job.of(plan(scenario.load(sweep_file(SWEEP))), recorded=("r.y",))
    folder, others = tmp_path / "worker", processes()
    folder.mkdir()
    opened = IsolatedSamples(made, folder)
    yield opened
    opened.close()
    assert processes() <= others
    assert not list(folder.iterdir())


def processes() -> set[psutil.Process]:
    """Under this one; other tests may have left some, as multiprocessing does its resource tracker."""
    return set(psutil.Process().children(recursive=True))


def child() -> int:
    """The process of the samples, the one that was started last."""
    return max(processes(), key=lambda process: process.create_time()).pid


def test_a_sample_gives_the_metrics_and_the_recording_of_the_same_run_alone(
    samples: IsolatedSamples, sweep_file: Callable[..., Path], tmp_path: Path
) -> None:
    path = sweep_file(SWEEP)
    alone = scenario.load(path, {"inputs": SAMPLE["inputs"]})
    recording = simulate(alone.system, alone.experiment)
    outcomes = [samples.run(does("warning")), samples.run(SAMPLE), samples.run(SAMPLE)]
    for outcome in outcomes[1:]:  # whatever ran before
        assert outcome.error is None
        assert outcome.metrics == metrics.evaluate(recording, alone.metrics)
        (tmp_path / "sample.parquet").write_bytes(outcome.recording or b"")
        read = Recording.read(tmp_path / "sample.parquet")
        assert read.names == ("r.y",)
        assert read["r.y"].tolist() == recording["r.y"].tolist()


def test_the_process_and_its_fmus_stay_from_sample_to_sample(samples: IsolatedSamples) -> None:
    samples.run(SAMPLE)
    first = child()
    assert samples.run(does("error")).error is not None
    samples.run(SAMPLE)
    assert child() == first


@pytest.mark.parametrize(
    ("misdeed", "error"),
    [
        ("error", "r at t = 0.5 s: fmi2DoStep returned error: the rudder is stuck"),
        ("fatal", "r at t = 0.5 s: fmi2DoStep returned fatal: the hull is breached"),
        ("segfault", "the worker process ended: SIGSEGV"),
        pytest.param("abort", "the worker process ended: SIGABRT", marks=pytest.mark.slow),
        ("hang", f"it took longer than the timeout of {TIMEOUT_S:g} s"),
    ],
)
def test_what_an_fmu_does_is_told_and_the_next_sample_runs(
    samples: IsolatedSamples, misdeed: str, error: str
) -> None:
    outcome = samples.run(does(misdeed))
    assert (outcome.error, outcome.metrics, outcome.recording) == (error, {}, None)
    assert samples.run(SAMPLE).error is None


def test_a_process_killed_by_somebody_else_is_replaced_and_its_sample_run_again(
    samples: IsolatedSamples,
) -> None:
    samples.run(SAMPLE)
    before = child()
    os.kill(before, signal.SIGSTOP)  # so that the sample cannot end before it is killed
    threading.Timer(0.3, os.kill, (before, signal.SIGKILL)).start()
    assert samples.run(SAMPLE).error is None
    assert child() != before


def test_closing_ends_a_sample_that_runs(samples: IsolatedSamples) -> None:
    samples.run(SAMPLE)
    threading.Timer(0.3, samples.close).start()
    begin = time.monotonic()
    with pytest.raises(SweepError, match="closed while a sample was running"):
        samples.run(does("hang"))
    assert time.monotonic() - begin < TIMEOUT_S


def test_an_fmu_that_cannot_be_loaded_is_told_without_the_place_where_it_was_unpacked(
    sweep_file: Callable[..., Path], tmp_path: Path
) -> None:
    made = Job.of(plan(scenario.load(sweep_file(SWEEP))), recorded=None)
    unpacked = made.with_packed_fmus().with_unpacked_fmus(tmp_path / "worker")
    (path,) = unpacked.system.components.values()
    path.write_bytes(b"no zip any more")
    opened = IsolatedSamples(unpacked, tmp_path / "worker")
    error = opened.run(SAMPLE).error or ""
    opened.close()
    assert error.startswith(f"{path.name} is not an FMU: expected a zip")


def test_a_python_that_cannot_run_samples_is_told_at_once(
    sweep_file: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "numpy.py").write_text("raise ImportError('not this one')")
    monkeypatch.syspath_prepend(tmp_path)
    made = Job.of(plan(scenario.load(sweep_file(SWEEP))), recorded=None)
    opened = IsolatedSamples(made, tmp_path)
    with pytest.raises(SweepError, match="cannot start: ImportError: not this one"):
        opened.run(SAMPLE)
    opened.close()
