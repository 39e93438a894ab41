"""Runs in another process: whatever their FMUs do to it, there is a result or a reason."""

import pickle
import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import perf_counter

import cloudpickle

from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess
from orchestration.errors import OrchestrationError, SweepError
from orchestration.many.job import Changes, Done, Failure, Job, changed, differences
from orchestration.many.runners import BATCH_S, ClosedError, Simulated
from orchestration.system.experiment import Experiment

_ATTEMPTS = 2  # a process that ends once may have been killed by somebody, one that ends again by its run
_START_S = 300.0  # to import, load and compile, on a machine that is busy


class Isolated:
    """Makes runs in a process, which is replaced when it ends or takes too long.

    job: its FMUs are files; folder: for what they would leave behind when they crash, its owner removes it
    """

    def __init__(self, job: Job, folder: Path) -> None:
        self._job, self._folder = job, folder
        self._pickled = cloudpickle.dumps(job)
        self._process: WorkerProcess | None = None
        self._ready = False
        self._lock = threading.Lock()
        self._closed = False

    def run(self, experiments: Sequence[Experiment]) -> list[Done]:
        """Returns the runs that begin within `BATCH_S`; SweepError if no process can be started."""
        end, done = perf_counter() + BATCH_S, list[Done]()
        for experiment in experiments:
            done.append(self._run_one(differences(self._job.base, experiment)))
            if perf_counter() >= end:
                break
        return done

    def _run_one(self, changes: Changes) -> Done:
        reason, message = "", cloudpickle.dumps(changes)
        for _ in range(_ATTEMPTS):
            process = self._running()
            try:
                self._wait_until_ready(process)
                process.send(message)
                return process.receive(self._job.timeout)
            except ProcessEndedError as ended:
                reason = str(ended)
                self._replace()
            except TimeoutError:
                self._replace()
                return Done(Failure(f"it took longer than the timeout of {self._job.timeout:g} s"))
        return Done(Failure(f"the worker process ended: {reason}"))

    def close(self) -> None:
        """End the process at once, also from another thread during a run."""
        with self._lock:
            self._closed = True
        self._replace()

    def _running(self) -> WorkerProcess:
        with self._lock:
            if self._closed:
                raise ClosedError("closed during a run")
            if self._process is None:
                self._process, self._ready = WorkerProcess(answer, self._folder), False
                self._process.send(self._pickled)
            return self._process

    def _wait_until_ready(self, process: WorkerProcess) -> None:
        """Wait until the FMUs are loaded. SweepError if that takes too long or Python cannot start."""
        if self._ready:
            return
        try:
            process.receive(_START_S)
        except TimeoutError:
            raise SweepError(f"the process of runs was not ready after {_START_S:g} s") from None
        except ProcessEndedError as ended:
            if ended.status > 0:  # not of a crash
                reason = ended.last_error_line or str(ended)
                raise SweepError(f"the process of runs cannot start: {reason}") from ended
            raise
        self._ready = True

    def _replace(self) -> None:
        """The next run gets another process."""
        with self._lock:
            if self._process is not None:
                self._process.close()
            self._process = None


def answer(parent: Parent) -> None:
    """In the process: receive a job and load its FMUs; then receive what runs change and send the runs."""
    job: Job = pickle.loads(parent.receive())
    runner = Simulated(job)
    with suppress(OrchestrationError):  # each run will fail with it
        runner.load()
    parent.send("ready")
    while True:
        parent.send(runner.run_one(changed(job.base, pickle.loads(parent.receive()))), cloudpickle.dumps)
