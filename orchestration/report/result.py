"""Results on a page: runs, and sweeps with their distributions and correlations.

Statistics leave failed samples out. If texts or truth values are varied, each combination of them is a group.
"""

import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from fmus.extras import imports_of, require
from orchestration.errors import OrchestrationError
from orchestration.results.metric_units import shown
from orchestration.results.recording import Recording
from orchestration.results.statistics import holm, paired

with imports_of("report", "a report"):
    # A missing pyarrow is reported here, because the table would name the extra of sweeps.
    import pyarrow  # noqa: F401

    from orchestration.sweep import table
    from orchestration.sweep.table import categorical, groups, statistics


@dataclass(frozen=True)
class RunResult:
    """The result of a run. A recording without its .json has no scenario, provenance and metrics.

    name: unique on a page; scenario: resolved, as TOML has it; provenance: FMUs, algorithm, step size
    metric_units: by the names of the metrics, "" for an unknown unit
    is_measured: whether it is a log of another program; an empty cell of a log is a gap
    """

    name: str
    recording: Recording
    scenario: Mapping[str, Any] = field(default_factory=dict)
    provenance: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, float] = field(default_factory=dict)
    metric_units: Mapping[str, str] = field(default_factory=dict)
    is_measured: bool = False

    @property
    def title(self) -> str:
        return str(self.scenario.get("title", self.name))


@dataclass(frozen=True)
class SweepResult:
    """The result of a sweep; arrays have an entry for each sample.

    samples: their numbers; varied: "component.variable" -> values
    metrics: name -> values, NaN if the sample failed or the event did not happen; errors: "" for no error
    units: of variables and metrics, if known; absent: metric -> words for an event that did not happen
    command: runs a sample again, {sample} is its number
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


_SHOWN_ELSEWHERE = {"name", "title", "scenario", "varied", "arguments"}


def read_sweep(file: Path) -> SweepResult:
    """Reads a sweep, which is named after its file; OrchestrationError if it has no sample."""
    rows, provenance = table.read(file)
    if not rows.num_rows:
        raise OrchestrationError(f"{file}: expected at least one sample, got none")
    varied, metrics = table.names(rows.schema, "varied"), table.names(rows.schema, "metric")
    arguments = provenance.get("arguments", [provenance["name"]])  # older tables have no arguments
    return SweepResult(
        name=file.stem,
        samples=rows[table.SAMPLE].to_numpy(),
        varied={name: rows[name].to_pylist() for name in varied},
        metrics={name: rows[name].to_numpy().astype(float) for name in metrics},
        errors=tuple(error or "" for error in rows[table.ERROR].to_pylist()),
        units={name: table.unit(rows.schema, name) for name in [*varied, *metrics]},
        scenario=provenance["scenario"],
        provenance={key: value for key, value in provenance.items() if key not in _SHOWN_ELSEWHERE},
        absent={name: shown(math.nan, provenance["scenario"]["metrics"].get(name, {})) for name in metrics},
        command=f"{shlex.join(['l1-depth', 'sweep', *arguments])} --sample {{sample}}",
    )


def groups_of(sweep: SweepResult) -> dict[tuple[str, ...], np.ndarray]:
    """Returns the varied texts and truth values -> indices of their samples that did not fail."""
    return groups(sweep.varied, [i for i, error in enumerate(sweep.errors) if not error])


def of_succeeded(sweep: SweepResult, metric: str) -> dict[str, float]:
    """Returns the statistics of a metric over all samples that did not fail; empty if it has no number."""
    return statistics(sweep.metrics[metric][[not error for error in sweep.errors]])


def distributions(sweep: SweepResult) -> list[dict[str, Any]]:
    """Returns the statistics of each group and metric."""
    return [
        {"group": group, "name": name, "values": statistics(values[indices])}
        for group, indices in groups_of(sweep).items()
        for name, values in sweep.metrics.items()
    ]


def correlations(sweep: SweepResult) -> list[dict[str, Any]]:
    """Returns a row for each variable: metric -> correlation of ranks; None if one of both is constant.

    For a number it is Spearman's within each group, -1..1. For a text or truth value it is the correlation
    ratio over all groups, 0..1: the standard deviation of the ranks that the value determines, divided by the
    standard deviation of all ranks. With two values it is the magnitude of Spearman's.
    """
    categories, by_group = categorical(sweep.varied), groups_of(sweep)
    pooled = {("all",) * len(categories): np.flatnonzero([not error for error in sweep.errors])}
    return [
        {
            "group": group,
            "name": name,
            "values": {
                metric: _rank_correlation([values[i] for i in indices], measured[indices])
                for metric, measured in sweep.metrics.items()
            },
        }
        for name, values in sweep.varied.items()
        for group, indices in (pooled if name in categories else by_group).items()
    ]


def _rank_correlation(values: Sequence[Any], metric: np.ndarray) -> float | None:
    # SciPy takes longer to import than a page without a sweep takes
    rankdata = require("scipy.stats", "report", "a report of a sweep").rankdata

    good = np.isfinite(metric)
    chosen, ranks = np.array(values)[good], rankdata(metric[good])
    if len(np.unique(chosen)) < 2 or len(np.unique(ranks)) < 2:
        return None
    if np.issubdtype(chosen.dtype, np.number):
        return float(np.corrcoef(rankdata(chosen), ranks)[0, 1])
    means = [ranks[chosen == value].mean() for value in chosen]  # for each rank, the mean of its value
    return float(np.std(means) / np.std(ranks))


def strongest(rows: list[dict[str, Any]]) -> tuple[str, str] | None:
    """Returns the variable and the metric with the largest correlation."""
    strength = {
        (row["name"], metric): abs(value)
        for row in rows
        for metric, value in row["values"].items()
        if value is not None
    }
    return max(strength, key=lambda pair: strength[pair]) if strength else None


def common_metrics(sweeps: Sequence[SweepResult]) -> dict[str, str]:
    """Returns the common metrics of several sweeps -> their units."""
    if len(sweeps) < 2:
        return {}
    first, *others = sweeps
    return {
        name: first.units[name]
        for name in first.metrics
        if all(name in other.metrics and other.units[name] == first.units[name] for other in others)
    }


def paired_differences(sweeps: Sequence[SweepResult]) -> list[dict[str, Any]]:
    """Returns the differences of each metric of each later sweep to the first sweep, sample by sample.

    Samples with equal numbers are a pair if all their common variables are equal and neither failed.
    """
    first, *others = sweeps
    tests = {}
    for other in others:
        mine, own = _pairs(first, other)
        for metric in common_metrics(sweeps):
            values = other.metrics[metric][own], first.metrics[metric][mine]
            tests[other.name, metric] = paired(*values, comparisons=len(others))
    p_holm = holm({key: test.p for key, test in tests.items()})
    return [
        {"sweep": sweep, "metric": metric, "test": test, "p": p_holm[sweep, metric]}
        for (sweep, metric), test in tests.items()
    ]


def _pairs(first: SweepResult, other: SweepResult) -> tuple[np.ndarray, np.ndarray]:
    """Returns the indices of the paired samples in both sweeps."""
    # Equal numbers alone make no pair: a sweep with another seed draws other values for them.
    _, *indices = np.intersect1d(first.samples, other.samples, return_indices=True)
    varied = [name for name in first.varied if name in other.varied]
    are_pairs = [
        bool(varied) and all(first.varied[name][i] == other.varied[name][k] for name in varied)
        for i, k in zip(*indices, strict=True)
    ]
    return indices[0][are_pairs], indices[1][are_pairs]
