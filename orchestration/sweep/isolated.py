"""Samples in another process: ask for one and get an outcome, whatever its FMUs do to the process."""

import threading
from pathlib import Path

import cloudpickle

from fmus.process import ProcessEndedError, WorkerProcess
from orchestration.errors import SweepError
from orchestration.sweep.samples import ClosedError, Job, Outcome, run_samples
from orchestration.sweep.target import Settings

_ATTEMPTS = 2  # a process that ends once may have been killed by somebody, one that ends again by its sample
_START_S = 300.0  # to import, load and compile, on a machine that is busy


class IsolatedSamples:
    """Runs samples one after another in a process, which is replaced when it ends or takes too long.

    job: its FMUs are files; folder: for what they would leave behind when they crash, its owner removes it
    """

    def __init__(self, job: Job, folder: Path) -> None:
        self._timeout = job.timeout
        self._folder = folder
        self._job = cloudpickle.dumps(job)
        self._process: WorkerProcess | None = None
        self._ready = False
        self._lock = threading.Lock()
        self._closed = False

    def run(self, settings: Settings) -> Outcome:
        """One sample. SweepError if no process can be started, ClosedError if it was closed meanwhile."""
        reason = ""
        for _ in range(_ATTEMPTS):
            process = self._running()
            try:
                self._wait_until_ready(process)
                process.send(settings)
                return process.receive(self._timeout)
            except ProcessEndedError as ended:
                reason = str(ended)
                self._replace()
            except TimeoutError:
                self._replace()
                return Outcome({}, error=f"it took longer than the timeout of {self._timeout:g} s")
        return Outcome({}, error=f"the worker process ended: {reason}")

    def close(self) -> None:
        """At once, also from another thread while a sample runs."""
        with self._lock:
            self._closed = True
        self._replace()

    def _running(self) -> WorkerProcess:
        with self._lock:
            if self._closed:
                raise ClosedError("closed while a sample was running")
            if self._process is None:
                self._process, self._ready = WorkerProcess(run_samples, self._folder), False
                self._process.send(self._job)
            return self._process

    def _wait_until_ready(self, process: WorkerProcess) -> None:
        """Wait until the FMUs are loaded. SweepError if that takes too long or Python cannot start."""
        if self._ready:
            return
        try:
            process.receive(_START_S)
        except TimeoutError:
            raise SweepError(f"the process that runs samples was not ready after {_START_S:g} s") from None
        except ProcessEndedError as ended:
            if ended.status > 0:  # not of a crash
                reason = ended.last_error_line or str(ended)
                raise SweepError(f"the process that runs samples cannot start: {reason}") from ended
            raise
        self._ready = True

    def _replace(self) -> None:
        """The next sample gets another process."""
        with self._lock:
            if self._process is not None:
                self._process.close()
            self._process = None
