"""Results on a page: runs, and sweeps in numbers: distributions, and what metrics depend on.

Failed samples are left out. Where texts or truth values are varied, each combination of them is a group of
its own.
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

from fmus.extras import imports_of
from orchestration.errors import OrchestrationError
from orchestration.results.metric_units import shown
from orchestration.results.recording import Recording
from orchestration.results.statistics import holm, paired

with imports_of("report", "a report"):
    import pyarrow  # noqa: F401  (of the table, which would name its own extra)

    from orchestration.sweep import table  # which needs no more of the extra sweep
    from orchestration.sweep.table import categorical, groups, statistics


@dataclass(frozen=True)
class RunResult:
    """The result of a run. Scenario, provenance and metrics of a recording that stands alone are empty.

    name: unique on a page; scenario: resolved, as TOML has it; provenance: FMUs, algorithm, step size
    metric_units: by the names of the metrics, "" where a unit is not known
    is_measured: whether it is a log of another program, whose empty cells are no readings
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


_SHOWN_ELSEWHERE = {"name", "title", "scenario", "varied", "arguments"}


def read_sweep(file: Path) -> SweepResult:
    """Reads the sweep in a file, named after the file; OrchestrationError if it has no sample."""
    rows, provenance = table.read(file)
    if not rows.num_rows:
        raise OrchestrationError(f"{file}: expected at least one sample, got none")
    varied, metrics = table.names(rows.schema, "varied"), table.names(rows.schema, "metric")
    arguments = provenance.get("arguments", [provenance["name"]])  # those of older tables are not known
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
    """Returns values of what is varied and no number -> indices of their samples that did not fail."""
    return groups(sweep.varied, [i for i, error in enumerate(sweep.errors) if not error])


def of_succeeded(sweep: SweepResult, metric: str) -> dict[str, float]:
    """Returns the statistics of a metric over all samples that did not fail; empty where it has no number."""
    return statistics(sweep.metrics[metric][[not error for error in sweep.errors]])


def distributions(sweep: SweepResult) -> list[dict[str, Any]]:
    """Returns the statistics of each group and metric."""
    return [
        {"group": group, "name": name, "values": statistics(values[indices])}
        for group, indices in groups_of(sweep).items()
        for name, values in sweep.metrics.items()
    ]


def correlations(sweep: SweepResult) -> list[dict[str, Any]]:
    """Returns rows of what is varied: metric -> correlation of ranks; None where one of them does not vary.

    Of a number, within each group, Spearman's, -1..1; of a text or truth value, over all groups, 0..1: the
    share of the metric's ranks that the value determines, as a standard deviation. For two values it is the
    size of Spearman's.
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
    from scipy.stats import rankdata  # takes longer to import than a page without a sweep takes

    good = np.isfinite(metric)
    chosen, ranks = np.array(values)[good], rankdata(metric[good])
    if len(np.unique(chosen)) < 2 or len(np.unique(ranks)) < 2:
        return None
    if np.issubdtype(chosen.dtype, np.number):
        return float(np.corrcoef(rankdata(chosen), ranks)[0, 1])
    means = [ranks[chosen == value].mean() for value in chosen]  # of each rank, that of its value
    return float(np.std(means) / np.std(ranks))


def strongest(rows: list[dict[str, Any]]) -> tuple[str, str] | None:
    """Returns the varied name and the metric with the largest correlation."""
    strength = {
        (row["name"], metric): abs(value)
        for row in rows
        for metric, value in row["values"].items()
        if value is not None
    }
    return max(strength, key=lambda pair: strength[pair]) if strength else None


def grid_of(sweep: SweepResult) -> tuple[str, str] | None:
    """Returns the names of the two numbers that a sweep varies on a grid; None for any other sweep.

    On a grid each group of samples has each pair of values once.
    """
    categories = categorical(sweep.varied)
    numbers = [name for name in sweep.varied if name not in categories]
    if len(numbers) != 2:
        return None
    first, second = (sweep.varied[name] for name in numbers)
    pairs = len({*first}) * len({*second})
    cells = {*zip(first, second, *(sweep.varied[name] for name in categories), strict=True)}
    is_grid = min(len({*first}), len({*second})) > 1 and len(cells) == len(sweep.samples)
    return (numbers[0], numbers[1]) if is_grid and len(cells) % pairs == 0 else None


def common_metrics(sweeps: Sequence[SweepResult]) -> dict[str, str]:
    """Returns the metrics that several sweeps have in common -> their units."""
    if len(sweeps) < 2:
        return {}
    first, *others = sweeps
    return {
        name: first.units[name]
        for name in first.metrics
        if all(name in other.metrics and other.units[name] == first.units[name] for other in others)
    }


def paired_differences(sweeps: Sequence[SweepResult]) -> list[dict[str, Any]]:
    """Returns how each metric of each later sweep differs from the first one's, sample by sample.

    Samples of equal numbers are a pair if the values of all that both vary are equal, and neither failed.
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
    """Returns the indices of the samples of both that are pairs."""
    _, *indices = np.intersect1d(first.samples, other.samples, return_indices=True)
    varied = [name for name in first.varied if name in other.varied]
    are_pairs = [
        bool(varied) and all(first.varied[name][i] == other.varied[name][k] for name in varied)
        for i, k in zip(*indices, strict=True)
    ]
    return indices[0][are_pairs], indices[1][are_pairs]
