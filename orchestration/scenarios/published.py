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
ALL_FIGURES = "-all-figures"
"""End of the name of a scenario with the gains that were fitted to the eight figures of both tables."""


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
    *_row("Section 5.2", "nominal", "holding_thrust", "Holding thrust", "N", 1.2, 1.2, "W - B"),
    Published("Section 5.3", "buoyancy", "extended", "holding_thrust", "Holding thrust", "N", 1.4, "W - B"),
    *_row("Calculated", "example", "lag", "Lag", "s", 1.403, 0.048, "computed"),
    *_row("Calculated", "example", "rmse", "RMSE", "1", 19.80, 0.798, "computed"),
)
"""Published values and, for the example, independently calculated ones."""


def summary(metrics: Mapping[str, MetricDocument]) -> dict[str, dict[str, MetricDocument]]:
    """Returns {case: {controller: metrics with units}} of the paper's experiments, from the scenarios'.

    A controller whose name ends in `ALL_FIGURES` is the same one with the gains of that fit.
    """
    names = [controller + fit for fit in ("", ALL_FIGURES) for controller in CONTROLLERS]
    return {
        case: {name: metrics[f"{case}-{name}"] for name in names if f"{case}-{name}" in metrics}
        for case in CASES
    }


def comparison_table(measured: Mapping[str, Mapping[str, float]]) -> "Table":
    """Returns reference values, each beside the value of the run with the gains of each fit.

    A run's value has its deviation and how it came about.
    """
    from rich.markup import escape
    from rich.table import Table

    table = Table(title="Published and reproduced", title_justify="left")
    for heading in ("Source", "Case", "Controller", "Metric"):
        table.add_column(heading)
    table.add_column("Reference", justify="right")
    table.add_column("Gains fitted to nominal")
    table.add_column("Gains fitted to all eight")
    before = None
    for figure in PUBLISHED:
        if before not in (None, figure.where):
            table.add_section()
        before = figure.where
        # the gains of the example are published: nothing is fitted
        of_all = measured.get(figure.scenario + ALL_FIGURES)
        status = "fitted" if figure.status == "predicted" else figure.status
        table.add_row(
            figure.where,
            figure.case,
            CONTROLLERS[figure.controller],
            escape(f"{figure.label} [{figure.unit}]"),
            f"{figure.value:.4g}",
            _beside(figure, measured[figure.scenario], figure.status),
            _beside(figure, of_all, status) if of_all else "",
        )
    return table


def _beside(figure: Published, metrics: Mapping[str, float], status: str) -> str:
    """Returns the value of a run, its deviation from the reference value, and how it came about."""
    ours = metrics[figure.metric]
    deviation = "" if isnan(ours) else f"{100.0 * (ours / figure.value - 1.0):+.1f} %"
    return f"{shown(ours, {'function': figure.metric}, '.4g'):>7} {deviation:>7} {status}"
