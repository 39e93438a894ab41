"""Results on a page: runs and sweeps, as they are read from their files."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import tomli_w

from orchestration.results.recording import Recording


@dataclass(frozen=True)
class RunResult:
    """The result of a run. Scenario, provenance and metrics of a recording that stands alone are empty.

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
    """The result of a sweep; arrays have an entry a sample.

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


_ITEM = r'(?:"(?:[^"\\\n]|\\.)*"|[^\[\]",\s]+)'  # a text, or a number
_SHORT_LIST = re.compile(rf"\[\n((?: +{_ITEM},\n){{1,4}}) *\]")


def toml(content: Mapping[str, Any]) -> str:
    """Returns TOML with lists of up to four items on one line."""
    return _SHORT_LIST.sub(_on_one_line, tomli_w.dumps(content))


def _on_one_line(match: re.Match[str]) -> str:
    items = [line.strip(" ").removesuffix(",") for line in match[1].removesuffix("\n").split("\n")]
    return f"[{', '.join(items)}]"
