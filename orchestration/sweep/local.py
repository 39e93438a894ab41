"""Workers on this machine: threads of this process, or a process beside each."""

import time
import warnings
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack, contextmanager
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory

from fmus.lanes import LANES
from orchestration.errors import EnsembleError, FmuWarning
from orchestration.fmi.description import describe, is_independent
from orchestration.sweep.ensemble import EnsembleSamples, ensemble_samples
from orchestration.sweep.isolated import IsolatedSamples
from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import Job, Samples, run_batch
from orchestration.sweep.workers import Batches, Finished

Runner = Samples | IsolatedSamples | EnsembleSamples
_Batch = tuple[Finished, list[int], float]  # what is done, what is left, and seconds


class LocalWorkers:
    """So many threads, each with a system of its own, or with ensembles of it.

    isolated: whether FMUs run in a process beside each thread in any case. They do if one of them is not
    known to leave the others alone (`is_independent`), or if samples have a timeout: a thread cannot be ended
    ensemble: whether samples step together, with the same rows: by default where they can and it pays; True
    raises EnsembleError where they cannot. Not of isolated ones
    note: called with what runs the samples
    clock: gives the time [s] that ends a batch
    """

    def __init__(
        self,
        workers: int,
        isolated: bool = False,
        ensemble: bool | None = None,
        note: Callable[[str], object] = lambda text: None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._workers, self._isolated, self._ensemble = workers, isolated, ensemble
        self._note, self._clock = note, clock

    def run(self, plan: Plan, job: Job, missing: Batches) -> Generator[Finished, None, None]:
        """The samples as they are finished; see `Workers`."""
        with self._runners(plan, job, missing.left) as runners:
            idle: SimpleQueue[Runner] = SimpleQueue()
            for runner in runners:
                idle.put(runner)

            def run(numbers: list[int]) -> _Batch:
                runner = idle.get()
                try:
                    return self._run(runner, plan, numbers)
                finally:
                    idle.put(runner)

            limits = (LANES, runners[0].most) if isinstance(runners[0], EnsembleSamples) else ()
            with ThreadPoolExecutor(self._workers) as threads:
                try:
                    running: set[Future[_Batch]] = set()
                    while True:
                        while len(running) < self._workers and (
                            batch := missing.take(self._workers, *limits)
                        ):
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

    def _run(self, runner: Runner, plan: Plan, numbers: list[int]) -> _Batch:
        """Samples by one of the runners."""
        start, values = self._clock(), plan.block(numbers)
        if isinstance(runner, EnsembleSamples):
            return Finished(numbers, values, runner.run(values)), [], self._clock() - start
        outcomes, seconds = run_batch(runner.run, map(plan.settings, values), self._clock)
        count = len(outcomes)
        return Finished(numbers[:count], values[:count], outcomes), numbers[count:], seconds

    @contextmanager
    def _runners(self, plan: Plan, job: Job, count: int) -> Iterator[list[Runner]]:
        """One for each thread; their FMUs are freed at the end.

        They load copies of the FMUs, also after failures: one that is built anew meanwhile changes no sample.
        """
        with ExitStack() as stack:
            folder = Path(
                stack.enter_context(TemporaryDirectory(prefix="l1-depth-sweep-", ignore_cleanup_errors=True))
            )
            job = job.with_packed_fmus().with_unpacked_fmus(folder)
            ensembles, reason = self._ensembles(plan, job, count)
            independent = all(is_independent(describe(path)) for path in job.system.components.values())
            if independent and not (job.timeout or self._isolated):
                stack.enter_context(warnings.catch_warnings())
                warnings.simplefilter("ignore", FmuWarning)  # of thousands of samples; rows have the errors
                runners = ensembles or [Samples(job) for _ in range(self._workers)]
                self._note(f"{self._workers} threads of {'ensembles' if ensembles else 'simulators'}{reason}")
                yield [stack.enter_context(runner) for runner in runners]
                return
            self._note(f"{self._workers} processes of simulators{reason}")
            yield [IsolatedSamples(job, folder) for _ in range(self._workers)]

    def _ensembles(self, plan: Plan, job: Job, count: int) -> tuple[list[EnsembleSamples], str]:
        """One for each thread, or none and the reason."""
        if self._ensemble is False or self._isolated:
            return [], ""
        try:
            return ensemble_samples(plan, job, count, bool(self._ensemble), self._workers), ""
        except EnsembleError as reason:
            if self._ensemble:
                raise
            return [], f": {reason}"


@contextmanager
def local(
    workers: int,
    isolated: bool = False,
    ensemble: bool | None = None,
    note: Callable[[str], object] = lambda text: None,
) -> Iterator[LocalWorkers]:
    """Workers of this machine, `LocalWorkers`."""
    yield LocalWorkers(workers, isolated, ensemble, note)
