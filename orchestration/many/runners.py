"""Runs in this process, with FMUs that stay loaded: one after another, or several at once in vectors."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import fields, replace
from time import perf_counter, thread_time
from typing import Any, Protocol

from orchestration.errors import EnsembleError, OrchestrationError
from orchestration.many.ensemble import Ensemble
from orchestration.many.job import ENTRIES, Done, Failure, Job
from orchestration.results.recording import Recording
from orchestration.run.simulator import Simulator
from orchestration.system.experiment import Experiment

BATCH_S = 0.25
"""Time [s] after which a batch of runs ends, whatever is left of it."""


class ClosedError(OrchestrationError):
    """A runner was closed during a run, which another runner has to make."""


class Runner(Protocol):
    """Makes runs; `close` ends one from another thread."""

    def run(self, experiments: Sequence[Experiment]) -> list[Done]:
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

    def run(self, experiments: Sequence[Experiment]) -> list[Done]:
        """Returns the runs that begin within `BATCH_S`."""
        end, done = self._clock() + BATCH_S, list[Done]()
        for experiment in experiments:
            done.append(self.run_one(experiment))
            if self._clock() >= end:
                break
        return done

    def run_one(self, experiment: Experiment) -> Done:
        """Returns one run."""
        start = thread_time()
        try:
            simulator = self.load()
            recording = simulator.run(experiment, self._check_open)
            self._check_open()  # closed in the second run of an error estimate, it has none
            seconds = thread_time() - start
            (result,) = self._job.reduce(replace(recording, values=recording.values[None]))
            return Done(result, tuple(simulator.warned), seconds)
        except Exception as error:  # whatever the reason, the others go on
            self._simulator = self._loaded.close()
            self._check_open()
            return Done(Failure(self._job.error_line(error)))

    def close(self) -> None:
        """End a run of another thread soon."""
        self._closed = True

    def __exit__(self, *_: object) -> None:
        self._loaded.close()

    def _check_open(self, *_: int) -> None:
        if self._closed:
            raise ClosedError("closed during a run")


class Vectorised(AbstractContextManager["Vectorised"]):
    """Makes runs at once as instances of an ensemble; their results are those of `Simulated`.

    A run that fails is made alone, by a simulator that may try shorter steps; so is one that has no result of
    `reduce`, for its reason.
    is_asked_for: whether experiments that an ensemble cannot run raise EnsembleError; otherwise they are
    simulated one after another
    """

    def __init__(self, job: Job, is_asked_for: bool = False) -> None:
        self._job, self._is_asked_for = job, is_asked_for
        self._ensemble, self._alone = Ensemble(job.system), Simulated(job)

    def run(self, experiments: Sequence[Experiment]) -> list[Done]:
        """Returns all runs."""
        together = dict[int, Done]()
        try:
            if len(experiments) > 1:
                recorded = self._ensemble.run(experiments[0], _varied(experiments))
                if recorded.complete:
                    results = self._reduced(recorded.recordings())
                    together = {
                        i: Done(r) for i, r in zip(recorded.complete, results, strict=True) if r is not None
                    }
        except EnsembleError:
            if self._is_asked_for:
                raise
        except OrchestrationError:  # of values that no instance can have
            pass
        return [
            together[i] if i in together else self._alone.run_one(experiment)
            for i, experiment in enumerate(experiments)
        ]

    def _reduced(self, runs: Recording) -> Sequence[Any]:
        """Returns the result of each run, None where there is none."""
        try:
            return self._job.reduce(runs)
        except Exception:  # of one of them
            count = len(runs.values)
            if count == 1:
                return [None]
            alone = (replace(runs, values=runs.values[i : i + 1]) for i in range(count))
            return [self._reduced(run)[0] for run in alone]

    def close(self) -> None:
        """End a run of a simulator soon."""
        self._alone.close()

    def __exit__(self, *error: object) -> None:
        self._ensemble.__exit__(*error)
        self._alone.__exit__(*error)


def _varied(experiments: Sequence[Experiment]) -> dict[str, list[Any]]:
    """Returns name -> value in each experiment, but where all have the same object.

    Raises EnsembleError for experiments that are equal, or that differ in more than values.
    """
    first = experiments[0]
    for field in fields(Experiment):
        values = [getattr(experiment, field.name) for experiment in experiments]
        if field.name in ENTRIES:
            is_same = all(value.keys() == values[0].keys() for value in values)
        else:
            is_same = all(value is values[0] or value == values[0] for value in values)
        if not is_same:
            raise EnsembleError(
                f"experiments differ in {field.name}: expected parameters, inputs and signals"
            )
    columns = {
        name: [getattr(experiment, entries)[name] for experiment in experiments]
        for entries in ENTRIES
        for name in getattr(first, entries)
    }
    varied = {name: column for name, column in columns.items() if any(v is not column[0] for v in column)}
    if not varied:
        raise EnsembleError("the experiments are equal")
    return varied
