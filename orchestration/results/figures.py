"""Figures as a journal prints them: panels, curves, files. The only module that imports Matplotlib.

It uses Matplotlib's figure classes and a style file, so that pyplot and the settings of the caller stay as
they are. The same data give the same file, byte by byte.
"""

import io
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from string import ascii_lowercase
from typing import Any, BinaryIO

import numpy as np

from fmus.extras import imports_of
from fmus.files import open_atomically
from orchestration.results.files import ERROR_ESTIMATE, Columns
from orchestration.results.formats import FigureFormat
from orchestration.results.panels import drawn_points, panels_of

with imports_of("figures", "a figure"):
    from matplotlib import style
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg, RendererAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import LayoutEngine
    from matplotlib.transforms import ScaledTranslation

# Colour-blind readers distinguish these (Okabe and Ito).
BLUE, ORANGE, GREEN, GREY = "#0072B2", "#D55E00", "#009E73", "#666666"
_COLOURS = (BLUE, ORANGE, GREEN, "#CC79A7", "#E69F00", "#56B4E9", "#000000")
LINES = ("-", "--", "-.", ":")
MARKERS = "osD^v<>ph*PX8dHx+"  # one for each control law of the score protocol
WIDTH_IN = 7.16  # both columns of an IEEE or IFAC page
_DPI, _DPI_OF_RUNS, _DPI_IN_A_NOTEBOOK = 300, 200, 100  # print, screen, notebook
_GAP_IN = 0.24  # between panels: room for their letters
_PAD_IN = 0.05  # around everything, and between the numbers of an axis and its label
_MOST_BESIDE = 0.5  # largest share of the width of a figure for legends beside its panels
# Z_RLE of zlib: files of lines on white are as small as with the default, and written faster.
_RUN_LENGTHS = 3
_PANEL_IN, _LEGEND_LINE_IN = 1.5, 0.22  # heights with their margins
_BINS = 1200  # of a dense curve: about two pixels each
# Sum of changes by range of a wave of 25 periods: a thick line of more periods fills an area.
_ROUGH = 50.0
_METADATA: dict[FigureFormat, dict[str, Any]] = {
    FigureFormat.PNG: {"Software": None},
    FigureFormat.PDF: {"CreationDate": None, "Producer": None, "Creator": None},
    FigureFormat.SVG: {"Date": None},
}


def figure_style() -> AbstractContextManager[None]:
    """Returns a context; figures that are made and written inside it have the style of this module."""
    return style.context(["default", str(Path(__file__).with_name("figures.mplstyle"))])


class ShownFigure(Figure):
    """A figure that a notebook shows, with and without pyplot."""

    def _repr_png_(self) -> bytes:
        stream = io.BytesIO()
        with figure_style():
            _write_png(self, stream, _DPI_IN_A_NOTEBOOK)
        return stream.getvalue()


class StackedLayout(LayoutEngine):
    """A layout of panels one below the other, with room for the texts outside of them."""

    # Matplotlib's own layouts measure every text several times, which takes longer than to draw it.
    _adjust_compatible = _colorbar_gridspec = True  # required of every layout of Matplotlib

    def execute(self, fig: Figure) -> None:
        renderer, (width, height) = RendererAgg(1, 1, fig.dpi), fig.get_size_inches()
        numbers, labels, right, bottom = (length / fig.dpi for length in _outside(fig.axes, renderer))
        # as far left of all panels, so that the labels stand one below the other
        offset = ScaledTranslation(-numbers - _PAD_IN, 0.0, fig.dpi_scale_trans)
        for panel in fig.axes:
            panel.yaxis.set_label_coords(0.0, 0.5, panel.transAxes + offset)
        left, right = numbers + labels + 2.0 * _PAD_IN, min(right + _PAD_IN, _MOST_BESIDE * width)
        top, bottom = _PAD_IN + _GAP_IN, bottom + _PAD_IN
        for title in fig.texts:
            title.set_y(1.0 - _PAD_IN / height)
            top += title.get_window_extent(renderer).height / fig.dpi
        gaps = (len(fig.axes) - 1) * _GAP_IN
        mean_panel = (height - top - bottom - gaps) / len(fig.axes)
        fig.subplots_adjust(
            left / width,
            bottom / height,
            1.0 - right / width,
            1.0 - top / height,
            hspace=_GAP_IN / mean_panel,
        )


def _outside(panels: Sequence[Axes], renderer: RendererAgg) -> tuple[float, float, float, float]:
    """Returns the room [pixels] that texts need outside of panels: numbers, labels, at the right, below."""
    below: Any = panels[-1].xaxis.get_tightbbox(renderer)
    frame = panels[-1].bbox
    numbers = [text for panel in panels for text in panel.yaxis.get_majorticklabels()]
    labels = [panel.yaxis.label.get_window_extent(renderer).width for panel in panels]
    legends = [legend for panel in panels if (legend := panel.get_legend())]
    right = max([frame.x1, below.x1, *(legend.get_window_extent(renderer).x1 for legend in legends)])
    left = min(text.get_window_extent(renderer).x0 for text in numbers)
    return frame.x0 - left, max(labels), right - frame.x1, frame.y0 - below.y0


def stacked_panels(
    heights_in: Sequence[float], x_label: str, letters: str = ascii_lowercase
) -> tuple[ShownFigure, list[Axes]]:
    """Returns a figure as wide as a page: panels one below the other, on one time axis.

    letters: of the panels; a panel whose letter is a space belongs to the one above
    """
    figure = ShownFigure(figsize=(WIDTH_IN, sum(heights_in) + 0.4), layout=StackedLayout())
    shape: Any = {"nrows": len(heights_in), "squeeze": False, "height_ratios": heights_in}
    panels = list(figure.subplots(sharex=True, **shape)[:, 0])
    for panel in panels:
        panel.margins(x=0.0)
    for letter, panel in zip(letters, panels, strict=False):
        if letter != " ":
            panel.annotate(
                f"({letter})", (0.0, 1.0), (-36.0, 4.0), "axes fraction", "offset points", fontweight="bold"
            )
    panels[-1].set_xlabel(x_label)
    return figure, panels


def draw_curve(panel: Axes, time: np.ndarray, values: np.ndarray, **line: Any) -> None:
    """Draws a line through the smallest and the largest value of each of many short intervals."""
    chosen = drawn_points(time, values, _BINS)
    panel.plot(time[chosen], values[chosen], **line)


def draw_noisy(panel: Axes, time: np.ndarray, values: np.ndarray, window: float, **line: Any) -> None:
    """Draws a noisy signal as the mean and, shaded, the range of its values over a sliding window [s].

    The signal is sampled at equal intervals; at its ends the window holds the first or last value.
    """
    half = round(0.5 * window / (time[1] - time[0]))
    step = max(1, len(values) // _BINS)
    padded = np.pad(values, half, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1)[::step]
    shade = {"color": line.get("color"), "alpha": 0.25, "linewidth": 0.0}
    panel.fill_between(time[::step], windows.min(axis=1), windows.max(axis=1), **shade)
    panel.plot(time[::step], windows.mean(axis=1), **line)


def write_figure(
    figure: Figure, path: Path, formats: Sequence[FigureFormat], dots_per_inch: int = _DPI
) -> list[Path]:
    """Writes `path` with the ending of each format; returns the files."""
    files = []
    for ending in formats:
        files.append(file := path.with_name(f"{path.name}.{ending}"))
        with open_atomically(file) as stream:
            if ending is FigureFormat.PNG:
                _write_png(figure, stream, dots_per_inch)
            else:
                figure.savefig(stream, format=ending, metadata=_METADATA[ending])
    return files


def _write_png(figure: Figure, stream: BinaryIO, dots_per_inch: int) -> None:
    """Writes a figure as PNG."""
    # `savefig` would traverse the whole figure once more before it draws it.
    figure.set_dpi(dots_per_inch)
    options = {"compress_type": _RUN_LENGTHS}
    FigureCanvasAgg(figure).print_png(stream, metadata=_METADATA[FigureFormat.PNG], pil_kwargs=options)


def run_figure(
    title: str, recording: Columns, path: Path, formats: Sequence[FigureFormat] = (FigureFormat.PNG,)
) -> list[Path]:
    """Draws every signal of a run that is a number, a few in a panel; without estimates of errors."""
    with figure_style():
        figure = figure_of(recording)
        figure.suptitle(title, wrap=True)
        return write_figure(figure, path, formats, _DPI_OF_RUNS)


def figure_of(
    recording: Columns, names: Sequence[str] = (), beside: Mapping[str, Columns] = {}
) -> ShownFigure:
    """Returns signals of a run over time, by default those that `run_figure` draws.

    beside: label -> another recording, drawn with other dashes; signals that it does not have, or has with
    the same values, are not drawn again
    """
    signals = names or [name for name in recording.numbers if not name.startswith(ERROR_ESTIMATE)]
    panels = panels_of({name: recording.unit(name) for name in signals})
    lines = [_lines_of(panel.names, recording, beside) for panel in panels]
    with figure_style():
        heights = [max(_PANEL_IN, len(own) * _LEGEND_LINE_IN) for own in lines]
        figure, axes = stacked_panels(heights, "Time [s]")
        for panel, own, drawn in zip(panels, lines, axes, strict=True):
            for time, values, line in own:
                draw_curve(drawn, time, values, **line)
            if panel.down:
                drawn.invert_yaxis()
            drawn.set_ylabel(panel.axis)
            drawn.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02))
        return figure


def _lines_of(
    names: Sequence[str], recording: Columns, beside: Mapping[str, Columns]
) -> list[tuple[np.ndarray, np.ndarray, dict[str, Any]]]:
    """Returns time, values and style of each line of a panel."""
    lines = []
    for name in names:
        drawn: list[tuple[np.ndarray, np.ndarray]] = []
        for run, (label, columns) in enumerate({"": recording, **beside}.items()):
            if name not in columns.numbers:
                continue
            signal = columns.time, columns[name]
            # Runs that are compared often share their reference: one line without the label of a run.
            if any(all(map(np.array_equal, signal, other)) for other in drawn):
                continue
            drawn.append(signal)
            weight = _weight(name, columns[name])
            # lines of one run that are as wide differ in dashes, for readers without colours
            alike = sum(line["linewidth"] == weight["linewidth"] for *_, line in lines)
            dashes = LINES[(run if beside else alike) % len(LINES)]
            style = {"color": _COLOURS[len(lines) % len(_COLOURS)], "linestyle": dashes, **weight}
            style["label"] = f"{name}, {label}" if label else name
            lines.append((*signal, style))
    return lines


def _weight(name: str, values: np.ndarray) -> dict[str, Any]:
    """Returns how strong a line is: a reference black and on top; the rougher, the thinner and the lower."""
    if "reference" in name:
        return {"color": "black", "linewidth": 0.7, "zorder": 2.9}
    roughness = float(np.abs(np.diff(values)).sum() / (np.ptp(values) or 1.0))
    is_thin = "measured" in name or roughness > _ROUGH
    return {"linewidth": 0.5 if is_thin else 1.2, "zorder": 2.0 + 1.0 / (2.0 + roughness)}
