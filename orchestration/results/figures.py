"""Figures as a journal prints them: panels, curves, files. The only module that imports Matplotlib.

It uses Matplotlib's figure classes and a style of its own for each figure, so that neither pyplot nor the
settings of the caller are touched. The same data give the same file, byte by byte.
"""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fmus.files import open_atomically
from orchestration.results.formats import FigureFormat
from orchestration.results.recording import ERROR_ESTIMATE, Recording, points_down

BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"  # told apart by colour-blind readers
_COLOURS = (BLUE, ORANGE, GREEN, "#CC79A7", "#E69F00", "#56B4E9", "#000000")
_LINES = ("-", "--", "-.", ":")
_WIDTH_IN = 7.16  # both columns of an IEEE or IFAC page
_DPI = 300
_BINS = 1200  # of a dense curve: about two pixels each
_METADATA: dict[FigureFormat, dict[str, Any]] = {
    FigureFormat.PNG: {"Software": None},
    FigureFormat.PDF: {"CreationDate": None, "Producer": None, "Creator": None},
    FigureFormat.SVG: {"Date": None},
}


def figure_style() -> AbstractContextManager[None]:
    """A context: figures that are made and written inside it have the style of this module."""
    return style.context(["default", str(Path(__file__).with_name("figures.mplstyle"))])


def stacked_panels(heights_in: Sequence[float], x_label: str) -> tuple[Figure, list[Axes]]:
    """A figure as wide as a page: panels (a), (b), ... one below the other, with one horizontal axis."""
    figure = Figure(figsize=(_WIDTH_IN, sum(heights_in) + 0.4), layout="constrained")
    grid = figure.subplots(
        len(heights_in), 1, sharex=True, squeeze=False, gridspec_kw={"height_ratios": heights_in}
    )
    panels = list(grid[:, 0])
    for index, panel in enumerate(panels):
        panel.margins(x=0.0)
        letter = chr(ord("a") + index)
        panel.annotate(
            f"({letter})", (0.0, 1.0), (-36.0, 4.0), "axes fraction", "offset points", fontweight="bold"
        )
    panels[-1].set_xlabel(x_label)
    figure.align_ylabels()
    return figure, panels


def panel_grid(rows: int, columns: int, height_in: float) -> tuple[Figure, list[Axes]]:
    """A figure as wide as a page: panels (a), (b), ... row by row, each with axes of its own."""
    figure = Figure(figsize=(_WIDTH_IN, rows * height_in), layout="constrained")
    panels = list(figure.subplots(rows, columns, squeeze=False).flat)
    for index, panel in enumerate(panels):
        panel.set_title(f"({chr(ord('a') + index)})", loc="left", fontsize=9.0, fontweight="bold")
    return figure, panels


def draw_curve(panel: Axes, time: np.ndarray, values: np.ndarray, **line: Any) -> None:
    """A signal as a line through the smallest and the largest value of each of many short intervals."""
    chosen = _extremes(values)
    panel.plot(time[chosen], values[chosen], **line)


def _extremes(values: np.ndarray) -> np.ndarray:
    """Indices, ascending, of the first, the last, and each interval's smallest and largest value."""
    if len(values) <= 2 * _BINS:
        return np.arange(len(values))
    edges = np.linspace(0, len(values), _BINS + 1).astype(int)
    pairs = [
        (low + values[low:high].argmin(), low + values[low:high].argmax()) for low, high in pairwise(edges)
    ]
    return np.unique(np.append(np.ravel(pairs), (0, len(values) - 1)))


def draw_noisy(panel: Axes, time: np.ndarray, values: np.ndarray, window: float, **line: Any) -> None:
    """A noisy signal as the mean and, shaded, the range of its values over a sliding window [s].

    The signal is sampled at equal intervals; at its ends the window holds the first or last value.
    """
    half = round(0.5 * window / (time[1] - time[0]))
    step = max(1, len(values) // _BINS)
    padded = np.pad(values, half, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)[::step]
    shade = {"color": line.get("color"), "alpha": 0.25, "linewidth": 0.0}
    panel.fill_between(time[::step], windows.min(axis=1), windows.max(axis=1), **shade)
    panel.plot(time[::step], windows.mean(axis=1), **line)


def write_figure(figure: Figure, path: Path, formats: Sequence[FigureFormat]) -> list[Path]:
    """Write `path` with the ending of each format; returns the files."""
    files = [path.with_name(f"{path.name}.{ending}") for ending in formats]
    for file, ending in zip(files, formats, strict=True):
        with open_atomically(file) as stream:
            figure.savefig(stream, format=ending, dpi=_DPI, metadata=_METADATA[ending])
    return files


def run_figure(
    title: str, recording: Recording, path: Path, formats: Sequence[FigureFormat] = (FigureFormat.PNG,)
) -> list[Path]:
    """Every signal of any run that is a number, one panel for each unit; without estimates of errors."""
    signals = [name for name in recording.numbers if not name.startswith(ERROR_ESTIMATE)]
    units = list(dict.fromkeys(map(recording.unit, signals)))
    with figure_style():
        figure, panels = stacked_panels([1.5] * len(units), "Time [s]")
        figure.suptitle(title)
        for unit, panel in zip(units, panels, strict=True):
            names = [name for name in signals if recording.unit(name) == unit]
            for index, name in enumerate(sorted(names, key=lambda name: -_roughness(recording[name]))):
                draw_curve(
                    panel,
                    recording.time,
                    recording[name],
                    label=name,
                    linewidth=0.7,
                    color=_COLOURS[index % len(_COLOURS)],
                    linestyle=_LINES[index // len(_COLOURS) % len(_LINES)],
                )
            if any(points_down(name, unit) for name in names):
                panel.invert_yaxis()
            panel.set_ylabel(f"[{unit or '1'}]")
            panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02))
        return write_figure(figure, path, formats)


def _roughness(values: np.ndarray) -> float:
    """Sum of changes: smooth signals are drawn last, over rough ones."""
    return float(np.abs(np.diff(values)).sum())
