"""Figures 3, 5 and 6 of the paper with their captions, from the recordings of a reproduction.

Every figure shows published and own numbers side by side. Panels (a) to (c) of figures 5 and 6 are the panels
of the paper (depth, control input, estimates); the tracking error, which the paper does not draw, comes last.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fmus.files import write_text_atomically
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
_TITLES = {
    "figure_3": "Illustrative example, L1 and extended L1",
    "figure_5": "Nominal conditions, L1 and extended L1",
    "figure_6": "Extended L1 in nominal conditions and with 0.2 N of buoyancy added",
}
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
    """Draws all three from the recordings and metrics of scenarios, by their names; returns the files.

    Beside each figure is its caption, NAME.md.
    """
    files = []
    for name, curves in _FIGURES.items():
        drawn = [DrawnRun(s, *curve, recordings[s], measured[s]) for s, curve in curves.items()]
        is_example = name == "figure_3"
        with figure_style():
            figure = _example_figure(drawn) if is_example else _vehicle_figure(drawn)
            files += write_figure(figure, folder / name, formats)
        panels = _EXAMPLE_PANELS if is_example else _vehicle_panels(drawn)
        text = f"# Figure {name[-1]}: {_TITLES[name]}\n\n{panels}"
        write_text_atomically(caption := folder / f"{name}.md", text)
        files.append(caption)
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
    heights_in = [1.9, 1.9, 1.0, 1.0, 1.3]
    figure, (depth, thrust, theta, sigma, error) = stacked_panels(heights_in, "Time [s]", letters="abc d")
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


_EXAMPLE_PANELS = """\
- (a) Output and reference.
- (b) Tracking error: output minus reference.
- (c) The error of the extended controller between -3 and 3. Its first 6 s leave the panel:
  the output starts at 0, 100 below the reference.

The note in (b) compares the last two periods with an independent calculation.
"""


def _vehicle_panels(curves: Sequence[DrawnRun]) -> str:
    """Returns the key of a figure of the vehicle, and why the thrust swings at first."""
    swings = []
    for curve in curves:
        early = curve.run[_THRUST][curve.run.time <= _SURFACE_END_S]
        swings.append(f"{early.min():.1f} to {early.max():.1f} N ({curve.label})")
    return f"""\
- (a) Depth, positive down. The grey band is 0.8 m with 5 % on each side.
  A circle marks the settling time of a run, a dotted vertical line the published time.
  Circles differ in size, so that circles in one place stay visible.
- (b) Thrust, the sum of the thrusters. Horizontal dotted lines: published holding thrust. Inset: first 20 s.
- (c) Estimates of the uncertainty: theta_hat in the upper panel, sigma_hat in the lower one.
- (d) Tracking error: depth minus reference. The paper does not draw it.

In (b) and (c) a line is the mean over {_NOISE_WINDOW_S:g} s, the pale band the range in that time.

**Why the thrust swings at first.** In the first {_SURFACE_END_S:g} s it is within
{" and ".join(swings)}.
The vehicle starts afloat at the surface. The part above water has no buoyancy. So buoyancy acts as a spring.
Spring and mass oscillate at about 1 Hz. Observer and thrusters delay the feedback,
which sustains the oscillation.
It is a limit cycle, not noise: with the true depth rate it vanishes.
Scenarios named ...-ideal use the true depth and depth rate.
The oscillation ends when the thrust holds the vehicle under water, where the spring is gone.
"""


def _finish_depth(panel: Axes, curves: Sequence[DrawnRun]) -> None:
    """Draws reference, settling band and settling times: circles of the runs, dotted lines of the paper."""
    run, reference = curves[0].run, {"label": "reference $z_r$", "color": "black", "linewidth": 0.6}
    draw_curve(panel, run.time, run[_REFERENCE], **reference)
    band = {"label": r"0.8 m $\pm$ 5 %", "color": GREY, "alpha": 0.25, "linewidth": 0.0}
    panel.fill_between([0.0, _BAND_END], _TARGET - _BAND, _TARGET + _BAND, **band)
    panel.plot([], [], ":", color=GREY, linewidth=0.8, label="paper")
    panel.plot([], [], "o", color=GREY, markersize=4.0, fillstyle="none", label="settled")
    # circles of two sizes, because settling times may coincide
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
