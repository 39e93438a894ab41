"""Tables of results as text. Rich, which draws the other tables, takes longer to import than a run takes."""

from collections.abc import Mapping, Sequence
from typing import Any

from orchestration.results.metric_units import shown


def metrics_table(
    title: str,
    metrics: Mapping[str, float],
    units: Mapping[str, str],
    declared: Mapping[str, Mapping[str, Any]],
) -> str:
    """The metrics of one run; units, and what the scenario declares: by the names of the metrics."""
    return values_table(
        title, "Metric", {name: shown(value, declared[name]) for name, value in metrics.items()}, units
    )


def values_table(title: str, heading: str, values: Mapping[str, object], units: Mapping[str, str]) -> str:
    """Named values with their units in a column of its own."""
    rows = [(name, str(value), units.get(name, "")) for name, value in values.items()]
    return _table(title, (heading, "Value", "Unit"), rows)


def error_table(errors: Mapping[str, Mapping[str, float | None]], units: Mapping[str, str]) -> str:
    """Estimated errors of exchanging at communication points, as the provenance of a recording has them."""
    rows = []
    for name, error in errors.items():
        values = ("not known" if value is None else f"{value:.2g}" for value in error.values())
        rows.append((name, *values, units.get(name, "")))
    return _table("Estimated error", ("Signal", "Largest", "At the end", "Unit"), rows)


def _table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Columns: those of numbers, all but the first and the last, end at one place."""
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    lines = []
    for name, *numbers, unit in (headings, *rows):
        ends = (f"{number:>{width}}" for number, width in zip(numbers, widths[1:-1], strict=True))
        lines.append("  ".join((f"{name:<{widths[0]}}", *ends, unit)).rstrip())
    return "\n".join((title, *lines))
