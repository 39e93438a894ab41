"""Runs on this machine: in threads with vectors or simulators, or in a process beside each thread."""

import warnings
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from time import perf_counter

from fmus.fmi.description import describe, is_independent
from orchestration.errors import FmuWarning
from orchestration.many.ensemble_loop import Device
from orchestration.many.job import Batches, ClosedError, Finished, Job, Run
from orchestration.many.lane_library import LANES
from orchestration.many.runners import Isolated, Runner, Simulated, Vectorised, vector_limits

_Batch = tuple[list[Finished], Sequence[Run], float]  # finished runs, runs that are left, and seconds


class LocalRuns(AbstractContextManager["LocalRuns"]):
    """A place of runs: so many threads, whose FMUs stay loaded and processes stay open from job to like job.

    isolate: whether FMUs run in a process beside each thread in any case. They do if one of them is not known
    to leave the others alone (`is_independent`), or if runs have a timeout: a thread cannot be ended
    vectorise: whether runs step together in vectors, with the same results: by default where they can and it
    pays; True raises EnsembleError where they cannot
    note: called with what makes the runs
    expected: runs that will follow, of which it depends whether vectors pay; by default those at hand
    device: for runs in vectors there, in one process and without a timeout; EnsembleError where they cannot
    be made there
    """

    def __init__(
        self,
        workers: int,
        isolate: bool = False,
        vectorise: bool | None = None,
        note: Callable[[str], object] = lambda text: None,
        expected: int = 0,
        device: Device | None = None,
    ) -> None:
        self.device = device
        self._workers, self._isolate = workers, isolate
        self._vectorise = True if self.device else vectorise
        self._note, self._expected = note, expected
        self._job: Job | None = None  # for which the runners are open
        self._loaded = ExitStack()  # holds its FMUs
        self._limits: tuple[int, ...] = ()  # of batches: runs of a group, and of a batch
        self._in_process: Sequence[Simulated | Vectorised] = ()
        self._isolated: Sequence[Isolated] = ()
        self._threads = ThreadPoolExecutor(workers)
        self._closed = False

    def runs(self, job: Job, batches: Batches) -> Generator[list[Finished], None, None]:
        """Yields the runs as they are finished; see `Place`."""
        idle: SimpleQueue[Runner] = SimpleQueue()
        for runner in self._runners(job, batches.left):
            idle.put(runner)
        if self._closed:
            raise ClosedError("closed before a run")

        def make(batch: list[Run]) -> _Batch:
            runner = idle.get()
            try:
                return self._made(runner, batch)
            finally:
                idle.put(runner)

        running: set[Future[_Batch]] = set()
        with warnings.catch_warnings() if self._in_process else nullcontext():
            if self._in_process:
                warnings.simplefilter("ignore", FmuWarning)  # of thousands of runs; `Done` names the FMUs
            try:
                while True:
                    while len(running) < self._workers and (
                        batch := batches.take(self._workers, *self._limits)
                    ):
                        running.add(self._threads.submit(make, batch))
                    if not running:
                        break
                    ended, running = wait(running, return_when=FIRST_COMPLETED)
                    for future in ended:
                        finished, rest, seconds = future.result()
                        batches.note(len(finished), seconds, rest)
                        yield finished
            except BaseException:
                if running:
                    self.end_runs()
                    wait(running)
                raise

    def _made(self, runner: Runner, batch: list[Run]) -> _Batch:
        start = perf_counter()
        made = runner.run(batch)
        finished = [Finished(run.key, done) for run, done in zip(batch, made, strict=False)]
        return finished, batch[len(made) :], perf_counter() - start

    def _runners(self, job: Job, count: int) -> Sequence[Runner]:
        """Returns one for each thread; those that are open if they are for such a job.

        They load copies of the FMUs, also after failures: one that is built anew meanwhile changes no run.
        """
        is_open = self._job is not None and job.is_like(self._job)
        if is_open and (self._limits or count < LANES):
            return self._in_process or self._isolated
        expected = max(count, self._expected)
        limits, reason = vector_limits(job, expected, self._workers, self._vectorise, self.device)
        if is_open and not limits:
            return self._in_process or self._isolated
        self._free()
        folder = self._loaded.enter_context(
            TemporaryDirectory(prefix="l1-depth-runs-", ignore_cleanup_errors=True)
        )
        self._job, self._limits = job, limits
        job = job.with_packed_fmus().with_unpacked_fmus(Path(folder))
        independent = all(is_independent(describe(path)) for path in job.system.components.values())
        if self.device:
            self._note(self.device.name)
            runner = Vectorised(job, True, self.device)
            self._in_process = (self._loaded.enter_context(runner),)
            return self._in_process
        how = "runs in ensembles" if limits else "runs one by one"
        if independent and not (job.timeout or self._isolate):
            self._note(f"{self._workers} threads, {how}{reason}")
            for _ in range(self._workers):
                runner = Vectorised(job, bool(self._vectorise)) if limits else Simulated(job)
                self._in_process = *self._in_process, self._loaded.enter_context(runner)
            return self._in_process
        self._note(f"{self._workers} processes, {how}{reason}")
        for isolated in self._isolated:
            isolated.use(job, bool(limits))
        self._isolated = self._isolated or [Isolated(job, None, bool(limits)) for _ in range(self._workers)]
        return self._isolated

    def end_runs(self) -> None:
        """Ends what runs, also from another thread; runs that follow are made by new runners."""
        self._job = None
        for runner in (*self._in_process, *self._isolated):
            runner.close()
        self._in_process = self._isolated = ()

    def _free(self) -> None:
        """Frees what was loaded for a job."""
        self._in_process = ()
        self._loaded.close()

    def close(self) -> None:
        """Ends what runs, also from another thread; no run follows."""
        self._closed = True
        self.end_runs()

    def __exit__(self, *_: object) -> None:
        self.close()
        self._threads.shutdown()
        self._free()
