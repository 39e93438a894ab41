"""Many runs of one system: the front, and the runs on this machine.

They run in threads with vectors or simulators, or in a process beside each thread.
"""

import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from itertools import chain
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

from fmus.fmi.description import describe, is_independent
from fmus.operating_system import usable_processors
from orchestration.errors import EnsembleError, FmuWarning
from orchestration.many.device import GPU, PROCESSOR, device_of
from orchestration.many.job import Batches, ClosedError, Done, Finished, Job, Place, Reduce, Run
from orchestration.many.lane_library import LANES
from orchestration.many.runners import Isolated, Runner, Simulated, Vectorised, vector_limits
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

Make = Callable[[Job, Sequence[Run]], Iterator[Done]]
"""Makes the runs of a job, in their order: `in_order` in a place."""
_Batch = tuple[list[Finished], Sequence[Run], float]  # what is done, what is left, and seconds


def run_many(
    system: System,
    experiments: Iterable[Experiment],
    *,
    reduce: Reduce | None = None,
    workers: int | None = None,
    isolate: bool = False,
    vectorise: bool | None = None,
    timeout: float | None = None,
    cluster: str = "",
    where: str = PROCESSOR,
) -> Iterator[Any]:
    """Yields the recording of each experiment, or a `Failure` with the reason, in the order given.

        experiments = [replace(experiment, parameters={"plant.mass": mass}) for mass in masses]
        for recording in run_many(system, experiments): ...

    reduce: computes a result in place of each recording where the run is made. It takes a recording of many
    runs, with a first axis of runs, and returns a result for each
    workers: runs at once, by default as many as there are processors
    isolate: whether the FMUs run in processes of their own in any case; those that are not known to leave
    others alone do, and all with a timeout
    vectorise: whether native FMUs of this exporter step together in vectors, with the same results; by
    default where they can and it pays
    timeout: longest time [s] of a run
    cluster: address of a Dask scheduler whose workers make the runs, such as tcp://host:8786; `workers`,
    `isolate` and `vectorise` are then its own affair
    where: "processor", or "gpu" for native FMUs of this exporter on the GPU of this machine, in one process
    and without a timeout
    Raises what `simulate` raises before a run, for the first experiment; EnsembleError with `vectorise=True`
    where vectors cannot be used, and with "gpu" where that cannot make the runs.
    """
    reduce, all_experiments = reduce or recordings_of, list(experiments)
    if not all_experiments:
        return
    job = Job(system, all_experiments[0], timeout)
    runs = [Run(i, experiment, reduce) for i, experiment in enumerate(all_experiments)]
    if where == GPU and (isolate or cluster or vectorise is False):
        raise EnsembleError("runs on a GPU: expected neither isolate, cluster nor vectorise=False")
    with _place(cluster, workers or usable_processors(), isolate, vectorise, where) as place:
        for done in in_order(place, job, runs):
            yield done.result


def _place(
    cluster: str, workers: int, isolate: bool, vectorise: bool | None, where: str
) -> AbstractContextManager[Place]:
    if cluster:
        from orchestration.many.cluster import remote  # Dask is slow to import

        return remote(cluster)
    return LocalRuns(workers, isolate, vectorise, where=where)


def in_order(place: Place, job: Job, runs: Sequence[Run]) -> Generator[Done, None, None]:
    """Yields the runs of a job in their order, made in a place that stays open; their keys do not matter."""
    numbered = (run._replace(key=i) for i, run in enumerate(runs))
    early, following = dict[int, Done](), 0
    with closing(place.runs(job, Batches(numbered, len(runs)))) as batches:
        for finished in chain.from_iterable(batches):
            early[finished.key] = finished.done
            while following in early:
                yield early.pop(following)
                following += 1


def recordings_of(runs: Recording) -> list[Recording]:
    """Returns the recording of each run, for `Run.reduce`."""
    return [runs.run(i) for i in range(len(runs.values))]


class LocalRuns(AbstractContextManager["LocalRuns"]):
    """A place of runs: so many threads, whose FMUs stay loaded and processes stay open from job to like job.

    isolate: whether FMUs run in a process beside each thread in any case. They do if one of them is not known
    to leave the others alone (`is_independent`), or if runs have a timeout: a thread cannot be ended
    vectorise: whether runs step together in vectors, with the same results: by default where they can and it
    pays; True raises EnsembleError where they cannot
    note: called with what makes the runs
    expected: runs that will follow, of which it depends whether vectors pay; by default those at hand
    where: "processor", or "gpu" for runs in vectors on the GPU of this machine, in one process and without a
    timeout; EnsembleError where they cannot be made there
    """

    def __init__(
        self,
        workers: int,
        isolate: bool = False,
        vectorise: bool | None = None,
        note: Callable[[str], object] = lambda text: None,
        expected: int = 0,
        where: str = PROCESSOR,
    ) -> None:
        self._device = device_of(where)
        self._workers, self._isolate = workers, isolate
        self._vectorise = True if self._device else vectorise
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
                    self._end_runs()
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
        limits, reason = vector_limits(job, expected, self._workers, self._vectorise, self._device)
        if is_open and not limits:
            return self._in_process or self._isolated
        self._free()
        folder = self._loaded.enter_context(
            TemporaryDirectory(prefix="l1-depth-runs-", ignore_cleanup_errors=True)
        )
        self._job, self._limits = job, limits
        job = job.with_packed_fmus().with_unpacked_fmus(Path(folder))
        independent = all(is_independent(describe(path)) for path in job.system.components.values())
        if self._device:
            self._note("the GPU")
            runner = Vectorised(job, True, self._device)
            self._in_process = (self._loaded.enter_context(runner),)
            return self._in_process
        makers = "ensembles" if limits else "simulators"
        if independent and not (job.timeout or self._isolate):
            self._note(f"{self._workers} threads of {makers}{reason}")
            for _ in range(self._workers):
                runner = Vectorised(job, bool(self._vectorise)) if limits else Simulated(job)
                self._in_process = *self._in_process, self._loaded.enter_context(runner)
            return self._in_process
        self._note(f"{self._workers} processes of {makers}{reason}")
        for isolated in self._isolated:
            isolated.use(job, bool(limits))
        self._isolated = self._isolated or [Isolated(job, None, bool(limits)) for _ in range(self._workers)]
        return self._isolated

    def _end_runs(self) -> None:
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
        self._end_runs()

    def __exit__(self, *_: object) -> None:
        self.close()
        self._threads.shutdown()
        self._free()
