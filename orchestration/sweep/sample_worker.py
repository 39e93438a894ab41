"""The process in which the FMUs of a sweep are loaded and run.

An FMU that crashes or hangs takes this process with it and nothing else. The FMUs stay loaded from sample
to sample.
"""

import pickle
import re
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir

from fmus.process import Parent
from orchestration.errors import OrchestrationError
from orchestration.master import Simulator
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.sweep.job import Job, Outcome
from orchestration.sweep.target import Settings, with_settings

READY = "ready"


class _Runner:
    """Runs samples with FMUs that stay loaded until one fails."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._stack = ExitStack()
        self._simulator: Simulator | None = None

    def open(self) -> Simulator:
        if self._simulator is None:
            self._simulator = self._stack.enter_context(Simulator(self._job.system))
        return self._simulator

    def run(self, settings: Settings) -> Outcome:
        try:
            recording = self.open().run(with_settings(self._job.experiment, settings))
            measured = metrics.evaluate(recording, self._job.metrics)
            return Outcome(measured, recording=self._as_parquet(recording))
        except Exception as error:  # a sample that fails is a row, whatever the reason
            self.close()
            return Outcome({}, error=_error_line(error))

    def close(self) -> None:
        self._simulator = None
        self._stack.close()

    def _as_parquet(self, recording: Recording) -> bytes | None:
        if self._job.recorded is None:
            return None
        with TemporaryDirectory() as folder:
            path = Path(folder) / "sample.parquet"
            _with_signals(recording, self._job.recorded).write(path)
            return path.read_bytes()


def _with_signals(recording: Recording, names: tuple[str, ...]) -> Recording:
    if not names:
        return recording
    columns = [recording.names.index(name) for name in names]
    units = tuple(recording.units[column] for column in columns)
    return replace(recording, names=names, units=units, values=recording.values[:, columns])


def _error_line(error: Exception) -> str:
    """One line that does not depend on where this process keeps its files."""
    text = str(error) if isinstance(error, OrchestrationError) else f"{type(error).__name__}: {error}"
    temporary = Path(gettempdir())
    for folder in (temporary, temporary.parent):  # of what was unpacked, and of the FMUs
        text = re.sub(rf"{re.escape(str(folder))}/[^/\s]+/", "", text)
    return " ".join(text.split())


def run_samples(parent: Parent) -> None:
    """Receive a pickled job, send READY; then receive the settings of samples and send their outcomes."""
    runner = _Runner(pickle.loads(parent.receive()))
    with suppress(OrchestrationError):  # each sample will fail with it
        runner.open()
    parent.send(READY)
    while True:
        parent.send(runner.run(parent.receive()))
