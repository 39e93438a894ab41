"""The tables of the paper, reproduced: every published figure beside ours."""

from collections.abc import Mapping
from math import isnan

from rich.markup import escape
from rich.table import Table

from orchestration.results.metric_units import MetricDocument, shown
from orchestration.scenarios.published import CASES, CONTROLLERS, PUBLISHED

Measured = Mapping[str, Mapping[str, float]]


def summary(metrics: Mapping[str, MetricDocument]) -> dict[str, dict[str, MetricDocument]]:
    """Returns {case: {controller: metrics with units}} of the paper's experiments, from the scenarios'."""
    return {
        case: {controller: metrics[f"{case}-{controller}"] for controller in CONTROLLERS} for case in CASES
    }


def comparison_table(measured: Measured) -> Table:
    """Returns every published figure beside ours, with the deviation."""
    table = Table(title="Published and reproduced", title_justify="left")
    for heading in ("Source", "Case", "Controller", "Figure", "Unit"):
        table.add_column(heading)
    for heading in ("Reference", "Ours", "Deviation", "in %"):
        table.add_column(heading, justify="right")
    table.add_column("Ours is")
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
