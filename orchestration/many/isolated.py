"""Runs in another process: whatever their FMUs do to it, there is a result or a reason."""

import threading
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from time import perf_counter

import cloudpickle

from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess
from orchestration.errors import EnsembleError, OrchestrationError, SweepError
from orchestration.many.job import BATCH_S, ENDED, TOO_LONG, Done, Failure, Job, Run
from orchestration.many.lane_library import LANES
from orchestration.many.runners import ClosedError, Simulated, Vectorised

_ATTEMPTS = 2  # a process that ends once may have been killed by somebody, one that ends again by its run
_START_S = 300.0  # to import, load and compile, on a machine that is busy


class Isolated:
    """Makes runs in a process, which is replaced when it ends or takes too long.

    job: its FMUs are files; vectors: whether runs step together, in groups, in the process
    folder: for what FMUs would leave behind when they crash, its owner removes it
    """

    def __init__(self, job: Job, folder: Path | None = None, vectors: bool = False) -> None:
        self._folder = folder
        self._process: WorkerProcess | None = None
        self._lock = threading.Lock()
        self._closed = False
        self.use(job, vectors)

    def use(self, job: Job, vectors: bool) -> None:
        """Makes runs of this job from now on, in the same process."""
        self._job, self._vectors, self._ready = job, vectors, False

    def run(self, runs: Sequence[Run]) -> list[Done]:
        """Returns the runs that begin within `BATCH_S`; SweepError if no process can be started."""
        end, done = perf_counter() + BATCH_S, list[Done]()
        while len(done) < len(runs) and (not done or perf_counter() < end):
            done += self._made(runs[len(done) :][: LANES if self._vectors else 1])
        return done

    def _made(self, runs: Sequence[Run]) -> list[Done]:
        """Returns runs that step together; each alone where these take too long or end the process."""
        timeout, message = self._job.timeout, self._job.pickled(runs)
        failure = Failure("")
        for _ in range(_ATTEMPTS if len(runs) == 1 else 1):
            process = self._running()
            try:
                self._wait_until_ready(process)
                process.send(message)
                return process.receive(None if timeout is None else timeout * len(runs))
            except ProcessEndedError as ended:
                failure = Failure(f"the worker process ended: {ended}", ENDED)
                self._replace()
            except TimeoutError:
                failure = Failure(f"it took longer than the timeout of {timeout:g} s", TOO_LONG)
                self._replace()
                break
        return [Done(failure)] if len(runs) == 1 else [done for run in runs for done in self._made([run])]

    def close(self) -> None:
        """Ends the process at once, also from another thread during a run."""
        with self._lock:
            self._closed = True
        self._replace()

    def _running(self) -> WorkerProcess:
        with self._lock:
            if self._closed:
                raise ClosedError("closed during a run")
            if self._process is None:
                self._process, self._ready = WorkerProcess(answer, self._folder), False
            return self._process

    def _wait_until_ready(self, process: WorkerProcess) -> None:
        """Waits until the FMUs are loaded. SweepError if that takes too long or Python cannot start."""
        if self._ready:
            return
        try:
            process.send((cloudpickle.dumps(self._job), self._vectors))
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
        """Replaces the process for the next run."""
        with self._lock:
            if self._process is not None:
                self._process.close()
            self._process = None


def answer(parent: Parent) -> None:
    """Serves in the process: receives a job, loads its FMUs and makes its runs, until the next job."""
    job = parent.receive()
    while True:
        job = _next_job(parent, job)


def _next_job(parent: Parent, received: tuple[bytes, bool]) -> tuple[bytes, bool]:
    """Makes runs of a job until another one is received."""
    pickled, vectors = received
    job: Job = cloudpickle.loads(pickled)
    with _runner(job, vectors) as runner:
        parent.send("ready")
        while True:
            message = parent.receive()
            if isinstance(message, tuple):
                return message
            parent.send(runner.run(job.unpickled(message)), cloudpickle.dumps)


def _runner(job: Job, vectors: bool) -> Simulated | Vectorised:
    if vectors:
        with suppress(EnsembleError):  # here, where another machine could
            return Vectorised(job)
    runner = Simulated(job)
    with suppress(OrchestrationError):  # each run will fail with it
        runner.load()
    return runner
