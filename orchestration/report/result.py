"""What a page shows: runs and sweeps, as they are read from their files."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orchestration.results.recording import Recording


@dataclass(frozen=True)
class RunResult:
    """A run. Of a recording that stands alone, scenario, provenance and metrics are empty.

    name: unique on a page; scenario: resolved, as TOML has it; provenance: FMUs, algorithm, step size
    metric_units: by the names of the metrics, "" where a unit is not known
    """

    name: str
    recording: Recording
    scenario: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)
    metric_units: Mapping[str, str] = field(default_factory=dict)

    @property
    def title(self) -> str:
        return str(self.scenario.get("title", self.name))


@dataclass(frozen=True)
class SweepResult:
    """Samples of a scenario; arrays have an entry a sample.

    samples: their numbers; varied: "component.variable" -> values; metrics: name -> values, NaN where a
    sample failed or it did not happen; errors: "" where none; units: of varied ones and metrics, where known;
    absent: metric -> the word for what did not happen; command: runs a sample again, {sample} is its number
    """

    name: str
    samples: np.ndarray
    varied: Mapping[str, list[Any]]
    metrics: Mapping[str, np.ndarray]
    errors: tuple[str, ...]
    units: Mapping[str, str]
    scenario: Mapping[str, Any]
    provenance: Mapping[str, Any]
    absent: Mapping[str, str]
    command: str

    @property
    def title(self) -> str:
        return str(self.scenario.get("title", self.name))
