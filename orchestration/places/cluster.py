"""Runs on the workers of a Dask cluster, which may join, leave and end while they run.

The job, FMUs included, is a plugin of the workers: the scheduler keeps it and gives it to every worker, also
to those that join later or replace one that has ended. Each unpacks it once, in its own local folder.
"""

import time
import uuid
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory

import cloudpickle

from fmus.extras import imports_of
from fmus.store import record_build
from orchestration.errors import SweepError
from orchestration.many.job import Batches, ClosedError, Done, Failure, Finished, Job, Run
from orchestration.many.runners import Isolated, vector_limits

with imports_of("sweep", "a sweep on a cluster"):
    from distributed import (
        Client,
        Future,
        KilledWorker,
        Reschedule,
        Worker,
        WorkerPlugin,
        get_worker,
        wait,
    )

PATIENCE_S = 30.0  # for a scheduler to answer and for its first worker
LOOK_S = 5.0  # after which workers that have joined meanwhile get work
WITHOUT_WORKERS_S = 120.0
_AHEAD = 3  # batches for each thread: one runs, the others wait


def runs(
    address: str, workers: int | None, note: Callable[[str], object]
) -> AbstractContextManager["ClusterRuns"]:
    """Returns the workers of a scheduler somewhere, such as tcp://host:8786, as a place of runs."""
    if workers:
        raise SweepError(f"{address} with {workers} workers: expected none; a cluster has its own")
    return _connected(address)


@contextmanager
def _connected(address: str) -> Iterator["ClusterRuns"]:
    try:
        client = Client(address, timeout=PATIENCE_S, name="l1-depth sweep")
    except (OSError, ValueError) as error:
        raise SweepError(f"no Dask scheduler at {address}: {error}") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE_S)
        except TimeoutError:
            raise SweepError(f"the scheduler at {address} has no workers: expected one or more") from None
        yield ClusterRuns(client)


class JobPlugin(WorkerPlugin):
    """Makes runs on a worker, in one process of FMUs for each of its threads.

    vectors: whether they step together, where the worker has a compiler
    """

    def __init__(self, name: str, job: Job, vectors: bool) -> None:
        self.name, self._vectors = name, vectors
        self._pickled = cloudpickle.dumps(job.with_packed_fmus())

    def setup(self, worker: Worker) -> None:
        self._folder = TemporaryDirectory(
            dir=worker.local_directory, prefix="sweep-", ignore_cleanup_errors=True
        )
        job: Job = cloudpickle.loads(self._pickled)
        if self._vectors:  # builds of the user whose code this worker runs
            for content in job.fmus.values():
                record_build(content)
        self._job = job.with_unpacked_fmus(Path(self._folder.name))
        self._idle: list[Isolated] = []
        self._all: list[Isolated] = []

    def teardown(self, worker: Worker) -> None:
        for runner in self._all:
            runner.close()
        self._folder.cleanup()

    def run(self, pickled: bytes) -> tuple[list[Done], float]:
        """Returns the first of the runs, in a process that no other thread uses, and their time [s]."""
        try:
            runner = self._idle.pop()
        except IndexError:  # not asked for before: another thread may take the last one meanwhile
            runner = Isolated(self._job, Path(self._folder.name), self._vectors)
            self._all.append(runner)
        start = time.perf_counter()
        try:
            done = runner.run(self._job.unpickled(pickled))
            return done, time.perf_counter() - start
        except ClosedError:  # this worker leaves the cluster
            raise Reschedule from None
        finally:
            self._idle.append(runner)


def run_batch(plugin: str, pickled: bytes) -> tuple[list[Done], float]:
    """Returns what `JobPlugin.run` returns, of the worker that this is called on."""
    installed = get_worker().plugins[plugin]
    assert isinstance(installed, JobPlugin)
    return installed.run(pickled)


class ClusterRuns:
    """The workers that a client reaches, as a place of runs."""

    def __init__(self, client: Client) -> None:
        self.client = client

    def runs(self, job: Job, batches: Batches) -> Generator[list[Finished], None, None]:
        """Yields the runs as they are finished; see `Place`. SweepError if the cluster is lost."""
        threads: dict[str, int] = self.client.nthreads()  # type: ignore[assignment]
        limits, _ = vector_limits(job, batches.left, max(sum(threads.values()), 1))
        plugin = JobPlugin(f"l1-depth-sweep-{uuid.uuid4()}", job, bool(limits))
        self.client.register_plugin(plugin)
        try:
            yield from _Dispatch(self.client, job, plugin.name, batches, limits).work()
        finally:
            if self.client.status == "running":
                self.client.unregister_worker_plugin(plugin.name)


@dataclass
class _Dispatch:
    """The runs that the cluster makes.

    The runs of a batch whose workers ended are made again, each in a separate task; then alone; one whose
    workers end again is a failure.
    """

    client: Client
    job: Job
    plugin: str  # its name: others may run on the same cluster
    batches: Batches
    limits: Sequence[int]  # of batches: runs of a group, and of a batch
    again: deque[Sequence[Run]] = field(default_factory=deque)
    suspects: deque[Sequence[Run]] = field(default_factory=deque)
    alone: Sequence[Run] | None = None
    running: dict[Future, Sequence[Run]] = field(default_factory=dict)
    last_time_with_workers: float = field(default_factory=time.monotonic)

    def work(self) -> Iterator[list[Finished]]:
        try:
            while self._fill():
                with suppress(TimeoutError, CancelledError):
                    wait(list(self.running), timeout=LOOK_S, return_when="FIRST_COMPLETED")
                for future in [future for future in self.running if future.status != "pending"]:
                    yield from self._handled(future, self.running.pop(future))
        finally:
            self.client.cancel(list(self.running))

    def _fill(self) -> bool:
        """Gives every thread work; False if no work is left and nothing runs."""
        threads = self._threads()
        while len(self.running) < _AHEAD * threads and (batch := self._next(threads)):
            self._submit(batch)
        if self.suspects and not self.running:
            self.alone = self.suspects.popleft()
            self._submit(self.alone)
        return bool(self.running)

    def _next(self, threads: int) -> Sequence[Run]:
        return self.again.popleft() if self.again else self.batches.take(_AHEAD * threads, *self.limits)

    def _submit(self, batch: Sequence[Run]) -> None:
        task = self.client.submit(run_batch, self.plugin, self.job.pickled(batch), pure=False)
        self.running[task] = batch

    def _threads(self) -> int:
        """Returns the threads of all workers; workers that are replaced may be none for a while."""
        threads_by_worker: dict[str, int] = self.client.nthreads()  # type: ignore[assignment]
        if threads_by_worker:
            self.last_time_with_workers = time.monotonic()
        elif time.monotonic() - self.last_time_with_workers > WITHOUT_WORKERS_S:
            raise SweepError(
                f"the cluster has had no workers for {WITHOUT_WORKERS_S:g} s; finished samples are kept"
            )
        return max(sum(threads_by_worker.values()), 1)

    def _handled(self, future: Future, batch: Sequence[Run]) -> Iterator[list[Finished]]:
        if future.status == "finished":
            made, seconds = future.result()
            self.batches.note(len(made), seconds, batch[len(made) :])
            yield [Finished(run.key, done) for run, done in zip(batch, made, strict=False)]
        elif future.status == "lost":  # its worker ended when it was done, before its results were fetched
            self.again.append(batch)
        elif future.status != "error":
            raise SweepError("the Dask scheduler was lost; finished samples are kept")
        elif not isinstance(future.exception(), KilledWorker):
            raise SweepError(f"a worker cannot run samples: {future.exception()}")
        elif batch is self.alone:
            yield [Finished(run.key, Done(Failure("every worker that ran it ended"))) for run in batch]
        else:
            (self.again if len(batch) > 1 else self.suspects).extend([run] for run in batch)
