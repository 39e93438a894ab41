"""Workers on this machine: threads of this process, or a process beside each."""

import time
import warnings
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory

from orchestration.errors import FmuWarning
from orchestration.fmi.description import describe, is_independent
from orchestration.sweep.isolated import IsolatedSamples
from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import Job, Samples, run_batch
from orchestration.sweep.workers import Batches, Finished

Runner = Samples | IsolatedSamples


class LocalWorkers:
    """So many threads, each with a system of its own.

    isolated: whether FMUs run in a process beside each thread in any case. They do if one of them is not
    known to leave the others alone (`is_independent`), or if samples have a timeout: a thread cannot be ended
    clock: gives the time [s] that ends a batch
    """

    def __init__(
        self, workers: int, isolated: bool = False, clock: Callable[[], float] = time.perf_counter
    ) -> None:
        self._workers, self._isolated, self._clock = workers, isolated, clock

    def run(self, plan: Plan, job: Job, missing: Batches) -> Generator[Finished, None, None]:
        """The samples as they are finished; see `Workers`."""
        with self._runners(job) as runners:
            idle: SimpleQueue[Runner] = SimpleQueue()
            for runner in runners:
                idle.put(runner)

            def run(numbers: list[int]) -> tuple[Finished, list[int], float]:
                runner = idle.get()
                try:
                    values = plan.block(numbers)
                    outcomes, seconds = run_batch(runner.run, map(plan.settings, values), self._clock)
                finally:
                    idle.put(runner)
                count = len(outcomes)
                return Finished(numbers[:count], values[:count], outcomes), numbers[count:], seconds

            with ThreadPoolExecutor(self._workers) as threads:
                try:
                    running: set[Future[tuple[Finished, list[int], float]]] = set()
                    while True:
                        while len(running) < self._workers and (batch := missing.take(self._workers)):
                            running.add(threads.submit(run, batch))
                        if not running:
                            break
                        done, running = wait(running, return_when=FIRST_COMPLETED)
                        for future in done:
                            finished, rest, seconds = future.result()
                            missing.note(len(finished.numbers), seconds, rest)
                            yield finished
                finally:
                    for runner in runners:
                        runner.close()

    @contextmanager
    def _runners(self, job: Job) -> Iterator[list[Runner]]:
        """One for each thread; their FMUs are freed at the end.

        They load copies of the FMUs, also after failures: one that is built anew meanwhile changes no sample.
        """
        with ExitStack() as stack:
            folder = Path(
                stack.enter_context(TemporaryDirectory(prefix="l1-depth-sweep-", ignore_cleanup_errors=True))
            )
            job = job.with_packed_fmus().with_unpacked_fmus(folder)
            independent = all(is_independent(describe(path)) for path in job.system.components.values())
            if independent and not (job.timeout or self._isolated):
                stack.enter_context(warnings.catch_warnings())
                warnings.simplefilter("ignore", FmuWarning)  # of thousands of samples; rows have the errors
                yield [stack.enter_context(Samples(job)) for _ in range(self._workers)]
                return
            yield [IsolatedSamples(job, folder) for _ in range(self._workers)]


@contextmanager
def local(workers: int, isolated: bool = False) -> Iterator[LocalWorkers]:
    """Workers of this machine, `LocalWorkers`."""
    yield LocalWorkers(workers, isolated)
