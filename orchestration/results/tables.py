"""Tables of results for a terminal."""

from collections.abc import Mapping

from rich.markup import escape
from rich.table import Table


def metrics_table(title: str, metrics: Mapping[str, float], units: Mapping[str, str]) -> Table:
    """The metrics of one run; units: by the names of the metrics."""
    table = Table(title=escape(title), title_justify="left")
    table.add_column("Metric")
    table.add_column("Value", justify="right")
    table.add_column("Unit")
    for name, value in metrics.items():
        table.add_row(escape(name), f"{value:.5g}", escape(units.get(name, "")))
    return table
