"""What a Dask worker needs to run samples.

The job, FMUs included, is a plugin of the workers: the scheduler keeps it and gives it to every worker,
also to those that join later or replace one that has ended. Each unpacks it once, in its own local folder.
"""

from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from fmus.extras import imports_of
from orchestration.sweep.isolated import IsolatedSamples
from orchestration.sweep.samples import ClosedError, Job, Outcome
from orchestration.sweep.samples import run_batch as run_until_time
from orchestration.sweep.target import Settings

with imports_of("sweep", "a sweep"):
    from distributed import Reschedule, Worker, WorkerPlugin, get_worker


class SamplePlugin(WorkerPlugin):
    """Runs samples on a worker, one process of FMUs for each of its threads."""

    def __init__(self, name: str, job: Job) -> None:
        self.name = name
        self._job = job.with_packed_fmus()

    def setup(self, worker: Worker) -> None:
        self._folder = TemporaryDirectory(
            dir=worker.local_directory, prefix="sweep-", ignore_cleanup_errors=True
        )
        self._unpacked_job = self._job.with_unpacked_fmus(Path(self._folder.name))
        self._idle: list[IsolatedSamples] = []
        self._all: list[IsolatedSamples] = []

    def teardown(self, worker: Worker) -> None:
        for runner in self._all:
            runner.close()
        self._folder.cleanup()

    def run(self, settings: Sequence[Settings]) -> tuple[list[Outcome], float]:
        """`samples.run_batch` in a process that no other thread uses."""
        try:
            runner = self._idle.pop()
        except IndexError:  # not asked for before: another thread may take the last one meanwhile
            runner = IsolatedSamples(self._unpacked_job, Path(self._folder.name))
            self._all.append(runner)
        try:
            return run_until_time(runner.run, settings)
        except ClosedError:  # this worker leaves the cluster
            raise Reschedule from None
        finally:
            self._idle.append(runner)


def run_batch(plugin: str, settings: Sequence[Settings]) -> tuple[list[Outcome], float]:
    """`SamplePlugin.run` of the worker that this is called on."""
    installed = get_worker().plugins[plugin]
    assert isinstance(installed, SamplePlugin)
    return installed.run(settings)
