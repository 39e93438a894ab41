"""Tables of results for a terminal."""

from collections.abc import Mapping

from rich.markup import escape
from rich.table import Table


def metrics_table(title: str, metrics: Mapping[str, float], units: Mapping[str, str] | None = None) -> Table:
    """The metrics of one run; units: by the names of the metrics, no column without them."""
    table = Table(title=escape(title), title_justify="left")
    table.add_column("Metric")
    table.add_column("Value", justify="right")
    if units is not None:
        table.add_column("Unit")
    for name, value in metrics.items():
        unit = () if units is None else (escape(units.get(name, "")),)
        table.add_row(escape(name), f"{value:.5g}", *unit)
    return table
