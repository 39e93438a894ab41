"""What a Dask cluster of this machine loses to scheduling."""

import time
from collections.abc import Sequence

from orchestration.scenarios.scenario import Scenario
from orchestration.sweep.plan import plan
from orchestration.sweep.samples import Job
from orchestration.sweep.workers import Batches
from tests.local_cluster import local_cluster


class _Measured(Batches):
    """Batches that sum up how long they were run."""

    seconds = 0.0

    def note(self, count: int, seconds: float, rest: Sequence[int] = ()) -> None:
        self.seconds += seconds
        super().note(count, seconds, rest)


def loss(chosen: Scenario, samples: int, workers: int) -> tuple[float, float]:
    """(seconds of a sample, share of the workers' time without one), from the first finished batch on."""
    planned = plan(chosen)
    batches = _Measured(range(samples), samples)
    done, start, before = 0, 0.0, 0.0
    with local_cluster(workers) as started:
        for finished in started.run(planned, Job.of(planned, None), batches):
            if not start and done >= workers:  # each has loaded its FMUs
                start, before, done = time.perf_counter(), batches.seconds, 0
            done += len(finished.numbers)
        wall = time.perf_counter() - start
    busy = batches.seconds - before
    return busy / done, 1.0 - busy / (workers * wall)
