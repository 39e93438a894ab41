"""Many runs of one system, in any place, in their order."""

from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import closing
from itertools import chain
from typing import Any

from orchestration.many.job import Batches, Done, Job, Place, Reduce, Run
from orchestration.many.places import AUTO, place_of
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
    where: str = AUTO,
    workers: int | None = None,
    timeout: float | None = None,
) -> Iterator[Any]:
    """Yields the recording of each experiment, or a `Failure` with the reason, in the order given.

    Parameters
    ----------
    system : System
        The FMUs and their connections.
    experiments : iterable of Experiment
        The runs, in their order.
    reduce : callable, optional
        Computes results where the runs are made, so that no recording is kept: it receives a recording of
        many runs, with a first axis of runs, and returns one result for each.
    where : str
        "auto", "processor", "vectors", "processes", "gpu" or the address of a Dask scheduler.
    workers : int, optional
        Runs at once on this machine; by default one for each processor.
    timeout : float, optional
        Longest time of a run [s].

    Yields
    ------
    Recording or Failure
        One for each experiment; with `reduce` its result in place of the recording.

    Raises
    ------
    EnsembleError
        With "vectors" or "gpu", if these cannot make the runs; also the errors of `simulate` before a run,
        for the first experiment.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from orchestration import load_scenario
    >>> scenario = load_scenario("nominal-extended")
    >>> values = ({**scenario.experiment.parameters, "plant.inertia": kg} for kg in (5.0, 6.0))
    >>> experiments = [replace(scenario.experiment, parameters=given) for given in values]
    >>> [len(recording.time) for recording in run_many(scenario.system, experiments, workers=1)]
    [15501, 15501]
    """
    reduce, all_experiments = reduce or recordings_of, list(experiments)
    if not all_experiments:
        return
    job = Job(system, all_experiments[0], timeout)
    runs = [Run(i, experiment, reduce) for i, experiment in enumerate(all_experiments)]
    with place_of(where, workers) as place:
        for done in in_order(place, job, runs):
            yield done.result


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
