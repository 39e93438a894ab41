"""What the process that runs samples is told, and what it answers."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from orchestration.errors import SweepError
from orchestration.sweep.plan import Plan
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

Settings = Mapping[str, Mapping[str, Any]]  # table of the scenario file -> key -> value


@dataclass(frozen=True)
class Job:
    """What the samples share.

    fmus: file name -> content; system: its components are such file names
    kept: signals of each sample to send back; empty for all, None for no recordings
    timeout: s that a sample may take, None for ever
    """

    system: System
    fmus: Mapping[str, bytes]
    experiment: Experiment
    metrics: Mapping[str, Mapping[str, Any]]
    kept: tuple[str, ...] | None
    timeout: float | None

    def unpacked(self, folder: Path) -> "Job":
        """The same with its FMUs as files in a folder."""
        for name, content in self.fmus.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        components = {name: folder / path for name, path in self.system.components.items()}
        return replace(self, fmus={}, system=replace(self.system, components=components))


@dataclass(frozen=True)
class Outcome:
    """What became of a sample: its metrics, or why it failed; its recording as a Parquet file."""

    metrics: Mapping[str, float]
    error: str | None = None
    recording: bytes | None = None


def signals(text: str, plan: Plan) -> tuple[str, ...] | None:
    """What `kept` is for a user's list of signals, separated by commas; "" is no recordings, "all" is all."""
    if text in ("", "all"):
        return None if not text else ()
    names = tuple(dict.fromkeys(each.strip() for each in text.split(",")))
    for name in names:
        port = plan.checked.port(name, "recordings")
        if port.variable.causality != "output" and name not in plan.scenario.experiment.signals:
            raise SweepError(f"recordings: {name}: expected an output or an input driven by a signal")
    return names


def job(plan: Plan, kept: tuple[str, ...] | None) -> Job:
    """What the samples of a plan share, FMUs included.

    kept: signals to keep of each sample; empty for all, None for no recordings
    """
    system, experiment = plan.scenario.system, plan.scenario.experiment
    if kept and experiment.record:
        experiment = replace(experiment, record=tuple(dict.fromkeys([*experiment.record, *kept])))
    contents = {name: path.read_bytes() for name, path in system.components.items()}
    # FMUs of one name may be different ones; of equal ones there must be one file
    files = {
        name: f"{hashlib.sha256(contents[name]).hexdigest()[:12]}/{Path(path).name}"
        for name, path in system.components.items()
    }
    return Job(
        system=System({name: Path(file) for name, file in files.items()}, system.connections),
        fmus={file: contents[name] for name, file in files.items()},
        experiment=experiment,
        metrics=plan.scenario.metrics,
        kept=kept,
        timeout=plan.timeout,
    )
