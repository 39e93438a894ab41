"""Figures 3, 5 and 6 of the paper, drawn from the recordings of a reproduction.

Every figure shows the published numbers beside those of the run. Captions: docs/explanation/results.md.
"""

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
    draw_curve,
    draw_noisy,
    figure_style,
    stacked_panels,
    write_figure,
)
from orchestration.results.formats import FigureFormat
from orchestration.results.recording import Recording
from orchestration.scenarios.published import PUBLISHED

_DEPTH, _REFERENCE, _THRUST = "plant.depth", "controller.depth_reference", "plant.total_force"
_SETTLING, _RMSE, _HOLDING = "settling_time", "rmse", "holding_thrust"
_TARGET, _BAND, _BAND_END = 0.8, 0.04, 140.0  # m, m, s: 5 % of the first depth, while it is commanded
_NOISE_WINDOW_S = 1.0
_SURFACE_END_S = 20.0  # the oscillation at the surface is over

Measured = Mapping[str, Mapping[str, float]]
Recordings = Mapping[str, Recording]
Formats = Sequence[FigureFormat]


@dataclass(frozen=True)
class Curve:
    """One scenario in a figure."""

    scenario: str
    label: str
    line: Mapping[str, Any]


_PLAIN = {"color": BLUE, "linestyle": (0, (4, 1.5))}
_EXTENDED = {"color": ORANGE, "linestyle": "-"}
_BUOYANCY = {"color": GREEN, "linestyle": (0, (4, 1.5))}
_FIGURE_3 = (Curve("example-l1", "L1", _PLAIN), Curve("example-extended", "extended L1", _EXTENDED))
_FIGURE_5 = (Curve("nominal-l1", "L1", _PLAIN), Curve("nominal-extended", "extended L1", _EXTENDED))
_FIGURE_6 = (
    Curve("nominal-extended", "nominal", _EXTENDED),
    Curve("buoyancy-extended", "buoyancy +0.2 N", _BUOYANCY),
)


def figure_3(recordings: Recordings, measured: Measured, folder: Path, formats: Formats) -> list[Path]:
    """The illustrative example: output, tracking error, and the error of the extended controller alone."""
    with figure_style():
        figure, (outputs, errors, extended) = stacked_panels([1.8, 1.2, 1.2], "Time [s]")
        for curve in _FIGURE_3:
            run = recordings[curve.scenario]
            error = run["plant.output"] - run["controller.reference"]
            draw_curve(outputs, run.time, run["plant.output"], label=curve.label, **curve.line)
            draw_curve(errors, run.time, error, **curve.line)
            if curve.label == "extended L1":
                draw_curve(extended, run.time, error, **curve.line)
        run = recordings[_FIGURE_3[0].scenario]
        draw_curve(
            outputs,
            run.time,
            run["controller.reference"],
            label="reference $r$",
            color="black",
            linewidth=0.6,
        )
        outputs.set_ylim(-115.0, 170.0)
        outputs.set_ylabel("Output $y$ [1]")
        outputs.legend(loc="upper right", ncols=3)
        errors.set_ylabel("Error $y - r$ [1]")
        extended.set_ylabel("Error $y - r$ [1]")
        extended.set_ylim(-3.0, 3.0)
        numbers = zip(
            _rows("rmse", "RMSE {:.3g} ({:.3g})", _FIGURE_3, measured),
            _rows("lag", "lag {:.3f} s ({:.3f} s)", _FIGURE_3, measured),
            strict=True,
        )
        lines = [f"{curve.label}: {', '.join(pair)}" for curve, pair in zip(_FIGURE_3, numbers, strict=True)]
        _note(errors, "\n".join(("Last two periods, run (independent calculation):", "; ".join(lines))))
        return write_figure(figure, folder / "figure_3", formats)


def figure_5(recordings: Recordings, measured: Measured, folder: Path, formats: Formats) -> list[Path]:
    """Nominal conditions: plain and extended L1."""
    return _vehicle_figure("figure_5", _FIGURE_5, recordings, measured, folder, formats)


def figure_6(recordings: Recordings, measured: Measured, folder: Path, formats: Formats) -> list[Path]:
    """Extended L1 with and without the added buoyancy."""
    return _vehicle_figure("figure_6", _FIGURE_6, recordings, measured, folder, formats)


def _vehicle_figure(
    name: str,
    curves: Sequence[Curve],
    recordings: Recordings,
    measured: Measured,
    folder: Path,
    formats: Formats,
) -> list[Path]:
    with figure_style():
        figure, (depth, error, thrust, theta, sigma) = stacked_panels([1.9, 1.3, 1.9, 1.0, 1.0], "Time [s]")
        for curve in curves:
            run = recordings[curve.scenario]
            draw_curve(depth, run.time, run[_DEPTH], label=curve.label, **curve.line)
            draw_curve(error, run.time, 100.0 * (run[_DEPTH] - run[_REFERENCE]), **curve.line)
            draw_noisy(thrust, run.time, run[_THRUST], _NOISE_WINDOW_S, **curve.line)
            draw_noisy(theta, run.time, run["controller.theta_hat[1]"], _NOISE_WINDOW_S, **curve.line)
            draw_noisy(sigma, run.time, run["controller.sigma_hat"], _NOISE_WINDOW_S, **curve.line)
        _finish_depth(depth, curves, recordings[curves[0].scenario], measured)
        _finish_thrust(thrust, curves, recordings, measured)
        error.set_ylabel("Error $z - z_r$ [cm]")
        _compare(error, "RMSE", _RMSE, "{:.3g} cm ({:.3g} cm)", curves, measured)
        theta.set_ylabel(r"$\hat\theta$ [N]")
        sigma.set_ylabel(r"$\hat\sigma$ [N]")
        return write_figure(figure, folder / name, formats)


def _finish_depth(panel: Axes, curves: Sequence[Curve], run: Recording, measured: Measured) -> None:
    """Reference, settling band, and the settling times: circles of the runs, dotted lines of the paper."""
    draw_curve(panel, run.time, run[_REFERENCE], label="reference $z_r$", color="black", linewidth=0.6)
    panel.fill_between(
        [0.0, _BAND_END], _TARGET - _BAND, _TARGET + _BAND, color=GREY, alpha=0.25, linewidth=0.0,
        label=r"0.8 m $\pm$ 5 %",
    )  # fmt: skip
    panel.plot([], [], ":", color=GREY, linewidth=0.8, label="paper")
    panel.plot([], [], "o", color=GREY, markersize=4.0, fillstyle="none", label="settled")
    for size, curve in zip((6.0, 3.0), curves, strict=True):  # of circles that may coincide
        colour, settled = curve.line["color"], measured[curve.scenario][_SETTLING]
        panel.axvline(_published(curve.scenario, _SETTLING), color=colour, linewidth=0.8, linestyle=":")
        panel.plot(settled, _TARGET - _BAND, "o", color=colour, markersize=size, fillstyle="none", zorder=3)
    panel.set_ylim(1.02, -0.05)  # depth points down
    panel.set_ylabel("Depth $z$ [m]")
    panel.legend(loc="upper right", ncols=2)
    _compare(panel, "Settling time", _SETTLING, "{:.1f} s ({:g} s)", curves, measured)


def _finish_thrust(panel: Axes, curves: Sequence[Curve], recordings: Recordings, measured: Measured) -> None:
    """The published holding thrust, and the oscillation at the surface in a window of its own."""
    inset = panel.inset_axes((0.16, 0.29, 0.45, 0.36))
    for curve in curves:
        published, run = _published(curve.scenario, _HOLDING), recordings[curve.scenario]
        panel.axhline(published, color=curve.line["color"], linewidth=0.8, linestyle=":")
        early = run.time <= _SURFACE_END_S
        draw_curve(inset, run.time[early], run[_THRUST][early], linewidth=0.6, **curve.line)
    inset.margins(x=0.0)
    inset.set_xticks((0, 5, 10, 15, 20), ("0", "5", "10", "15", "20 s"))
    inset.tick_params(labelsize=7.0, pad=1.5)
    panel.set_ylim(bottom=-1.2)
    panel.set_ylabel("Thrust [N]")
    _compare(panel, "Holding thrust", _HOLDING, "{:.2f} N ({:g} N)", curves, measured)


def _published(scenario: str, metric: str) -> float:
    (value,) = (row.value for row in PUBLISHED if (row.scenario, row.metric) == (scenario, metric))
    return value


def _rows(metric: str, text: str, curves: Sequence[Curve], measured: Measured) -> list[str]:
    """For each curve the text with the number of the run and the published one."""
    return [
        text.format(measured[curve.scenario][metric], _published(curve.scenario, metric)) for curve in curves
    ]


def _compare(
    panel: Axes, name: str, metric: str, text: str, curves: Sequence[Curve], measured: Measured
) -> None:
    rows = zip(curves, _rows(metric, text, curves, measured), strict=True)
    _note(panel, f"{name}, run (paper): {'; '.join(f'{curve.label} {row}' for curve, row in rows)}")


def _note(panel: Axes, text: str) -> None:
    """A text in the lower right corner."""
    panel.annotate(
        text,
        (1.0, 0.0),
        (-6.0, 5.0),
        "axes fraction",
        "offset points",
        horizontalalignment="right",
        verticalalignment="bottom",
        fontsize=8.0,
    )
