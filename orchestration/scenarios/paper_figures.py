"""Figures 3, 5 and 6 of the paper, drawn from the recordings of a reproduction.

Every figure shows the published numbers beside the run's. Captions: docs/explanation/results.md.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestration.results.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    Axes,
    Figure,
    draw_curve,
    draw_noisy,
    figure_style,
    stacked_panels,
    write_figure,
)
from orchestration.results.formats import FigureFormat
from orchestration.results.metric_units import shown
from orchestration.results.recording import Recording
from orchestration.scenarios.published import PUBLISHED

_DEPTH, _REFERENCE, _THRUST = "plant.depth", "controller.depth_reference", "plant.total_force"
_SETTLING, _RMSE, _HOLDING = "settling_time", "rmse", "holding_thrust"
_TARGET, _BAND, _BAND_END = 0.8, 0.04, 140.0  # m, m, s: 5 % of the first depth, while it is commanded
_NOISE_WINDOW_S = 1.0
_SURFACE_END_S = 20.0  # the oscillation at the surface is over

Formats = Sequence[FigureFormat]


@dataclass(frozen=True)
class DrawnRun:
    """The run of one scenario in a figure: how it is drawn, its recording and its metrics."""

    scenario: str
    label: str
    line: Mapping[str, Any]
    run: Recording
    measured: Mapping[str, float]

    def published(self, metric: str) -> float:
        (value,) = (row.value for row in PUBLISHED if (row.scenario, row.metric) == (self.scenario, metric))
        return value


_PLAIN = ("L1", {"color": BLUE, "linestyle": (0, (4, 1.5))})
_EXTENDED = ("extended L1", {"color": ORANGE, "linestyle": "-"})
_FIGURES: dict[str, dict[str, tuple[str, Mapping[str, Any]]]] = {
    "figure_3": {"example-l1": _PLAIN, "example-extended": _EXTENDED},
    "figure_5": {"nominal-l1": _PLAIN, "nominal-extended": _EXTENDED},
    "figure_6": {
        "nominal-extended": ("nominal", _EXTENDED[1]),
        "buoyancy-extended": ("buoyancy +0.2 N", {"color": GREEN, "linestyle": (0, (4, 1.5))}),
    },
}


def write_figures(
    recordings: Mapping[str, Recording],
    measured: Mapping[str, Mapping[str, float]],
    folder: Path,
    formats: Formats,
) -> list[Path]:
    """Draws all three from the recordings and metrics of scenarios, by their names; returns the files."""
    files = []
    for name, curves in _FIGURES.items():
        drawn = [DrawnRun(s, *curve, recordings[s], measured[s]) for s, curve in curves.items()]
        draw = _example_figure if name == "figure_3" else _vehicle_figure
        with figure_style():
            files += write_figure(draw(drawn), folder / name, formats)
    return files


def _example_figure(curves: Sequence[DrawnRun]) -> Figure:
    """Draws the illustrative example: output, tracking error, and the extended controller's error alone."""
    figure, (outputs, errors, extended) = stacked_panels([1.8, 1.2, 1.2], "Time [s]")
    for curve in curves:
        run = curve.run
        error = run["plant.output"] - run["controller.reference"]
        draw_curve(outputs, run.time, run["plant.output"], label=curve.label, **curve.line)
        draw_curve(errors, run.time, error, **curve.line)
        if curve.label == "extended L1":
            draw_curve(extended, run.time, error, **curve.line)
    run = curves[0].run
    reference = {"label": "reference $r$", "color": "black", "linewidth": 0.6}
    draw_curve(outputs, run.time, run["controller.reference"], **reference)
    outputs.set_ylim(-115.0, 170.0)
    outputs.set_ylabel("Output $y$ [1]")
    outputs.legend(loc="upper right", ncols=3)
    errors.set_ylabel("Error $y - r$ [1]")
    extended.set_ylabel("Error $y - r$ [1]")
    extended.set_ylim(-3.0, 3.0)
    texts = {"rmse": "RMSE {:.3g} ({:.3g})", "lag": "lag {:.3f} s ({:.3f} s)"}
    lines = []
    for curve in curves:
        pair = (text.format(curve.measured[name], curve.published(name)) for name, text in texts.items())
        lines.append(f"{curve.label}: {', '.join(pair)}")
    _note(errors, f"Last two periods, run (independent calculation):\n{'; '.join(lines)}")
    return figure


def _vehicle_figure(curves: Sequence[DrawnRun]) -> Figure:
    figure, (depth, error, thrust, theta, sigma) = stacked_panels([1.9, 1.3, 1.9, 1.0, 1.0], "Time [s]")
    for curve in curves:
        run = curve.run
        draw_curve(depth, run.time, run[_DEPTH], label=curve.label, **curve.line)
        draw_curve(error, run.time, 100.0 * (run[_DEPTH] - run[_REFERENCE]), **curve.line)
        draw_noisy(thrust, run.time, run[_THRUST], _NOISE_WINDOW_S, **curve.line)
        draw_noisy(theta, run.time, run["controller.theta_hat[1]"], _NOISE_WINDOW_S, **curve.line)
        draw_noisy(sigma, run.time, run["controller.sigma_hat"], _NOISE_WINDOW_S, **curve.line)
    _finish_depth(depth, curves)
    _finish_thrust(thrust, curves)
    error.set_ylabel("Error $z - z_r$ [cm]")
    _compare(error, "RMSE", _RMSE, ".3g", "cm", curves)
    theta.set_ylabel(r"$\hat\theta$ [N]")
    sigma.set_ylabel(r"$\hat\sigma$ [N]")
    return figure


def _finish_depth(panel: Axes, curves: Sequence[DrawnRun]) -> None:
    """Draws reference, settling band and settling times: circles of the runs, dotted lines of the paper."""
    run, reference = curves[0].run, {"label": "reference $z_r$", "color": "black", "linewidth": 0.6}
    draw_curve(panel, run.time, run[_REFERENCE], **reference)
    band = {"label": r"0.8 m $\pm$ 5 %", "color": GREY, "alpha": 0.25, "linewidth": 0.0}
    panel.fill_between([0.0, _BAND_END], _TARGET - _BAND, _TARGET + _BAND, **band)
    panel.plot([], [], ":", color=GREY, linewidth=0.8, label="paper")
    panel.plot([], [], "o", color=GREY, markersize=4.0, fillstyle="none", label="settled")
    # two sizes: the circles of the runs may coincide
    for size, curve in zip((6.0, 3.0), curves, strict=True):
        colour, settled = curve.line["color"], curve.measured[_SETTLING]
        panel.axvline(curve.published(_SETTLING), color=colour, linewidth=0.8, linestyle=":")
        panel.plot(settled, _TARGET - _BAND, "o", color=colour, markersize=size, fillstyle="none", zorder=3)
    # the upper end first: depth points down
    panel.set_ylim(1.02, -0.05)
    panel.set_ylabel("Depth $z$ [m]")
    panel.legend(loc="upper right", ncols=2)
    _compare(panel, "Settling time", _SETTLING, ".1f", "s", curves)


def _finish_thrust(panel: Axes, curves: Sequence[DrawnRun]) -> None:
    """Draws the published holding thrust, and the oscillation at the surface in an inset."""
    inset = panel.inset_axes((0.16, 0.29, 0.45, 0.36))
    for curve in curves:
        panel.axhline(curve.published(_HOLDING), color=curve.line["color"], linewidth=0.8, linestyle=":")
        early = curve.run.time <= _SURFACE_END_S
        draw_curve(inset, curve.run.time[early], curve.run[_THRUST][early], linewidth=0.6, **curve.line)
    inset.margins(x=0.0)
    inset.set_xticks((0, 5, 10, 15, 20), ("0", "5", "10", "15", "20 s"))
    inset.tick_params(labelsize=7.0, pad=1.5)
    panel.set_ylim(bottom=-1.2)
    panel.set_ylabel("Thrust [N]")
    _compare(panel, "Holding thrust", _HOLDING, ".2f", "N", curves)


def _compare(panel: Axes, name: str, metric: str, digits: str, unit: str, curves: Sequence[DrawnRun]) -> None:
    """Writes a note of the metric in each run and as published."""
    rows = []
    for curve in curves:
        value = curve.measured[metric]
        # metrics of the paper are named like their functions
        text = shown(value, {"function": metric}, digits)
        result = text if math.isnan(value) else f"{text} {unit}"
        rows.append(f"{curve.label} {result} ({curve.published(metric):g} {unit})")
    _note(panel, f"{name}, run (paper): {'; '.join(rows)}")


def _note(panel: Axes, text: str) -> None:
    """Writes a text in the lower right corner."""
    alignment: Any = {"horizontalalignment": "right", "verticalalignment": "bottom"}
    panel.annotate(text, (1.0, 0.0), (-6.0, 5.0), "axes fraction", "offset points", fontsize=8.0, **alignment)
