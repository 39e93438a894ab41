"""Runs on this machine: threads with vectors or simulators, or a process beside each thread."""

import time
import warnings
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory

from fmus.fmi.description import describe, is_independent
from orchestration.errors import EnsembleError, FmuWarning
from orchestration.many.batches import Batches, Finished, Run
from orchestration.many.ensemble_checks import check_ensemble
from orchestration.many.isolated import Isolated
from orchestration.many.job import Job
from orchestration.many.lane_library import LANES
from orchestration.many.runners import Runner, Simulated, Vectorised

_BATCH_BYTES = 2**24  # of recorded values, if a group of vectors has less
_Batch = tuple[list[Finished], Sequence[Run], float]  # what is done, what is left, and seconds


def local(
    workers: int,
    isolate: bool = False,
    vectorise: bool | None = None,
    note: Callable[[str], object] = lambda text: None,
) -> AbstractContextManager[Callable[[Job], "LocalRuns"]]:
    """This machine as a place of the runs of a job, as `cluster.remote` is one; arguments: of `LocalRuns`."""
    return nullcontext(lambda job: LocalRuns(job, workers, isolate, vectorise, note))


class LocalRuns:
    """So many threads that make the runs of a job.

    isolate: whether FMUs run in a process beside each thread in any case. They do if one of them is not known
    to leave the others alone (`is_independent`), or if runs have a timeout: a thread cannot be ended
    vectorise: whether runs step together in vectors, with the same results: by default where they can and it
    pays; True raises EnsembleError where they cannot. Not with processes
    note: called with what makes the runs; clock: gives the time [s]
    """

    def __init__(
        self,
        job: Job,
        workers: int,
        isolate: bool = False,
        vectorise: bool | None = None,
        note: Callable[[str], object] = lambda text: None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._job, self._workers, self._isolate, self._vectorise = job, workers, isolate, vectorise
        self._note, self._clock = note, clock
        self._limits: tuple[int, ...] = ()  # of batches: runs of a group, and of a batch

    def runs(self, batches: Batches) -> Generator[list[Finished], None, None]:
        """Yields the runs as they are finished; see `Place`."""
        with self._runners(batches.left) as runners:
            idle: SimpleQueue[Runner] = SimpleQueue()
            for runner in runners:
                idle.put(runner)

            def make(batch: list[Run]) -> _Batch:
                runner = idle.get()
                try:
                    return self._made(runner, batch)
                finally:
                    idle.put(runner)

            with ThreadPoolExecutor(self._workers) as threads:
                try:
                    running: set[Future[_Batch]] = set()
                    while True:
                        while len(running) < self._workers and (
                            batch := batches.take(self._workers, *self._limits)
                        ):
                            running.add(threads.submit(make, batch))
                        if not running:
                            break
                        ended, running = wait(running, return_when=FIRST_COMPLETED)
                        for future in ended:
                            finished, rest, seconds = future.result()
                            batches.note(len(finished), seconds, rest)
                            yield finished
                finally:
                    for runner in runners:
                        runner.close()

    def _made(self, runner: Runner, batch: list[Run]) -> _Batch:
        start = self._clock()
        made = runner.run([run.experiment for run in batch])
        finished = [Finished(run.key, done) for run, done in zip(batch, made, strict=False)]
        return finished, batch[len(made) :], self._clock() - start

    @contextmanager
    def _runners(self, count: int) -> Iterator[Sequence[Runner]]:
        """One for each thread; their FMUs are freed at the end.

        They load copies of the FMUs, also after failures: one that is built anew meanwhile changes no run.
        """
        with ExitStack() as stack:
            folder = Path(
                stack.enter_context(TemporaryDirectory(prefix="l1-depth-runs-", ignore_cleanup_errors=True))
            )
            job = self._job.with_packed_fmus().with_unpacked_fmus(folder)
            vectors, reason = self._vectors(job, count)
            independent = all(is_independent(describe(path)) for path in job.system.components.values())
            if independent and not (job.timeout or self._isolate):
                stack.enter_context(warnings.catch_warnings())
                warnings.simplefilter("ignore", FmuWarning)  # of thousands of runs; `Done` names the FMUs
                in_process = vectors or [Simulated(job, self._clock) for _ in range(self._workers)]
                self._note(f"{self._workers} threads of {'ensembles' if vectors else 'simulators'}{reason}")
                yield [stack.enter_context(runner) for runner in in_process]
                return
            self._note(f"{self._workers} processes of simulators{reason}")
            yield [Isolated(job, folder) for _ in range(self._workers)]

    def _vectors(self, job: Job, count: int) -> tuple[list[Vectorised], str]:
        """Returns one for each thread, or none and the reason."""
        if self._vectorise is False or self._isolate:
            return [], ""
        try:
            if job.not_in_vectors or job.timeout:
                raise EnsembleError(job.not_in_vectors or "runs of an ensemble have no timeout")
            is_asked_for = bool(self._vectorise)
            group_bytes = check_ensemble(job.system, job.base, count, is_asked_for, threads=self._workers)
            self._limits = LANES, LANES * max(1, _BATCH_BYTES // group_bytes)
            return [Vectorised(job, is_asked_for) for _ in range(self._workers)], ""
        except EnsembleError as reason:
            if self._vectorise:
                raise
            return [], f": {reason}"
