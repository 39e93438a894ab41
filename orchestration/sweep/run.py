"""Runs of a sweep, and its files: a journal while it runs, so that nothing is lost; one table at the end.

NAME.sweep.jsonl     while it runs: the journal, a row for each finished sample
NAME.sweep.lock      while a process runs it
NAME.recordings/     recordings of the samples, if they were asked for
NAME.sweep.parquet   the table
"""

import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from fmus.files import write_bytes_atomically
from fmus.fmi.variable_types import FmiValue
from fmus.operating_system import usable_processors
from orchestration.errors import SweepError
from orchestration.many.job import Batches, Failure, Finished, Job, Place, Run
from orchestration.many.journal import Journal
from orchestration.many.local_runs import LocalRuns
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.scenarios.changes import with_values
from orchestration.scenarios.scenario import Scenario
from orchestration.sweep import table
from orchestration.sweep.plan import Plan
from orchestration.sweep.plan import plan as plan_of
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


def sweep_rows(
    runs: Recording, declared: Mapping[str, Mapping[str, Any]], recorded: tuple[str, ...] | None
) -> list[SweepRow]:
    """Returns the row of each run of a recording with an axis of runs.

    declared: metrics of the scenario
    recorded: signals of each sample to keep; empty for all, None for no recordings
    """
    columns = {name: np.asarray(v).tolist() for name, v in metrics.evaluate(runs, declared).items()}
    rows = [{name: column[i] for name, column in columns.items()} for i in range(len(runs.values))]
    if recorded is None:
        return [SweepRow(row) for row in rows]
    return [SweepRow(row, _as_parquet(runs.run(i), recorded)) for i, row in enumerate(rows)]


def run_sweep(
    scenario: Scenario,
    folder: Path,
    *,
    workers: int | None = None,
    restart: bool = False,
    progress: Callable[[int], object] = lambda done: None,
) -> Path:
    """Runs the samples of a scenario with a table `sweep` that a folder does not have yet.

    Parameters
    ----------
    scenario : Scenario
        With a table `sweep`.
    folder : Path
        Folder of the results; finished samples in it are kept.
    workers : int, optional
        Runs at once; by default one for each processor.
    restart : bool
        Whether to discard finished samples.
    progress : callable
        Called with the number of samples that were finished since the last call.

    Returns
    -------
    Path
        Path of the table, NAME.sweep.parquet.

    Raises
    ------
    SweepError
        For a folder with another sweep of this name, or a second sweep at the same time.

    Examples
    --------
    >>> from tempfile import TemporaryDirectory
    >>> from orchestration import load_scenario
    >>> varied = {"samples": 2, "vary": {"plant.sensor_seed": {"distribution": "seed"}}}
    >>> scenario = load_scenario("nominal-extended", {"sweep": varied})
    >>> with TemporaryDirectory() as folder:
    ...     print(run_sweep(scenario, Path(folder), workers=1).name)
    nominal-extended.sweep.parquet
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
    progress: called with how many more samples are done, at first with the samples of an earlier start
    Raises SweepError if the folder holds another sweep, if another process runs the same one, or if
    samples cannot be run at all. A sample that fails is a row, and raises nothing.
    """
    with Store(folder, table.schema(plan, recorded)) as store:
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
                    store.add(*zip(*map(_row, finished), strict=True))
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
    numbers = iter(numbers)
    reduce = partial(sweep_rows, declared=plan.scenario.metrics, recorded=recorded)
    while block := list(islice(numbers, _DRAWN_AT_ONCE)):
        for number, values in zip(block, plan.block(block), strict=True):
            yield Run(SweepRun(number, values), with_values(base, values), reduce)


def recorded_signals(text: str, plan: Plan) -> tuple[str, ...] | None:
    """Returns `recorded` of `sweep_rows` for signals separated by commas; "" is no signal, "all" all."""
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


def _row(finished: Finished) -> tuple[dict[str, Any], bytes | None]:
    """Returns the row of a sample, and its recording."""
    sample, (result, warned, _) = finished
    is_failure = isinstance(result, Failure)
    measured, recording = SweepRow({}) if is_failure else result
    row = {
        table.SAMPLE: sample.number,
        **sample.values,
        **measured,
        table.WARNED: ", ".join(warned) or None,
        table.ERROR: result.reason if is_failure else None,
    }
    return row, recording


def _as_parquet(run: Recording, names: tuple[str, ...]) -> bytes:
    if names:
        columns = [run.names.index(name) for name in names]
        units = tuple(run.units[column] for column in columns)
        run = replace(run, names=names, units=units, values=run.values[:, columns])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sample.parquet"
        run.write(path)
        return path.read_bytes()


class Store:
    """The files of one sweep, for one process at a time: the context holds their lock until it ends.

    columns: of `table.schema`; SweepError if the files belong to another sweep
    """

    def __init__(self, folder: Path, columns: table.pa.Schema) -> None:
        about = table.provenance_of(columns)
        self._columns, self._count, name = columns, about["samples"], about["name"]
        self.path = folder / f"{name}.sweep.parquet"
        self.recordings = folder / f"{name}.recordings"
        self._journal = Journal(folder / f"{name}.sweep.jsonl", about, "sweep", SweepError, _identity)

    def __enter__(self) -> "Store":
        self._journal.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._journal.__exit__()

    def discard(self) -> None:
        """Removes what an earlier sweep of that name has left."""
        self.path.unlink(missing_ok=True)
        self._journal.discard()
        shutil.rmtree(self.recordings, ignore_errors=True)

    def begin(self) -> set[int]:
        """Returns the samples that are done already."""
        if self.path.is_file():
            finished, stored = table.read(self.path)
            self._journal.check_same(stored, self.path)
            return self._checked(finished[table.SAMPLE].to_pylist(), self.path)
        if not self._journal.path.is_file():
            # of another sweep, whose removal was cut off: no row is theirs
            shutil.rmtree(self.recordings, ignore_errors=True)
        self._journal.begin()
        return set(np.flatnonzero(self._positions() >= 0).tolist())

    def add(self, rows: Sequence[Mapping[str, Any]], recordings: Sequence[bytes | None] = ()) -> None:
        """Stores the rows of samples that are done, and their recordings as Parquet files."""
        digits = len(str(self._count - 1))
        for row, recording in zip(rows, recordings, strict=False):
            if recording:
                number = f"{row[table.SAMPLE]:0{digits}}"
                write_bytes_atomically(self.recordings / f"sample-{number}.parquet", recording)
        self._journal.add(rows)

    def finish(self) -> None:
        """Writes the table; SweepError if samples are missing."""
        if not self.path.is_file():
            positions = self._positions()
            if (positions < 0).any():
                self._checked(np.flatnonzero(positions >= 0).tolist(), self._journal.path)
            table.write(self._journal.lines_at(positions), self._columns, self.path)
        self._journal.discard()

    def _checked(self, samples: Iterable[int], path: Path) -> set[int]:
        """Returns the samples; SweepError unless they are all, each once."""
        numbers = sorted(samples)
        if numbers != list(range(self._count)):
            raise self._journal.refusal(
                f"{path}: {len(numbers)} rows of {len(set(numbers))} samples, expected {self._count}"
            )
        return set(numbers)

    def _positions(self) -> np.ndarray:
        """Returns each sample's row in the journal, shape (samples,); -1 for one that was not run."""
        positions = np.full(self._count, -1, np.int64)
        for position, row in self._journal.rows():
            if row.keys() >= {table.SAMPLE, table.ERROR} and row[table.SAMPLE] < self._count:
                positions[row[table.SAMPLE]] = position
        return positions


def _identity(key: str, value: Any) -> Any:
    """Returns what is compared of a value: hashes of FMUs, but neither their paths nor the command's text."""
    if key == "arguments":
        return None
    if key == "scenario" and isinstance(value, dict):
        return {**value, "components": sorted(value["components"])}
    return value
