"""Figures: every extreme value is drawn, equal data give equal files, and the caller's settings stay."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from orchestration.results import figures
from orchestration.results.formats import FigureFormat
from orchestration.results.panels import panels_of
from orchestration.results.recording import Recording
from tests.shared_builds import slow_but

TIME = np.linspace(0.0, 100.0, 50_001)


@pytest.fixture
def recording() -> Recording:
    """A wave with a spike of one sample, and a signal of another unit."""
    wave = np.sin(TIME)
    wave[33_333] = 7.0
    return Recording(("a.y", "a.z"), ("m", "N"), TIME, np.column_stack([wave, np.cos(TIME)]))


def drawn(recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Points of the first signal's curve."""
    _, (panel,) = figures.stacked_panels([1.0], "Time [s]")
    figures.draw_curve(panel, recording.time, recording["a.y"])
    (line,) = panel.get_lines()
    return np.asarray(line.get_xdata()), np.asarray(line.get_ydata())


def test_a_dense_curve_keeps_its_ends_and_a_spike_of_one_sample(recording: Recording) -> None:
    time, values = drawn(recording)
    assert len(time) < 0.1 * len(TIME)
    assert (time[0], time[-1]) == (TIME[0], TIME[-1])
    assert np.all(np.diff(time) > 0.0)
    assert time[values == 7.0] == TIME[33_333]


def test_the_band_of_a_noisy_signal_holds_all_of_its_values() -> None:
    values = np.random.default_rng(1).normal(size=len(TIME))
    _, (panel,) = figures.stacked_panels([1.0], "Time [s]")
    figures.draw_noisy(panel, TIME, values, 1.0, color=figures.BLUE)
    (band,) = panel.collections
    edge = np.asarray(band.get_paths()[0].vertices)[:, 1]
    assert (edge.min(), edge.max()) == (values.min(), values.max())


def test_depth_points_down(recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[figures.Figure] = []
    monkeypatch.setattr(figures, "write_figure", lambda figure, *_: drawn.append(figure) or [])
    figures.run_figure("A dive", replace(recording, names=("plant.depth", "a.z")), tmp_path / "dive")
    assert [panel.yaxis_inverted() for panel in drawn[0].axes] == [True, False]


@pytest.mark.parametrize(
    ("units", "panels"),
    [
        (
            {"plant.depth": "m", "controller.depth_reference": "m", "waves.elevation": "m", "c.u": "N"},
            {
                "Depth [m]": ["plant.depth", "controller.depth_reference"],
                "Elevation [m]": ["waves.elevation"],
                "u [N]": ["c.u"],
            },
        ),
        (
            {"a.x": "1", "b.x": "1", "a.y_rate": "rad/s", "b.z_rate": "rad/s", "b.v": "K", "b.w": "K"},
            {
                "x [1]": ["a.x", "b.x"],
                "Rate [rad/s]": ["a.y_rate", "b.z_rate"],
                "Temperature [K]": ["b.v", "b.w"],
            },
        ),
        ({"a.p": "mol", "a.q": "mol"}, {"Value [mol]": ["a.p", "a.q"]}),
    ],
)
def test_a_panel_has_one_unit_and_one_direction_and_the_name_of_what_its_signals_share(
    units: dict[str, str], panels: dict[str, list[str]]
) -> None:
    assert {panel.axis: panel.names for panel in panels_of(units)} == panels


def test_of_many_signals_of_one_unit_those_that_share_a_word_share_a_panel() -> None:
    forces = ["plant.total_force", "c.demanded_force", "c.u_m", "c.u_a", "c.theta_hat[1]", "c.sigma_hat"]
    panels = panels_of(dict.fromkeys(forces, "N"))
    assert [panel.names for panel in panels] == [forces[:2], forces[2:4], forces[4:]]
    assert [panel.axis for panel in panels] == ["Force [N]"] * 3
    states = [f"plant.x[{i}]" for i in range(9)]
    assert [len(panel.names) for panel in panels_of(dict.fromkeys(states, "1"))] == [3, 3, 3]


def test_a_reference_is_thin_and_a_rough_signal_thinner_than_a_smooth_one_above_it() -> None:
    rough = np.random.default_rng(1).normal(size=len(TIME))
    names = ("c.depth_reference", "plant.depth", "plant.measured_depth", "plant.depth_of_noise")
    values = np.column_stack([np.sin(TIME)] * 3 + [rough])
    (panel,) = figures.figure_of(Recording(names, ("m",) * 4, TIME, values)).axes
    lines = {str(line.get_label()): line for line in panel.get_lines()}
    reference, depth, measured, noise = (lines[name] for name in names)
    assert reference.get_color() == "black"
    assert max(line.get_linewidth() for line in (reference, measured, noise)) < depth.get_linewidth()
    assert noise.get_zorder() < depth.get_zorder() < reference.get_zorder()


def test_everything_has_room_in_the_figure(
    recording: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Long numbers, long names, and more signals in a panel than its usual height has lines."""
    drawn: list[figures.Figure] = []
    monkeypatch.setattr(figures, "write_figure", lambda figure, *_: drawn.append(figure) or [])
    names = [f"component.a_signal_with_a_long_name_{i}" for i in range(14)]
    values = 123456.789 * np.column_stack([recording["a.y"]] * 14)
    figures.run_figure("A run", Recording(tuple(names), ("m",) * 13 + ("N",), TIME, values), tmp_path / "run")
    (figure,) = drawn
    figure.savefig(tmp_path / "run.png")
    box, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert box.x0 >= 0.0
    assert box.y0 >= 0.0
    assert box.x1 <= width
    assert box.y1 <= height
    legends = [legend.get_window_extent() for panel in figure.axes if (legend := panel.get_legend())]
    assert legends[0].y0 > legends[1].y1


def test_the_picture_shows_the_right_frame_of_a_panel_whose_legend_is_inside(tmp_path: Path) -> None:
    """The last number of the axis stands left of the frame, so that nothing but the frame needs room."""
    with figures.figure_style():
        figure, (panel,) = figures.stacked_panels([1.0], "Time [s]")
        figures.draw_curve(panel, 0.943 * TIME, np.zeros_like(TIME), label="a")
        panel.legend(loc="upper left")
        (file,) = figures.write_figure(figure, tmp_path / "run", [FigureFormat.PNG], dots_per_inch=100)
    with Image.open(file) as picture:
        is_ink = np.asarray(picture.convert("L")) < 128
    columns = np.flatnonzero(is_ink.mean(axis=0) > 0.4)  # only the two vertical frames are so high
    blank = is_ink.shape[1] - 1 - columns[-1]
    assert columns[-1] - columns[0] > 0.8 * is_ink.shape[1]
    assert blank == pytest.approx(0.05 * 100, abs=1)  # the padding, to the pixel that holds the line
    assert not is_ink[:, columns[-1] + 1 :].any()


@pytest.mark.parametrize("ending", slow_but((FigureFormat.PNG, FigureFormat.SVG), FigureFormat))
def test_equal_data_give_the_same_file(recording: Recording, tmp_path: Path, ending: FigureFormat) -> None:
    files = [
        figures.run_figure("A run", recording, tmp_path / name, [ending])[0] for name in ("first", "second")
    ]
    assert [file.suffix for file in files] == [f".{ending}"] * 2
    assert files[0].read_bytes() == files[1].read_bytes()


@pytest.mark.slow
def test_figures_leave_pyplot_and_the_settings_of_the_caller_alone() -> None:
    code = """
import sys
import matplotlib
before = matplotlib.rcParams.copy()
from orchestration.results import figures
with figures.figure_style():
    figures.stacked_panels([1.0], "Time [s]")
assert matplotlib.rcParams.copy() == before
assert "matplotlib.pyplot" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
