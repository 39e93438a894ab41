"""Samples on the workers of a Dask cluster, which may join, leave and end while they run."""

import time
import uuid
from collections import deque
from collections.abc import Generator, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

from fmus.extras import imports_of
from orchestration.errors import SweepError
from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import Job, Outcome
from orchestration.sweep.worker import SamplePlugin, run_batch
from orchestration.sweep.workers import Batches, Finished

with imports_of("sweep", "a sweep on a cluster"):
    from distributed import Client, Future, KilledWorker, wait

LOOK_S = 5.0  # after which workers that have joined meanwhile get work
WITHOUT_WORKERS_S = 120.0
_AHEAD = 3  # batches for each thread: one runs, the others wait


class DaskWorkers:
    """The workers that a client reaches."""

    def __init__(self, client: Client) -> None:
        self.client = client

    def run(self, plan: Plan, job: Job, missing: Batches) -> Generator[Finished, None, None]:
        """The samples as they are finished; see `Workers`. SweepError if the cluster is lost."""
        plugin = SamplePlugin(f"l1-depth-sweep-{uuid.uuid4()}", job)
        self.client.register_plugin(plugin)
        try:
            yield from _Dispatch(plan, self.client, plugin.name, missing).work()
        finally:
            if self.client.status == "running":
                self.client.unregister_worker_plugin(plugin.name)


@dataclass(frozen=True)
class _Batch:
    """Samples of one task, with what is varied in each."""

    numbers: Sequence[int]
    values: Sequence[dict[str, Any]]

    def parts(self) -> list["_Batch"]:
        """A batch for each sample."""
        return [_Batch([n], [v]) for n, v in zip(self.numbers, self.values, strict=True)]


@dataclass
class _Dispatch:
    """The samples that the cluster runs.

    The samples of a batch whose workers ended are run again, each in a task of its own; then alone; one whose
    workers end again is a row with that error.
    """

    plan: Plan
    client: Client
    plugin: str  # its name: others may sweep on the same cluster
    missing: Batches
    again: deque[_Batch] = field(default_factory=deque)
    suspects: deque[_Batch] = field(default_factory=deque)
    alone: _Batch | None = None
    running: dict[Future, _Batch] = field(default_factory=dict)
    last_time_with_workers: float = field(default_factory=time.monotonic)

    def work(self) -> Iterator[Finished]:
        try:
            while self._fill():
                with suppress(TimeoutError, CancelledError):
                    wait(list(self.running), timeout=LOOK_S, return_when="FIRST_COMPLETED")
                for future in [future for future in self.running if future.status != "pending"]:
                    yield from self._handled(future, self.running.pop(future))
        finally:
            self.client.cancel(list(self.running))

    def _fill(self) -> bool:
        """Give every thread work; False if there is none and nothing runs."""
        threads = self._threads()
        while len(self.running) < _AHEAD * threads and (batch := self._next(threads)):
            self._submit(batch)
        if self.suspects and not self.running:
            self.alone = self.suspects.popleft()
            self._submit(self.alone)
        return bool(self.running)

    def _next(self, threads: int) -> _Batch | None:
        if self.again:
            return self.again.popleft()
        numbers = self.missing.take(_AHEAD * threads)
        return _Batch(numbers, self.plan.block(numbers)) if numbers else None

    def _submit(self, batch: _Batch) -> None:
        settings = [self.plan.settings(values) for values in batch.values]
        self.running[self.client.submit(run_batch, self.plugin, settings, pure=False)] = batch

    def _threads(self) -> int:
        """Of all workers; workers that are replaced may be none for a while."""
        threads_by_worker: dict[str, int] = self.client.nthreads()  # type: ignore[assignment]
        if threads_by_worker:
            self.last_time_with_workers = time.monotonic()
        elif time.monotonic() - self.last_time_with_workers > WITHOUT_WORKERS_S:
            raise SweepError(
                f"the cluster has had no workers for {WITHOUT_WORKERS_S:g} s; what is done is kept"
            )
        return max(sum(threads_by_worker.values()), 1)

    def _handled(self, future: Future, batch: _Batch) -> Iterator[Finished]:
        if future.status == "finished":
            outcomes, seconds = future.result()
            count = len(outcomes)
            self.missing.note(count, seconds, batch.numbers[count:])
            yield Finished(batch.numbers[:count], batch.values[:count], outcomes)
        elif future.status == "lost":  # its worker ended when it was done, before its rows were fetched
            self.again.append(batch)
        elif future.status != "error":
            raise SweepError("the Dask scheduler was lost; what is done is kept")
        elif not isinstance(future.exception(), KilledWorker):
            raise SweepError(f"a worker cannot run samples: {future.exception()}")
        elif batch is self.alone:
            yield Finished(batch.numbers, batch.values, [Outcome({}, error="every worker that ran it ended")])
        else:
            (self.again if len(batch.numbers) > 1 else self.suspects).extend(batch.parts())
