"""What a Dask worker needs to run samples, and how it runs a batch of them.

The job, FMUs included, is a plugin of the workers: the scheduler keeps it and gives it to every worker,
also to those that join later or replace a dead one. Each unpacks it once, in its own local folder.
"""

import signal
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from distributed import Reschedule, WorkerPlugin, get_worker

from orchestration.sweep.isolated import ClosedError, IsolatedSamples
from orchestration.sweep.job import Job, Outcome, Settings


class Laboratory(WorkerPlugin):
    """Runs samples on a worker, one process of FMUs for each of its threads."""

    def __init__(self, name: str, job: Job) -> None:
        self.name = name
        self._job = job

    def setup(self, worker: Any) -> None:
        self._folder = TemporaryDirectory(
            dir=worker.local_directory, prefix="sweep-", ignore_cleanup_errors=True
        )
        self._unpacked = self._job.unpacked(Path(self._folder.name))
        self._idle: list[IsolatedSamples] = []
        self._all: list[IsolatedSamples] = []

    def teardown(self, worker: Any) -> None:
        for each in self._all:
            each.close()
        self._folder.cleanup()

    def run(self, samples: list[tuple[int, Settings]], budget: float) -> list[tuple[int, Outcome]]:
        """As many of the samples, in their order, as end within `budget` seconds, but one at least."""
        place = self._idle.pop() if self._idle else self._new()
        begin, done = time.monotonic(), []
        for number, settings in samples:
            try:
                done.append((number, place.run(settings)))
            except ClosedError:  # this worker leaves the cluster
                raise Reschedule from None
            if time.monotonic() - begin > budget:
                break
        self._idle.append(place)
        return done

    def _new(self) -> IsolatedSamples:
        place = IsolatedSamples(self._unpacked, Path(self._folder.name))
        self._all.append(place)
        return place


class DeafToInterrupts(WorkerPlugin):
    """For workers at the same terminal as who started them: Ctrl-C is not for them."""

    name = "deaf-to-interrupts"

    def setup(self, worker: Any) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def run_batch(
    laboratory: str, samples: list[tuple[int, Settings]], budget: float
) -> list[tuple[int, Outcome]]:
    """`Laboratory.run` of the worker that this is called on."""
    found: Any = get_worker().plugins[laboratory]
    return found.run(samples, budget)
