"""Runs in this process, with FMUs that stay loaded: one after another, or several at once in vectors."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from itertools import groupby
from time import perf_counter, thread_time
from typing import Any, Protocol

from orchestration.errors import EnsembleError, OrchestrationError
from orchestration.many.ensemble import Ensemble, check_ensemble, shape
from orchestration.many.job import BATCH_S, Done, Failure, Job, Run
from orchestration.many.lane_library import LANES
from orchestration.results.recording import Recording
from orchestration.run.simulator import Simulator

_BATCH_BYTES = 2**24  # of recorded values, if a group of vectors has less


class ClosedError(OrchestrationError):
    """A runner was closed during a run, which another runner has to make."""


class Runner(Protocol):
    """Makes runs; `close` ends one from another thread."""

    def run(self, runs: Sequence[Run]) -> list[Done]:
        """Returns the first of the runs, at least one; ClosedError if the runner was closed meanwhile."""
        ...

    def close(self) -> None: ...


class Simulated(AbstractContextManager["Simulated"]):
    """Makes runs one after another; the FMUs are loaded anew after one that failed.

    clock: gives the time [s] that ends a batch
    """

    def __init__(self, job: Job, clock: Callable[[], float] = perf_counter) -> None:
        self._job, self._clock = job, clock
        self._loaded = ExitStack()  # holds a simulator, until a run fails
        self._simulator: Simulator | None = None
        self._closed = False

    def load(self) -> Simulator:
        """Returns the simulator; OrchestrationError for FMUs that cannot be loaded."""
        if not self._simulator:
            self._simulator = self._loaded.enter_context(Simulator(self._job.system, threads=1))
        return self._simulator

    def run(self, runs: Sequence[Run]) -> list[Done]:
        """Returns the runs that begin within `BATCH_S`."""
        end, done = self._clock() + BATCH_S, list[Done]()
        for run in runs:
            done.append(self.run_one(run))
            if self._clock() >= end:
                break
        return done

    def run_one(self, run: Run) -> Done:
        """Returns one run."""
        start = thread_time()
        try:
            simulator = self.load()
            recording = simulator.run(run.experiment, self._check_open)
            self._check_open()  # closed in the second run of an error estimate, it has none
            seconds = thread_time() - start
            (result,) = run.reduce(replace(recording, values=recording.values[None]))
            return Done(result, tuple(simulator.warned), seconds)
        except Exception as error:  # whatever the reason, the others go on
            self._simulator = self._loaded.close()
            self._check_open()
            return Done(Failure(self._job.error_line(error)))

    def close(self) -> None:
        """Ends a run of another thread soon."""
        self._closed = True

    def __exit__(self, *_: object) -> None:
        self._loaded.close()

    def _check_open(self, *_: int) -> None:
        if self._closed:
            raise ClosedError("closed during a run")


def vector_limits(
    job: Job, count: int, workers: int, vectorise: bool | None = None
) -> tuple[tuple[int, ...], str]:
    """Decides whether runs step together in vectors, and compiles these.

    count: of the runs; workers: how many make them side by side
    vectorise: by default where they can and it pays; True raises EnsembleError where they cannot
    Returns how many runs a group of vectors has, and a batch at most; or nothing, and the reason.
    """
    if vectorise is False:
        return (), ""
    try:
        if job.not_in_vectors:
            raise EnsembleError(job.not_in_vectors)
        group_bytes = check_ensemble(job.system, job.base, count, bool(vectorise), threads=workers)
        Ensemble(job.system).close()
        return (LANES, LANES * max(1, _BATCH_BYTES // group_bytes)), ""
    except EnsembleError as reason:
        if vectorise:
            raise
        return (), f": {reason}"


class Vectorised(AbstractContextManager["Vectorised"]):
    """Makes runs at once as instances of an ensemble; their results are those of `Simulated`.

    Those of one shape in a row step together: they differ in values of the same parameters, inputs and
    signals. A run that fails is made alone, by a simulator that may try shorter steps; so is one that has no
    result of its `reduce`, for its reason.
    is_asked_for: whether experiments that an ensemble cannot run raise EnsembleError; otherwise they are
    simulated one after another
    """

    def __init__(self, job: Job, is_asked_for: bool = False) -> None:
        self._is_asked_for = is_asked_for
        self._ensemble, self._alone = Ensemble(job.system), Simulated(job)

    def run(self, runs: Sequence[Run]) -> list[Done]:
        """Returns all runs."""
        groups = groupby(runs, lambda run: shape(run.experiment))
        return [done for _, group in groups for done in self._run_group([*group])]

    def _run_group(self, runs: Sequence[Run]) -> list[Done]:
        results = dict[int, Any]()
        if len(runs) > 1:
            try:
                recorded = self._ensemble.run([run.experiment for run in runs])
                if recorded.complete:
                    reduced = _reduced(recorded.recordings(), [runs[i] for i in recorded.complete])
                    results = dict(zip(recorded.complete, reduced, strict=True))
            except EnsembleError:
                if self._is_asked_for:
                    raise
            except OrchestrationError:  # of values that no instance can have
                pass
        return [
            self._alone.run_one(run) if results.get(i) is None else Done(results[i])
            for i, run in enumerate(runs)
        ]

    def close(self) -> None:
        """Ends a run of a simulator soon."""
        self._alone.close()

    def __exit__(self, *error: object) -> None:
        self._ensemble.__exit__(*error)
        self._alone.__exit__(*error)


def _reduced(recording: Recording, runs: Sequence[Run]) -> list[Any]:
    """Returns the result of each run of a recording, None where there is none."""
    results, first = list[Any](), 0
    for reduce, group in groupby(runs, key=lambda run: run.reduce):
        count = len([*group])
        part = replace(recording, values=recording.values[first : first + count])
        try:
            results += reduce(part)
        except Exception:  # of one of them; each is made alone
            results += [None] * count
        first += count
    return results
