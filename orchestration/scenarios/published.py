"""The published figures, how scenarios map onto them, and the tables that compare them with ours.

Source: Maalouf, Chemori and Creuze (NOLCOS 2013): Tables 1 and 2, sections 5.2 and 5.3. The example has
no published figures: its oracles were computed independently (docs/fidelity.md).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isnan
from typing import TYPE_CHECKING

from orchestration.results.metric_units import MetricDocument, shown

if TYPE_CHECKING:
    from rich.table import Table

CONTROLLERS = {"l1": "L1", "extended": "extended L1"}
"""Name of a controller in the scenarios' names -> its name for readers."""
CASES = ("nominal", "buoyancy", "example")
"""The paper's experiments: the names of their scenarios begin with these."""


@dataclass(frozen=True)
class Published:
    """A reference value: where it stands, which scenario and metric reproduce it, its value."""

    where: str
    case: str
    controller: str
    metric: str
    label: str
    unit: str
    value: float
    status: str  # how ours came about: fitted, predicted, or computed from published numbers alone

    @property
    def scenario(self) -> str:
        return f"{self.case}-{self.controller}"


def _row(
    where: str, case: str, metric: str, label: str, unit: str, l1: float, extended: float, status: str
) -> list[Published]:
    return [
        Published(where, case, "l1", metric, label, unit, l1, status),
        Published(where, case, "extended", metric, label, unit, extended, status),
    ]


PUBLISHED = (
    *_row("Table 1", "nominal", "settling_time", "Settling time", "s", 65.0, 45.0, "fitted"),
    *_row("Table 1", "nominal", "rmse", "RMSE", "cm", 12.1, 4.35, "fitted"),
    *_row("Table 2", "buoyancy", "settling_time", "Settling time", "s", 68.0, 45.0, "predicted"),
    *_row("Table 2", "buoyancy", "rmse", "RMSE", "cm", 13.8, 4.86, "predicted"),
    *_row("Section 5.2", "nominal", "holding_thrust", "Holding thrust", "N", 1.2, 1.2, "W - B, drag"),
    Published(
        "Section 5.3", "buoyancy", "extended", "holding_thrust", "Holding thrust", "N", 1.4, "W - B, drag"
    ),
    *_row("Calculated, x(0) = 0", "example", "lag", "Lag", "s", 1.403, 0.048, "computed"),
    *_row("Calculated, x(0) = 0", "example", "rmse", "RMSE", "1", 19.80, 0.798, "computed"),
)
"""Published values and, for the example, independently calculated ones."""


def summary(metrics: Mapping[str, MetricDocument]) -> dict[str, dict[str, MetricDocument]]:
    """Returns {case: {controller: metrics with units}} of the paper's experiments, from the scenarios'."""
    return {
        case: {controller: metrics[f"{case}-{controller}"] for controller in CONTROLLERS} for case in CASES
    }


def comparison_table(measured: Mapping[str, Mapping[str, float]]) -> "Table":
    """Returns every reference value beside the value of the runs, with the deviation."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title="Published and reproduced", title_justify="left")
    for heading in ("Source", "Case", "Controller", "Metric", "Unit"):
        table.add_column(heading)
    for heading in ("Reference", "Here", "Deviation", "in %"):
        table.add_column(heading, justify="right")
    table.add_column("Basis")
    before = None
    for figure in PUBLISHED:
        ours = measured[figure.scenario][figure.metric]
        deviation = ours - figure.value
        if before not in (None, figure.where):
            table.add_section()
        before = figure.where
        table.add_row(
            figure.where,
            figure.case,
            CONTROLLERS[figure.controller],
            figure.label,
            escape(figure.unit),
            f"{figure.value:.4g}",
            shown(ours, {"function": figure.metric}, ".4g"),
            "" if isnan(ours) else f"{deviation:+.2g}",
            "" if isnan(ours) else f"{100.0 * deviation / figure.value:+.1f}",
            figure.status,
        )
    return table
