"""Running a sweep: samples go to workers one by one, rows come back to the store."""

import time
import uuid
from collections import deque
from collections.abc import Callable
from concurrent.futures import CancelledError
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from fmus.extras import imports_of
from orchestration.errors import SweepError
from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import Job, Outcome
from orchestration.sweep.store import Store
from orchestration.sweep.table import ERROR, SAMPLE, schema
from orchestration.sweep.worker import SamplePlugin, run_sample

with imports_of("sweep", "a sweep"):
    from distributed import Client, Future, KilledWorker, wait

_LOOK_S = 5.0  # after which workers that have joined meanwhile get work
_WITHOUT_WORKERS_S = 120.0
_AHEAD = 4  # samples for each thread: one runs, the others wait


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
    Raises SweepError if the folder holds another sweep, if another process runs the same one, or if the
    cluster is lost or cannot run samples at all. A sample that fails is a row, and raises nothing.
    """
    with Store(folder, schema(plan, recorded)) as store:
        if restart:
            store.discard()
        finished = store.begin()
        progress(len(finished))
        missing = deque(sample for sample in range(plan.count) if sample not in finished)
        if missing:
            with cluster as client:
                plugin = SamplePlugin(f"l1-depth-sweep-{uuid.uuid4()}", Job.of(plan, recorded))
                client.register_plugin(plugin)
                try:
                    _Dispatch(plan, client, store, plugin.name, progress, missing).work()
                finally:
                    if client.status == "running":
                        client.unregister_worker_plugin(plugin.name)
        store.finish()
    return store.path


@dataclass
class _Dispatch:
    """The samples that the cluster runs.

    A sample whose workers ended is run again, alone; one whose workers end again is a row with that error.
    """

    plan: Plan
    client: Client
    store: Store
    plugin: str  # its name: others may sweep on the same cluster
    progress: Callable[[int], object]
    waiting: deque[int]
    suspects: deque[int] = field(default_factory=deque)
    alone: int | None = None
    running: dict[Future, int] = field(default_factory=dict)
    last_time_with_workers: float = field(default_factory=time.monotonic)

    def work(self) -> None:
        try:
            while self.waiting or self.suspects or self.running:
                self._fill()
                with suppress(TimeoutError, CancelledError):
                    wait(list(self.running), timeout=_LOOK_S, return_when="FIRST_COMPLETED")
                for future in [future for future in self.running if future.status != "pending"]:
                    self._handle(future, self.running.pop(future))
        finally:
            self.client.cancel(list(self.running))

    def _fill(self) -> None:
        threads = self._threads()
        while self.waiting and len(self.running) < _AHEAD * threads:
            self._submit(self.waiting.popleft())
        if self.suspects and not self.running:
            self.alone = self.suspects.popleft()
            self._submit(self.alone)

    def _submit(self, number: int) -> None:
        settings = self.plan.settings(self.plan.values(number))
        self.running[self.client.submit(run_sample, self.plugin, settings, pure=False)] = number

    def _threads(self) -> int:
        """Of all workers; workers that are replaced may be none for a while."""
        threads_by_worker: dict[str, int] = self.client.nthreads()  # type: ignore[assignment]
        if threads_by_worker:
            self.last_time_with_workers = time.monotonic()
        elif time.monotonic() - self.last_time_with_workers > _WITHOUT_WORKERS_S:
            raise SweepError(
                f"the cluster has had no workers for {_WITHOUT_WORKERS_S:g} s; what is done is kept"
            )
        return max(sum(threads_by_worker.values()), 1)

    def _handle(self, future: Future, number: int) -> None:
        if future.status == "finished":
            self._store(number, future.result())
        elif future.status == "lost":  # its worker died when it was done, before its row was fetched
            self.waiting.appendleft(number)
        elif future.status != "error":
            raise SweepError("the Dask scheduler was lost; what is done is kept")
        elif not isinstance(future.exception(), KilledWorker):
            raise SweepError(f"a worker cannot run samples: {future.exception()}")
        elif number == self.alone:
            self._store(number, Outcome({}, error="every worker that ran it died"))
        else:
            self.suspects.append(number)

    def _store(self, number: int, outcome: Outcome) -> None:
        row = {SAMPLE: number, **self.plan.values(number), **outcome.metrics, ERROR: outcome.error}
        self.store.add(row, outcome.recording)
        self.progress(1)
