"""Tables of results for a terminal."""

from collections.abc import Mapping
from typing import Any

from rich.markup import escape
from rich.table import Table

from orchestration.results.metric_units import shown


def metrics_table(
    title: str,
    metrics: Mapping[str, float],
    units: Mapping[str, str],
    declared: Mapping[str, Mapping[str, Any]],
) -> Table:
    """The metrics of one run; units, and what the scenario declares: by the names of the metrics."""
    return values_table(
        title, "Metric", {name: shown(value, declared[name]) for name, value in metrics.items()}, units
    )


def values_table(title: str, heading: str, values: Mapping[str, object], units: Mapping[str, str]) -> Table:
    """Named values with their units in a column of its own."""
    table = Table(title=escape(title), title_justify="left")
    table.add_column(heading)
    table.add_column("Value", justify="right")
    table.add_column("Unit")
    for name, value in values.items():
        table.add_row(escape(name), escape(str(value)), escape(units.get(name, "")))
    return table


def error_table(errors: Mapping[str, Mapping[str, float | None]], units: Mapping[str, str]) -> Table:
    """Estimated errors of exchanging at communication points, as the provenance of a recording has them."""
    table = Table(title="Estimated error", title_justify="left")
    table.add_column("Signal")
    table.add_column("Largest", justify="right")
    table.add_column("At the end", justify="right")
    table.add_column("Unit")
    for name, error in errors.items():
        values = ("not known" if value is None else f"{value:.2g}" for value in error.values())
        table.add_row(escape(name), *values, escape(units.get(name, "")))
    return table
