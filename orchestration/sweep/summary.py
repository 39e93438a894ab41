"""A sweep in a few numbers."""

from typing import Any

import numpy as np
from rich.markup import escape
from rich.table import Table

from fmus.extras import imports_of
from orchestration.sweep import table

with imports_of("sweep", "a sweep"):
    import pyarrow as pa

_PERCENT = (5, 50, 95)


def summary(results: pa.Table) -> dict[str, dict[str, float]]:
    """Metric -> mean, std (of the samples, n - 1), 5, 50 and 95 percent, over the samples that did not fail.

    A metric without two values is left out.
    """
    statistics = {}
    for name in table.names(results.schema, "metric"):
        values = results[name].drop_null().to_numpy()
        if len(values) > 1:
            percentiles = dict(
                zip((f"{p} %" for p in _PERCENT), np.percentile(values, _PERCENT), strict=True)
            )
            statistics[name] = {"mean": values.mean(), "std": values.std(ddof=1), **percentiles}
    return statistics


def failed(results: pa.Table) -> int:
    """How many samples have an error."""
    return len(results) - results[table.ERROR].null_count


def summary_table(results: pa.Table, provenance: dict[str, Any]) -> Table:
    """The summary as a table for a terminal."""
    printed = Table(title=escape(f"{provenance['title']}: {len(results)} samples, {failed(results)} failed"))
    printed.add_column("Metric", no_wrap=True)
    for heading in ("Unit", "Mean", "Std", *(f"{p} %" for p in _PERCENT)):
        printed.add_column(heading, justify="left" if heading == "Unit" else "right")
    for name, numbers in summary(results).items():
        unit = (results.schema.field(name).metadata or {}).get(b"unit", b"").decode()
        printed.add_row(name, unit, *(f"{number:.4g}" for number in numbers.values()))
    return printed
