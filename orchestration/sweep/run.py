"""Runs of a sweep: its samples are runs of `orchestration.many`, whose results are rows of the store."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from fmus.fmi.variable_types import FmiValue
from fmus.operating_system import usable_processors
from orchestration.errors import SweepError
from orchestration.many.job import Batches, Failure, Finished, Job, Place, Run
from orchestration.many.run_many import LocalRuns
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.scenarios.changes import with_values
from orchestration.scenarios.scenario import Scenario
from orchestration.sweep.plan import Plan
from orchestration.sweep.plan import plan as plan_of
from orchestration.sweep.store import Store
from orchestration.sweep.table import ERROR, SAMPLE, WARNED, schema
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import prepare_checked

_DRAWN_AT_ONCE = 100  # samples whose values are drawn at once, before they run


class SweepRun(NamedTuple):
    """A run of a sweep: the number of its sample, and name -> value of what is varied in it."""

    number: int
    values: Mapping[str, FmiValue]


class SweepRow(NamedTuple):
    """The row of a sample: its metrics, and its recording as a Parquet file."""

    metrics: Mapping[str, float]
    recording: bytes | None = None


@dataclass(frozen=True)
class Rows:
    """The rows of recordings: the reduction of each run to its row.

    recorded: signals of each sample to keep; empty for all, None for no recordings
    """

    metrics: Mapping[str, Mapping[str, Any]]
    recorded: tuple[str, ...] | None

    def __call__(self, runs: Recording) -> list[SweepRow]:
        """Returns the row of each run of a recording with an axis of runs."""
        columns = {name: np.asarray(v).tolist() for name, v in metrics.evaluate(runs, self.metrics).items()}
        count = len(runs.values)
        rows = [{name: column[i] for name, column in columns.items()} for i in range(count)]
        if self.recorded is None:
            return [SweepRow(row) for row in rows]
        return [SweepRow(row, _as_parquet(runs.run(i), self.recorded)) for i, row in enumerate(rows)]


def run_sweep(
    scenario: Scenario,
    folder: Path,
    *,
    workers: int | None = None,
    restart: bool = False,
    progress: Callable[[int], object] = lambda done: None,
) -> Path:
    """Runs the samples of a scenario with a table `sweep` that a folder does not have yet; see `sweep`.

    workers: runs at once, by default as many as there are processors
    Returns the path of the table. Raises SweepError.
    """
    return sweep(
        plan_of(scenario),
        folder,
        LocalRuns(workers or usable_processors()),
        restart=restart,
        progress=progress,
    )


def sweep(
    plan: Plan,
    folder: Path,
    place_of: AbstractContextManager[Place],
    recorded: tuple[str, ...] | None = None,
    restart: bool = False,
    progress: Callable[[int], object] = lambda done: None,
) -> Path:
    """Runs the samples that are missing in a folder, and writes the table; returns its path.

    place_of: where the runs are made, entered if a sample is missing
    recorded: signals to record of each sample; empty for all, None for no recordings
    restart: discard what an earlier sweep of that name has left, as soon as the first samples are done: what
        cannot be run at all, in this place, discards nothing
    progress: called with how many more samples are done, at first with those of an earlier start
    Raises SweepError if the folder holds another sweep, if another process runs the same one, or if
    samples cannot be run at all. A sample that fails is a row, and raises nothing.
    """
    with Store(folder, schema(plan, recorded)) as store:
        done = set[int]() if restart else store.begin()
        progress(len(done))
        missing = (number for number in range(plan.count) if number not in done)
        if count := plan.count - len(done):
            job = job_of(plan, recorded)
            runs = Batches(samples_of(plan, job.base, missing, recorded), count)
            with place_of as place, closing(place.runs(job, runs)) as batches:
                for finished in batches:
                    if restart:
                        store.discard()
                        store.begin()
                        restart = False
                    store.add([_row(one) for one in finished], [_recording(one) for one in finished])
                    progress(len(finished))
        store.finish()
    return store.path


def job_of(plan: Plan, recorded: tuple[str, ...] | None) -> Job:
    """Returns what the samples of a plan share."""
    experiment = plan.scenario.experiment
    if recorded and experiment.record:
        experiment = replace(experiment, record=tuple(dict.fromkeys([*experiment.record, *recorded])))
    if recorded is None:
        experiment = replace(experiment, record=_needed(plan))
    others = [
        entry.target.name
        for entry in plan.varied
        if entry.target.table not in ("parameters", "inputs") or entry.target.name.endswith(".internal_step")
    ]
    refusals = [f"{name} is varied: expected parameters but internal_step, and inputs" for name in others]
    return Job(plan.scenario.system, experiment, plan.timeout, "".join(refusals[:1]))


def samples_of(
    plan: Plan, base: Experiment, numbers: Iterable[int], recorded: tuple[str, ...] | None = None
) -> Iterator[Run]:
    """Yields the runs of samples, which give rows; base: of `job_of`."""
    numbers, reduce = iter(numbers), Rows(plan.scenario.metrics, recorded)
    while block := list(islice(numbers, _DRAWN_AT_ONCE)):
        for number, values in zip(block, plan.block(block), strict=True):
            yield Run(SweepRun(number, values), with_values(base, values), reduce)


def recorded_signals(text: str, plan: Plan) -> tuple[str, ...] | None:
    """Returns `Rows.recorded` for a user's list of signals, separated by commas; "" is none, "all" is all."""
    if text in ("", "all"):
        return None if not text else ()
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        port = plan.checked.port(name, "recordings")
        if port.variable.causality != "output" and name not in plan.scenario.experiment.signals:
            raise SweepError(f"recordings: {name}: expected an output or an input driven by a signal")
    return names


def _needed(plan: Plan) -> tuple[str, ...]:
    """Returns the recorded signals that metrics use; all if they use none."""
    experiment = plan.scenario.experiment
    used = {call.get(key) for call in plan.scenario.metrics.values() for key in metrics.SIGNALS}
    recorded = experiment.record or prepare_checked(plan.checked, experiment).recorded
    # an experiment takes no names for all
    return tuple(name for name in recorded if name in used) or tuple(experiment.record)


def _row(finished: Finished) -> dict[str, Any]:
    sample, (result, warned, _) = finished
    is_failure = isinstance(result, Failure)
    return {
        SAMPLE: sample.number,
        **sample.values,
        **({} if is_failure else result.metrics),
        WARNED: ", ".join(warned) or None,
        ERROR: result.reason if is_failure else None,
    }


def _recording(finished: Finished) -> bytes | None:
    result = finished.done.result
    return None if isinstance(result, Failure) else result.recording


def _as_parquet(run: Recording, names: tuple[str, ...]) -> bytes:
    if names:
        columns = [run.names.index(name) for name in names]
        units = tuple(run.units[column] for column in columns)
        run = replace(run, names=names, units=units, values=run.values[:, columns])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sample.parquet"
        run.write(path)
        return path.read_bytes()
