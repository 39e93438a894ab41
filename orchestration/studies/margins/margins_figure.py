"""Bode and Nyquist diagrams of a linear loop with its margins."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from orchestration.results.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    WIDTH_IN,
    ShownFigure,
    figure_style,
    write_figure,
)
from orchestration.results.formats import FigureFormat
from orchestration.studies.margins.linear_margins import LinearLoop, LinearMargins, margins

_HEIGHT_IN, _DPI = 4.2, 200
_BEYOND = 30.0  # the range of frequencies ends at this ratio to the lowest and the highest one that is marked
_COUNT = 2000
# of the Nyquist diagram about 0: the smallest gain of a loop with integrators lies hundreds of times farther
_REACH = 2.0


def write_margins_figure(title: str, name: str, loop: LinearLoop, path: Path) -> Path:
    """Writes `margins_figure` as `path`.png; returns the file."""
    with figure_style():
        (file,) = write_figure(margins_figure(title, name, loop), path, [FigureFormat.PNG], _DPI)
    return file


def margins_figure(title: str, name: str, loop: LinearLoop) -> ShownFigure:
    """Returns the Bode and Nyquist diagrams of -L(j w), whose critical point is -1, with the margins marked.

    name: of the loop, as tables have it. An unstable loop has no marks.
    """
    known = margins(loop)
    marks = _marks(known)
    marked = [frequency for frequency, *_ in marks] or [1.0]
    frequencies = np.geomspace(min(marked) / _BEYOND, max(marked) * _BEYOND, _COUNT)
    # L closes the loop where it is 1: the diagrams have the sign of negative feedback
    response: Any = -loop.response(frequencies)
    with figure_style():
        figure = ShownFigure(figsize=(WIDTH_IN, _HEIGHT_IN), layout="constrained")
        axes: Any = figure.subplot_mosaic([["gain", "nyquist"], ["phase", "nyquist"]], width_ratios=[1.1, 1])
        figure.suptitle(f"{title}: linear loop, {name}", wrap=True)
        gain, phase, nyquist = (axes[panel] for panel in ("gain", "phase", "nyquist"))
        phases = _phases(frequencies, response, known)
        gain.semilogx(frequencies, _decibels(np.abs(response)), color=BLUE)
        phase.semilogx(frequencies, phases, color=BLUE)
        nyquist.plot(response.real, response.imag, color=BLUE)
        nyquist.plot(response.real, -response.imag, color=BLUE, linestyle=":", linewidth=0.7)
        circle: Any = np.exp(1j * np.linspace(0.0, 2.0 * math.pi, 361))
        nyquist.plot(circle.real, circle.imag, color=GREY, linestyle="--", linewidth=0.6)
        nyquist.plot(-1.0, 0.0, "+", color="black", markersize=9.0, label="critical point -1")
        for frequency, label, color, marker in marks:
            value = -loop.response(frequency)
            beyond = ", beyond the Nyquist diagram" if abs(value) > _REACH else ""
            style = {"color": color, "marker": marker, "linestyle": "none", "markersize": 5.0}
            gain.plot(frequency, _decibels(abs(value)), **style)
            phase.plot(frequency, np.interp(frequency, frequencies, phases), **style)
            nyquist.plot(value.real, value.imag, label=label + beyond, **style)
            for panel in (gain, phase):
                panel.axvline(frequency, color=color, linewidth=0.6, linestyle=":")
        gain.axhline(0.0, color=GREY, linewidth=0.6, linestyle="--")
        phase.axhline(-180.0, color=GREY, linewidth=0.6, linestyle="--")
        phase.set_yticks(np.arange(90.0 * math.floor(phases.min() / 90.0), phases.max() + 90.0, 90.0))
        gain.set_ylabel("Gain [dB]")
        phase.set_ylabel("Phase [deg]")
        phase.set_xlabel("Frequency [rad/s]")
        nyquist.set(xlabel="Real part [1]", ylabel="Imaginary part [1]")
        nyquist.set(xlim=(-_REACH, _REACH), ylim=(-_REACH, _REACH))
        nyquist.set_aspect("equal")
        figure.legend(*nyquist.get_legend_handles_labels(), loc="outside lower center", ncols=2)
    return figure


def _phases(frequencies: np.ndarray, response: np.ndarray, known: LinearMargins) -> np.ndarray:
    """Returns the phases [deg], turned so that they are the phase margin above -180 deg at its frequency."""
    phases = np.degrees(np.unwrap(np.angle(response)))
    if not math.isfinite(known.phase):
        return phases
    crossing = np.interp(known.frequency, frequencies, phases)
    return phases - 360.0 * round((crossing + 180.0 - math.degrees(known.phase)) / 360.0)


def _marks(known: LinearMargins) -> list[tuple[float, str, str, str]]:
    """Returns frequency [rad/s], label, colour and marker of each margin that the loop has."""
    delay = f"{known.delay:.4g} s, phase margin {math.degrees(known.phase):.3g} deg"
    high, low = (f"{gain:.4g}" for gain in (known.high_gain, known.low_gain))
    marks = [
        (known.frequency, f"delay margin {delay} at {known.frequency:.3g} rad/s", ORANGE, "o"),
        (known.high_frequency, f"largest gain {high} at {known.high_frequency:.3g} rad/s", GREEN, "^"),
        (known.low_frequency, f"smallest gain {low} at {known.low_frequency:.3g} rad/s", "#CC79A7", "v"),
    ]
    return [mark for mark in marks if math.isfinite(mark[0])]


def _decibels(gain: Any) -> Any:
    return 20.0 * np.log10(gain)
