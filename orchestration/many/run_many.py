"""Many runs of one system, wherever they are made."""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, closing
from itertools import chain
from typing import Any

from fmus.platforms import usable_processors
from orchestration.many.batches import Batches, Place
from orchestration.many.job import Done, Job, Reduce, Run
from orchestration.many.local import LocalRuns
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

Make = Callable[[Job, Sequence[Run]], Iterator[Done]]
"""Makes the runs of a job, in their order: `in_order` in a place."""


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
    Raises what `simulate` raises before a run, for the first experiment; EnsembleError with `vectorise=True`
    where vectors cannot be used.
    """
    reduce, all_experiments = reduce or _recordings, list(experiments)
    if not all_experiments:
        return
    job = Job(system, all_experiments[0], timeout)
    runs = [Run(i, experiment, reduce) for i, experiment in enumerate(all_experiments)]
    with _place(cluster, workers or usable_processors(), isolate, vectorise) as place:
        for done in in_order(place, job, runs):
            yield done.result


def _place(
    cluster: str, workers: int, isolate: bool, vectorise: bool | None
) -> AbstractContextManager[Place]:
    if cluster:
        from orchestration.many.cluster import remote  # Dask is slow to import

        return remote(cluster)
    return LocalRuns(workers, isolate, vectorise)


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


def _recordings(runs: Recording) -> list[Recording]:
    return [runs.run(i) for i in range(len(runs.values))]
