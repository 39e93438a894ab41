"""Running a sweep: samples go to workers in batches, rows come back to the store."""

import time
import uuid
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, suppress
from pathlib import Path

from fmus.extras import imports_of
from orchestration.errors import SweepError
from orchestration.sweep.job import Job, Outcome, job
from orchestration.sweep.plan import Plan
from orchestration.sweep.store import Store
from orchestration.sweep.table import ERROR, SAMPLE, provenance, schema
from orchestration.sweep.worker import SamplePlugin, run_batch

with imports_of("sweep", "a sweep"):
    from distributed import Client, Future, KilledWorker, wait

_BUDGET_S = 2.0  # of a batch: what comes back so often costs little, and is little to lose
_LARGEST_BATCH = 64
_LOOK_S = 5.0  # after which workers that have joined meanwhile get work
_WITHOUT_WORKERS_S = 120.0
_AHEAD = 2  # batches for each thread: one at work, one waiting
_ROUNDS = 4  # of batches for each thread in a small sweep, so that all threads end at about the same time


def sweep(
    plan: Plan,
    folder: Path,
    cluster: AbstractContextManager[Client],
    recorded: tuple[str, ...] | None = None,
    restart: bool = False,
    progress: Callable[[int], object] = lambda done: None,
) -> Path:
    """Run the samples that are missing in a folder, and write the table; gives its path.

    cluster: `cluster.local` or `cluster.remote`, entered if a sample is missing
    recorded: signals to record of each sample; empty for all, None for no recordings
    restart: discard what an earlier sweep of that name has left
    progress: called with how many more samples are done, at first with those of an earlier start
    Raises SweepError if the folder holds another sweep, or if the cluster is lost or cannot run samples at
    all. A sample that fails is a row, and raises nothing.
    """
    store = Store(folder, schema(plan), provenance(plan, recorded))
    if restart:
        store.discard()
    finished = store.begin()
    progress(len(finished))
    missing = [sample for sample in range(plan.count) if sample not in finished]
    if missing:
        with cluster as client:
            _run(plan, job(plan, recorded), client, store, missing, progress)
    store.finish()
    return store.path


def _run(
    plan: Plan,
    shared_job: Job,
    client: Client,
    store: Store,
    missing: list[int],
    progress: Callable[[int], object],
) -> None:
    name = f"l1-depth-sweep-{uuid.uuid4()}"  # others may sweep on the same cluster
    client.register_plugin(SamplePlugin(name, shared_job))
    try:
        _Dispatch(plan, client, store, name, missing, progress).work()
    finally:
        if client.status == "running":
            client.unregister_worker_plugin(name)


class _Dispatch:
    """The batches that the cluster runs.

    A batch whose workers ended is run again sample by sample; a sample whose workers end again is a row
    with that error.
    """

    def __init__(
        self,
        plan: Plan,
        client: Client,
        store: Store,
        plugin: str,
        missing: list[int],
        progress: Callable[[int], object],
    ) -> None:
        self._plan, self._client, self._store = plan, client, store
        self._plugin, self._progress = plugin, progress
        self._waiting = deque(missing)
        self._suspects: deque[int] = deque()  # to be run one by one
        self._batches: dict[Future, list[int]] = {}
        self._last_time_with_workers = time.monotonic()

    def work(self) -> None:
        try:
            self._fill()
            while self._batches:
                for future in self._ended():
                    self._handle(future, self._batches.pop(future))
                self._fill()
        finally:
            self._client.cancel(list(self._batches))

    def _ended(self) -> list[Future]:
        """Batches that have ended, in whatever state."""
        with suppress(TimeoutError, CancelledError):
            wait(list(self._batches), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
        return [future for future in self._batches if future.status != "pending"]

    def _fill(self) -> None:
        threads = self._threads()
        while len(self._batches) < _AHEAD * threads and (self._waiting or self._suspects):
            if self._waiting:
                fair = -(-len(self._waiting) // (_ROUNDS * threads))
                numbers = [self._waiting.popleft() for _ in range(min(fair, _LARGEST_BATCH))]
            else:
                numbers = [self._suspects.popleft()]
            samples = [(number, self._plan.settings(self._plan.values(number))) for number in numbers]
            future = self._client.submit(run_batch, self._plugin, samples, _BUDGET_S, pure=False)
            self._batches[future] = numbers

    def _threads(self) -> int:
        """Of all workers; workers that are replaced may be none for a while."""
        threads_by_worker: dict[str, int] = self._client.nthreads()  # type: ignore[assignment]
        if threads_by_worker:
            self._last_time_with_workers = time.monotonic()
        elif time.monotonic() - self._last_time_with_workers > _WITHOUT_WORKERS_S:
            raise SweepError(
                f"the cluster has had no workers for {_WITHOUT_WORKERS_S:g} s; what is done is kept"
            )
        return max(sum(threads_by_worker.values()), 1)

    def _handle(self, future: Future, numbers: list[int]) -> None:
        if future.status == "finished":
            outcomes = future.result()
            self._store_outcomes(outcomes)
            self._waiting.extendleft(reversed(numbers[len(outcomes) :]))
        elif future.status == "lost":  # its worker died when it was done, before its rows were fetched
            self._waiting.extendleft(reversed(numbers))
        elif future.status != "error":
            raise SweepError("the Dask scheduler was lost; what is done is kept")
        elif not isinstance(future.exception(), KilledWorker):
            raise SweepError(f"a worker cannot run samples: {future.exception()}")
        elif len(numbers) > 1:
            self._suspects.extend(numbers)
        else:
            self._store_outcomes([(numbers[0], Outcome({}, error="every worker that ran it died"))])

    def _store_outcomes(self, outcomes: list[tuple[int, Outcome]]) -> None:
        rows = [
            {SAMPLE: number, **self._plan.values(number), **outcome.metrics, ERROR: outcome.error}
            for number, outcome in outcomes
        ]
        recordings = {number: outcome.recording for number, outcome in outcomes if outcome.recording}
        self._store.add(rows, recordings)
        self._progress(len(outcomes))
