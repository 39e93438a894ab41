"""Many runs of one system, wherever they are made."""

from collections.abc import Iterable, Iterator
from contextlib import closing
from itertools import chain
from typing import Any

from fmus.platforms import usable_processors
from orchestration.many.batches import Batches, Run
from orchestration.many.job import Job, Reduce
from orchestration.many.local import LocalRuns
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.system import System


def run_many(
    system: System,
    experiments: Iterable[Experiment],
    *,
    reduce: Reduce | None = None,
    workers: int | None = None,
    isolate: bool = False,
    vectorise: bool | None = None,
    timeout: float | None = None,
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
    Raises what `simulate` raises before a run, for the first experiment; EnsembleError with `vectorise=True`
    where vectors cannot be used.
    """
    all_experiments = list(experiments)
    if not all_experiments:
        return
    job = Job(system, all_experiments[0], reduce or _recordings, timeout)
    place = LocalRuns(job, workers or usable_processors(), isolate, vectorise)
    runs = (Run(i, experiment) for i, experiment in enumerate(all_experiments))
    early: dict[int, Any] = {}
    following = 0
    with closing(place.runs(Batches(runs, len(all_experiments)))) as batches:
        for finished in chain.from_iterable(batches):
            early[finished.key] = finished.done.result
            while following in early:
                yield early.pop(following)
                following += 1


def _recordings(runs: Recording) -> list[Recording]:
    return [runs.run(i) for i in range(len(runs.values))]
