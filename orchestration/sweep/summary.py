"""A sweep in a few numbers, apart for each combination of the texts and truth values that are varied."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from fmus.extras import imports_of
from orchestration.results.metric_units import shown
from orchestration.sweep import table

with imports_of("sweep", "a sweep"):
    import pyarrow as pa

_PERCENT = {"least": 0, "5 %": 5, "50 %": 50, "95 %": 95, "largest": 100}
HEADINGS = ("samples", "mean", "std", *_PERCENT)
_PRINTED = ("samples", "mean", "std", "5 %", "50 %", "95 %")


def statistics(values: np.ndarray) -> dict[str, float]:
    """HEADINGS -> of the values that are numbers: how many, mean, std (n - 1), percentiles; {} of none."""
    numbers = values[np.isfinite(values)]
    if not len(numbers):
        return {}
    spread = numbers.std(ddof=1) if len(numbers) > 1 else 0.0
    percentiles = np.percentile(numbers, list(_PERCENT.values()))
    return dict(zip(HEADINGS, (len(numbers), numbers.mean(), spread, *percentiles), strict=True))


def groups(varied: Mapping[str, Sequence[Any]], samples: Iterable[int]) -> dict[tuple[str, ...], np.ndarray]:
    """The values of what is varied and no number -> those of the samples that have them.

    varied: name -> a value a sample. All samples are under () if only numbers are varied.
    """
    categories = categorical(varied)
    members: dict[tuple[str, ...], list[int]] = {}
    for i in samples:
        members.setdefault(tuple(str(varied[name][i]) for name in categories), []).append(i)
    return {values: np.array(indices) for values, indices in members.items()}


def categorical(varied: Mapping[str, Sequence[Any]]) -> list[str]:
    """The names of what is varied and no number."""
    return [
        name for name, values in varied.items() if any(isinstance(v, (str, bool, np.bool_)) for v in values)
    ]


def failed(results: pa.Table) -> int:
    """How many samples have an error."""
    return len(results) - results[table.ERROR].null_count


def summary_table(results: pa.Table, provenance: dict[str, Any]) -> Table:
    """The summary as a table for a terminal."""
    printed = Table(title=escape(f"{provenance['title']}: {len(results)} samples, {failed(results)} failed"))
    names = table.names(results.schema, "varied")
    is_text = {name: not pa.types.is_floating(results[name].type) for name in names}
    varied = {name: results[name].to_pylist() for name in names if is_text[name]}
    for heading in (*categorical(varied), "Metric", "Unit"):
        printed.add_column(escape(heading), no_wrap=heading == "Metric")
    for heading in _PRINTED:
        printed.add_column(heading.capitalize(), justify="right")
    good = np.flatnonzero(results[table.ERROR].is_null().to_pylist())
    metrics = {  # `to_numpy` imports pandas
        name: np.array(results[name].to_pylist(), float) for name in provenance["scenario"]["metrics"]
    }
    for values, indices in groups(varied, good).items():
        printed.add_section()
        for name, call in provenance["scenario"]["metrics"].items():
            numbers = statistics(metrics[name][indices])
            cells = [f"{numbers[heading]:.4g}" for heading in _PRINTED if numbers] or [
                "0",
                shown(math.nan, call),
            ]
            printed.add_row(*map(escape, (*values, name, table.unit(results.schema, name))), *cells)
    return printed
