"""Samples, one after another, with FMUs that stay loaded; in this process, or in one of their own.

An FMU that crashes or hangs takes its process with it and nothing else.
"""

import os
import pickle
import re
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory, gettempdir
from typing import TYPE_CHECKING, Any

from fmus.process import Parent
from orchestration.errors import OrchestrationError, SweepError
from orchestration.master import Simulator
from orchestration.results import metrics
from orchestration.results.recording import Recording
from orchestration.sweep.target import Settings, with_settings
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import prepare_checked
from orchestration.system.system import System

if TYPE_CHECKING:  # what runs samples draws none
    from orchestration.sweep.plan import Plan

READY = "ready"
BATCH_S = 0.25  # after which a batch of samples ends, whatever is left of it


class ClosedError(SweepError):
    """What runs samples was closed while it ran one: another worker has to run it."""


@dataclass(frozen=True)
class Job:
    """What the samples share.

    fmus: file name -> content, where the system's components are such file names
    recorded: signals of each sample to send back; empty for all, None for no recordings
    timeout: s that a sample may take, None for ever
    """

    system: System
    fmus: Mapping[str, bytes]
    experiment: Experiment
    metrics: Mapping[str, Mapping[str, Any]]
    recorded: tuple[str, ...] | None
    timeout: float | None

    @staticmethod
    def of(plan: "Plan", recorded: tuple[str, ...] | None) -> "Job":
        """What the samples of a plan share, FMUs included."""
        system, experiment = plan.scenario.system, plan.scenario.experiment
        if recorded and experiment.record:
            experiment = replace(experiment, record=tuple(dict.fromkeys([*experiment.record, *recorded])))
        if recorded is None:
            experiment = replace(experiment, record=_needed(plan))
        return Job(system, {}, experiment, plan.scenario.metrics, recorded, plan.timeout)

    def with_packed_fmus(self) -> "Job":
        """The same for another machine: its FMUs go with it."""
        components = self.system.components
        files = {name: Path(name, path.name) for name, path in components.items()}
        fmus = {files[name].as_posix(): path.read_bytes() for name, path in components.items()}
        return replace(self, fmus=fmus, system=replace(self.system, components=files))

    def with_unpacked_fmus(self, folder: Path) -> "Job":
        """The same with its FMUs as files in a folder."""
        for name, content in self.fmus.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        components = {name: folder / path for name, path in self.system.components.items()}
        return replace(self, fmus={}, system=replace(self.system, components=components))


@dataclass(frozen=True)
class Outcome:
    """The result of a sample: its metrics, or why it failed; its recording as a Parquet file.

    warned: the components whose FMUs returned warnings, separated by commas
    """

    metrics: Mapping[str, float]
    error: str | None = None
    recording: bytes | None = None
    warned: str | None = None


def recorded_signals(text: str, plan: "Plan") -> tuple[str, ...] | None:
    """`Job.recorded` for a user's list of signals, separated by commas; "" is no recordings, "all" is all."""
    if text in ("", "all"):
        return None if not text else ()
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        port = plan.checked.port(name, "recordings")
        if port.variable.causality != "output" and name not in plan.scenario.experiment.signals:
            raise SweepError(f"recordings: {name}: expected an output or an input driven by a signal")
    return names


def _needed(plan: "Plan") -> tuple[str, ...]:
    """The recorded signals that metrics use; all if they use none, since no names mean all."""
    experiment = plan.scenario.experiment
    used = {call.get(key) for call in plan.scenario.metrics.values() for key in metrics.SIGNALS}
    recorded = experiment.record or prepare_checked(plan.checked, experiment).recorded
    return tuple(name for name in recorded if name in used) or tuple(experiment.record)


class Samples(AbstractContextManager["Samples"]):
    """Runs samples one after another in this process; the FMUs are loaded anew after one that failed."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._loaded = ExitStack()  # holds a simulator, until a sample fails
        self._simulator: Simulator | None = None
        self._closed = False

    def load(self) -> Simulator:
        """The simulator; OrchestrationError for FMUs that cannot be loaded."""
        if not self._simulator:
            self._simulator = self._loaded.enter_context(Simulator(self._job.system, threads=1))
        return self._simulator

    def run(self, settings: Settings) -> Outcome:
        """One sample; ClosedError if it was closed meanwhile."""
        job = self._job
        try:
            recording = self.load().run(with_settings(job.experiment, settings), self._check_open)
            self._check_open()  # closed in the second run of an error estimate, it has none
            values, warned = metrics.evaluate(recording, job.metrics), ", ".join(self.load().warned) or None
            return Outcome(values, recording=_as_parquet(recording, job), warned=warned)
        except Exception as error:  # a sample that fails is a row, whatever the reason
            self._simulator = self._loaded.close()
            self._check_open()
            return Outcome({}, error=_error_line(error, job))

    def close(self) -> None:
        """End a sample that another thread runs soon."""
        self._closed = True

    def __exit__(self, *_: object) -> None:
        self._loaded.close()

    def _check_open(self, *_: int) -> None:
        if self._closed:
            raise ClosedError("closed while a sample was running")


def run_batch(
    run: Callable[[Settings], Outcome],
    settings: Iterable[Settings],
    clock: Callable[[], float] = time.perf_counter,
) -> tuple[list[Outcome], float]:
    """The outcomes of samples until `BATCH_S` have passed, at least of one, and how long they took [s]."""
    start, outcomes = clock(), list[Outcome]()
    for sample in settings:
        outcomes.append(run(sample))
        if clock() - start >= BATCH_S:
            break
    return outcomes, clock() - start


def run_samples(parent: Parent) -> None:
    """Receive a pickled job, send READY; then receive the settings of samples and send their outcomes."""
    samples = Samples(pickle.loads(parent.receive()))
    with suppress(OrchestrationError):  # each sample will fail with it
        samples.load()
    parent.send(READY)
    while True:
        parent.send(samples.run(parent.receive()))


def _as_parquet(recording: Recording, job: Job) -> bytes | None:
    if job.recorded is None:
        return None
    if job.recorded:
        columns = [recording.names.index(name) for name in job.recorded]
        units = tuple(recording.units[column] for column in columns)
        recording = replace(recording, names=job.recorded, units=units, values=recording.values[:, columns])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "sample.parquet"
        recording.write(path)
        return path.read_bytes()


def _error_line(error: Exception, job: Job) -> str:
    """One line that does not depend on where this process keeps its files."""
    text = str(error) if isinstance(error, OrchestrationError) else f"{type(error).__name__}: {error}"
    for path in job.system.components.values():
        text = text.replace(f"{path.parent}{os.sep}", "")
    text = re.sub(rf"{re.escape(gettempdir())}/[^/\s]+/", "", text)  # of what was unpacked
    return " ".join(text.split())
