"""Runs with FMUs that stay loaded: in this process, one by one or several in vectors, or in another process.

Whatever FMUs do to the other process, there is a result or a reason.
"""

import os
import tempfile
import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

import cloudpickle

from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess
from orchestration.errors import EnsembleError, OrchestrationError, SweepError
from orchestration.many.ensemble import Ensemble, check_ensemble, shape
from orchestration.many.ensemble_loop import Device
from orchestration.many.job import BATCH_S, ENDED, TOO_LONG, ClosedError, Done, Failure, Job, Run
from orchestration.many.lane_library import LANES
from orchestration.results.recording import Recording
from orchestration.run.simulator import Simulator

_BATCH_BYTES = 2**24  # of recorded values, if a group of vectors has less
_TEMPORARIES = 8  # times the memory of what a device records, for it, its systems, and what metrics compute


class Simulated(AbstractContextManager["Simulated"]):
    """Makes runs one after another; the FMUs are loaded anew after one that failed."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._loaded = ExitStack()  # holds a simulator, until a run fails
        self._simulator: Simulator | None = None
        self._closed = False

    def load(self) -> Simulator:
        """Returns the simulator; OrchestrationError for FMUs that cannot be loaded."""
        if not self._simulator:
            self._simulator = self._loaded.enter_context(Simulator(self._job.system, threads=1))
        return self._simulator

    def run(self, runs: Sequence[Run]) -> list[Done]:
        """Returns the runs that begin within `BATCH_S`."""
        end, done = perf_counter() + BATCH_S, list[Done]()
        for run in runs:
            done.append(self.run_one(run))
            if perf_counter() >= end:
                break
        return done

    def run_one(self, run: Run) -> Done:
        """Returns one run."""
        start = thread_time()
        try:
            simulator = self.load()
            recording = simulator.run(run.experiment, self._check_open)
            self._check_open()  # closed in the second run of an error estimate, it has none
            seconds = thread_time() - start
            (result,) = run.reduce(replace(recording, values=recording.values[None]))
            return Done(result, tuple(simulator.warned), seconds)
        except Exception as error:  # whatever the reason, the others go on
            self._simulator = self._loaded.close()
            self._check_open()
            return Done(Failure(self._job.error_line(error)))

    def close(self) -> None:
        """Ends a run of another thread soon."""
        self._closed = True

    def __exit__(self, *_: object) -> None:
        self._loaded.close()

    def _check_open(self, *_: int) -> None:
        if self._closed:
            raise ClosedError("closed during a run")


def vector_limits(
    job: Job, count: int, workers: int, vectorise: bool | None = None, device: Device | None = None
) -> tuple[tuple[int, ...], str]:
    """Decides whether runs step together in vectors, or on a device, and compiles these.

    count: of the runs; workers: how many make them side by side
    vectorise: by default where they can and it pays; True raises EnsembleError where they cannot
    device: on which they step, with `vectorise=True`
    Returns how many runs a group of vectors has, and a batch at most; or nothing, and the reason.
    """
    if vectorise is False:
        return (), ""
    try:
        if job.not_in_vectors:
            raise EnsembleError(job.not_in_vectors)
        if device and job.timeout:
            raise EnsembleError(f"{device.name} ends no run: expected no timeout, got {job.timeout:g} s")
        group_bytes = check_ensemble(job.system, job.base, count, bool(vectorise), threads=workers)
        Ensemble(job.system, device=device).close()
        if device:
            at_once = min(count, max(1, device.free_bytes() * LANES // (_TEMPORARIES * group_bytes)))
            return (at_once, at_once), ""
        return (LANES, LANES * max(1, _BATCH_BYTES // group_bytes)), ""
    except EnsembleError as reason:
        if vectorise:
            raise
        return (), f": {reason}"


class Vectorised(AbstractContextManager["Vectorised"]):
    """Makes runs at once as instances of an ensemble, with the results of `Simulated`.

    Successive runs of one shape step together: they differ in values of the same parameters, inputs and
    signals. A run that fails is made alone, by a simulator that may try shorter steps; so is one that has no
    result of its `reduce`, for its reason.
    is_asked_for: whether experiments that an ensemble cannot run raise EnsembleError; otherwise they are
    simulated one after another
    device: on which they step, in place of this processor
    """

    def __init__(self, job: Job, is_asked_for: bool = False, device: Device | None = None) -> None:
        self._is_asked_for = is_asked_for
        self._ensemble, self._alone = Ensemble(job.system, device=device), Simulated(job)

    def run(self, runs: Sequence[Run]) -> list[Done]:
        """Returns all runs."""
        groups = groupby(runs, lambda run: shape(run.experiment))
        return [done for _, group in groups for done in self._run_group([*group])]

    def _run_group(self, runs: Sequence[Run]) -> list[Done]:
        results = dict[int, Any]()
        if len(runs) > 1:
            try:
                recorded = self._ensemble.run([run.experiment for run in runs])
                if recorded.complete:
                    reduced = _reduced(recorded.recordings(), [runs[i] for i in recorded.complete])
                    results = dict(zip(recorded.complete, reduced, strict=True))
            except EnsembleError:
                if self._is_asked_for:
                    raise
            except OrchestrationError:  # of values that no instance can have
                pass
        return [
            self._alone.run_one(run) if results.get(i) is None else Done(results[i])
            for i, run in enumerate(runs)
        ]

    def close(self) -> None:
        """Ends a run of a simulator soon."""
        self._alone.close()

    def __exit__(self, *error: object) -> None:
        self._ensemble.__exit__(*error)
        self._alone.__exit__(*error)


def _reduced(recording: Recording, runs: Sequence[Run]) -> list[Any]:
    """Returns the result of each run of a recording, None where it has no result."""
    results, first = list[Any](), 0
    for reduce, group in groupby(runs, key=lambda run: run.reduce):
        count = len([*group])
        part = replace(recording, values=recording.values[first : first + count])
        try:
            results += reduce(part)
        except Exception:  # of one of them; each is made alone
            results += [None] * count
        first += count
    return results


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
    """Serves in the process: receives a job, loads its FMUs and makes its runs, until the next job.

    Files with relative names end with the process: its folder is the working folder.
    """
    os.chdir(tempfile.gettempdir())
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


Runner = Simulated | Vectorised | Isolated
"""`run` returns the first of the runs given, at least one; ClosedError if `close` ended it meanwhile."""
