"""What a Dask cluster of this machine loses to scheduling."""

from collections.abc import Sequence
from typing import Any

from distributed import get_task_stream

from orchestration.many.batches import Batches
from orchestration.scenarios.scenario import Scenario
from orchestration.sweep.plan import plan
from orchestration.sweep.run import job_of, samples_of
from tests.local_cluster import local_cluster


def loss(chosen: Scenario, samples: int, workers: int) -> tuple[float, float]:
    """(seconds of a sample, share of the workers' time without one), by Dask's own record of its tasks."""
    planned, parts = plan(chosen), dict[str, list[tuple[float, float]]]()
    job = job_of(planned, None)
    with local_cluster(workers) as (client, place):
        stream: Any = get_task_stream(client)
        with stream:
            for _ in place.runs(job, Batches(samples_of(planned, job.base, range(samples)), samples)):
                pass
    for task in stream.data:
        computed = [part for part in task["startstops"] if part["action"] == "compute"]
        parts.setdefault(task["worker"], []).extend((part["start"], part["stop"]) for part in computed)
    first = [min(own) for own in parts.values()]  # of one sample each, and the FMUs are loaded in it
    seconds = sum(stop - start for own in parts.values() for start, stop in own)
    sample_s = (seconds - sum(stop - start for start, stop in first)) / (samples - len(first))
    return sample_s, lost([*parts.values()], workers)


def lost(parts: Sequence[Sequence[tuple[float, float]]], workers: int) -> float:
    """Share of the time of so many workers in which they run nothing, once each has run something.

    Until all of them are done: what one waits for the others at the end is lost too.
    parts: of each worker that ran something, (start, end) [s] of what it ran
    """
    start = max(min(end for _, end in own) for own in parts)
    last = max(end for own in parts for _, end in own)
    busy = sum(max(0.0, end - max(begin, start)) for own in parts for begin, end in own)
    return 1.0 - busy / (workers * (last - start))
