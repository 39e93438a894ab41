"""Running a sweep: samples go to workers in batches, rows come back to the store."""

from collections.abc import Callable
from contextlib import AbstractContextManager, closing
from pathlib import Path
from typing import Any

from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import Job
from orchestration.sweep.store import Store
from orchestration.sweep.table import ERROR, SAMPLE, WARNED, schema
from orchestration.sweep.workers import Batches, Finished, Workers


def sweep(
    plan: Plan,
    folder: Path,
    workers: AbstractContextManager[Workers],
    recorded: tuple[str, ...] | None = None,
    restart: bool = False,
    progress: Callable[[int], object] = lambda done: None,
) -> Path:
    """Run the samples that are missing in a folder, and write the table; gives its path.

    workers: `local.local` or `cluster.remote`, entered if a sample is missing
    recorded: signals to record of each sample; empty for all, None for no recordings
    restart: discard what an earlier sweep of that name has left, as soon as the first samples are done: what
        cannot be run at all, by these workers, discards nothing
    progress: called with how many more samples are done, at first with those of an earlier start
    Raises SweepError if the folder holds another sweep, if another process runs the same one, or if
    samples cannot be run at all. A sample that fails is a row, and raises nothing.
    """
    with Store(folder, schema(plan, recorded)) as store:
        done = set[int]() if restart else store.begin()
        progress(len(done))
        missing = (sample for sample in range(plan.count) if sample not in done)
        batches = Batches(missing, plan.count - len(done))
        if batches.left:
            with (
                workers as started,
                closing(started.run(plan, Job.of(plan, recorded), batches)) as all_finished,
            ):
                for finished in all_finished:
                    if restart:
                        store.discard()
                        store.begin()
                        restart = False
                    store.add(_rows(finished), [outcome.recording for outcome in finished.outcomes])
                    progress(len(finished.numbers))
        store.finish()
    return store.path


def _rows(finished: Finished) -> list[dict[str, Any]]:
    return [
        {SAMPLE: number, **values, **outcome.metrics, WARNED: outcome.warned, ERROR: outcome.error}
        for number, values, outcome in zip(*finished, strict=True)
    ]
