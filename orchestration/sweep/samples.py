"""The process in which the FMUs of a sweep are loaded and run, and what it receives and returns.

An FMU that crashes or hangs takes this process with it and nothing else. The FMUs stay loaded from sample
to sample.
"""

import pickle
import re
from collections.abc import Mapping
from contextlib import ExitStack, suppress
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
from orchestration.system.system import System

if TYPE_CHECKING:  # what runs samples draws none
    from orchestration.sweep.plan import Plan

READY = "ready"


@dataclass(frozen=True)
class Job:
    """What the samples share.

    fmus: file name -> content; system: its components are such file names
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
        files = {name: Path(name, path.name) for name, path in system.components.items()}
        fmus = {files[name].as_posix(): path.read_bytes() for name, path in system.components.items()}
        portable = System(files, system.connections)
        return Job(portable, fmus, experiment, plan.scenario.metrics, recorded, plan.timeout)

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
    """The result of a sample: its metrics, or why it failed; its recording as a Parquet file."""

    metrics: Mapping[str, float]
    error: str | None = None
    recording: bytes | None = None


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


def run_samples(parent: Parent) -> None:
    """Receive a pickled job, send READY; then receive the settings of samples and send their outcomes."""
    job: Job = pickle.loads(parent.receive())
    simulators = ExitStack()  # holds one, until a sample fails
    simulator = None
    with suppress(OrchestrationError):  # each sample will fail with it
        simulator = simulators.enter_context(Simulator(job.system))
    parent.send(READY)
    while True:
        settings: Settings = parent.receive()
        try:
            simulator = simulator or simulators.enter_context(Simulator(job.system))
            recording = simulator.run(with_settings(job.experiment, settings))
            outcome = Outcome(metrics.evaluate(recording, job.metrics), recording=_as_parquet(recording, job))
        except Exception as error:  # a sample that fails is a row, whatever the reason
            simulator = simulators.close()
            outcome = Outcome({}, error=_error_line(error))
        parent.send(outcome)


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


def _error_line(error: Exception) -> str:
    """One line that does not depend on where this process keeps its files."""
    text = str(error) if isinstance(error, OrchestrationError) else f"{type(error).__name__}: {error}"
    temporary = Path(gettempdir())
    for folder in (temporary, temporary.parent):  # of what was unpacked, and of the FMUs
        text = re.sub(rf"{re.escape(str(folder))}/[^/\s]+/", "", text)
    return " ".join(text.split())
