"""What the process that runs samples receives and returns."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from orchestration.errors import SweepError
from orchestration.sweep.plan import Plan
from orchestration.system.experiment import Experiment
from orchestration.system.system import System


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


def recorded_signals(text: str, plan: Plan) -> tuple[str, ...] | None:
    """`Job.recorded` for a user's list of signals, separated by commas; "" is no recordings, "all" is all."""
    if text in ("", "all"):
        return None if not text else ()
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",")))
    for name in names:
        port = plan.checked.port(name, "recordings")
        if port.variable.causality != "output" and name not in plan.scenario.experiment.signals:
            raise SweepError(f"recordings: {name}: expected an output or an input driven by a signal")
    return names


def job(plan: Plan, recorded: tuple[str, ...] | None) -> Job:
    """What the samples of a plan share, FMUs included.

    recorded: signals to record of each sample; empty for all, None for no recordings
    """
    system, experiment = plan.scenario.system, plan.scenario.experiment
    if recorded and experiment.record:
        experiment = replace(experiment, record=tuple(dict.fromkeys([*experiment.record, *recorded])))
    contents = {name: path.read_bytes() for name, path in system.components.items()}
    # the hash tells apart FMUs of one file name; equal FMUs share one file
    files = {
        name: f"{hashlib.sha256(contents[name]).hexdigest()[:12]}/{Path(path).name}"
        for name, path in system.components.items()
    }
    return Job(
        system=System({name: Path(file) for name, file in files.items()}, system.connections),
        fmus={file: contents[name] for name, file in files.items()},
        experiment=experiment,
        metrics=plan.scenario.metrics,
        recorded=recorded,
        timeout=plan.timeout,
    )
