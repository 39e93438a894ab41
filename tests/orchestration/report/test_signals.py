"""Signals of runs, clicked through in a browser."""

import math
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from selenium import webdriver
from selenium.webdriver.common.keys import Keys

from orchestration.results.recording import Recording
from tests.orchestration.results.opened import OpenedPage

from .made_up import recording, write_run

Open = Callable[..., OpenedPage]
ERROR = "plant.depth - plant.reference"


@pytest.fixture
def two(opened: Open, tmp_path: Path) -> OpenedPage:
    """Two runs that differ in all signals but the reference, from results of both formats."""
    write_run(tmp_path, "slow", measured={"rmse": 12.1, "settling_time": 64.8})
    write_run(tmp_path, "fast", recording(phase=0.5), {"rmse": 4.35, "settling_time": 43.7}, "parquet")
    return opened(tmp_path / "slow.json", tmp_path / "fast.json")


def captions(page: OpenedPage) -> list[str]:
    """Of the panels that are shown."""
    return [caption.text for caption in page.all("#panels figcaption") if caption.is_displayed()]


def test_at_first_the_signals_that_the_metrics_judge_are_drawn(two: OpenedPage) -> None:
    """A line for each run, and one for what is equal in both; and their errors."""
    lines = ["plant.depth, fast", "plant.depth, slow", "plant.reference, all"]
    assert sorted(two.shown()) == sorted([f"{ERROR}, fast", f"{ERROR}, slow", *lines])


def test_the_tracking_error_stands_beside_the_signal(two: OpenedPage) -> None:
    """In the unit of the RMSE; across the page once the error is not ticked; on a phone below it."""

    def corners() -> list[list[float]]:
        return two.run(
            "return [...document.querySelectorAll('#panels figure:not([hidden])')]"
            ".map((figure) => figure.getBoundingClientRect()).map((box) => [box.left, box.top, box.width])"
        )

    (left, top, width), (right, beside, _) = corners()
    assert (beside, left + width < right) == (top, True)
    assert captions(two) == ["Signals in m", "Tracking error [cm]"]
    run = recording(phase=0.5)
    error = 100.0 * (run["plant.depth"] - run["plant.reference"])
    assert two.line(f"{ERROR}, fast")["y"] == error.tolist()
    two.at_width(390)
    (left, top, _), (right, below, _) = corners()
    assert (left, top < below) == (right, True)
    two.at_width(1280).tick(ERROR)
    ((_, _, alone),) = corners()
    assert alone > 1.9 * width


def test_lines_are_the_recorded_values(two: OpenedPage) -> None:
    line, run = two.line("plant.depth, fast"), recording(phase=0.5)
    assert line == {"x": run.time.tolist(), "y": run["plant.depth"].tolist()}
    assert two.one("#drawn").text == "Every point is drawn."


def test_a_line_has_its_ink_where_its_values_are(opened: Open, tmp_path: Path) -> None:
    """And moves with the zoom; a button that hides it takes the ink away."""
    page = opened(write_run(tmp_path, "alone"))
    plot, run = page.one("#panels .plot"), recording()
    blue = page.run("return PALETTE.light[0]")
    at = run.time[30], run["plant.depth"][30]
    assert page.has_ink(plot, *at, blue)
    assert not page.has_ink(plot, at[0], at[1] + 0.3, blue)
    before = page.ranges()
    page.drag(plot, 0.2, 0.5)
    assert page.ranges() != before
    assert page.has_ink(plot, *at, blue)
    page.click(page.all(".legend button")[0])
    assert not page.has_ink(plot, *at, blue)


def test_the_legend_has_the_values_under_the_pointer(two: OpenedPage) -> None:
    """In every panel, since they share their time."""
    two.tick("plant.force")
    two.point_at(two.one("#panels .plot"), 3.0, 0.0)
    written = {
        button.text.split("\n")[0]: button.text.split("\n")[-1] for button in two.all(".legend button")
    }
    for run, name in ((recording(), "slow"), (recording(phase=0.5), "fast")):
        for signal in ("plant.depth", "plant.force"):
            assert written[f"{signal}, {name}"] == f"{run[signal][30]:.4g}".ljust(
                len(written[f"{signal}, {name}"]), "0"
            )


def test_a_drag_across_both_axes_zooms_both_and_a_double_click_goes_back(two: OpenedPage) -> None:
    before = two.ranges(), two.ranges("y")
    two.drag(two.one("#panels .plot"), 0.2, 0.5, down=60)
    (start, end), of_error = two.ranges()
    assert 0.0 < start < end < 10.0
    assert of_error == [start, end]
    (low, high), (lowest, highest) = two.ranges("y")[0], before[1][0]
    assert high - low < 0.5 * (highest - lowest)
    assert np.ptp(two.ranges("y")[1]) > 100.0  # of the error, in cm
    webdriver.ActionChains(two.driver).double_click(two.one("#panels .u-over")).perform()
    two.settled()
    assert (two.ranges(), two.ranges("y")) == before


def test_a_tick_box_adds_and_removes_the_lines_of_a_signal(two: OpenedPage) -> None:
    assert len(two.tick(ERROR).tick("plant.force").shown()) == 5
    assert captions(two) == ["Signals in m", "Signals in N"]
    assert len(two.tick("plant.ratio").shown()) == 7
    assert captions(two) == ["Signals in m", "Signals in N", "Signals without unit"]
    assert len(two.tick("plant.force").tick("plant.depth").tick("plant.reference").shown()) == 2
    assert captions(two) == ["Signals without unit"]


def test_a_tick_box_removes_the_lines_of_a_run(two: OpenedPage) -> None:
    assert sorted(two.tick("slow").shown()) == [
        f"{ERROR}, fast",
        "plant.depth, fast",
        "plant.reference, fast",
    ]
    two.tick("fast")
    assert two.shown() == []
    assert two.one("#drawn").text == "Nothing is ticked."


def test_one_button_ticks_all_and_none(two: OpenedPage) -> None:
    button = two.one("[aria-label='all or none of the signals in m']")
    two.tick(ERROR)
    assert len(two.click(button).shown()) == 0  # both were ticked
    assert len(two.click(button).shown()) == 3


def test_the_legend_hides_a_line_by_mouse_and_by_keyboard(two: OpenedPage) -> None:
    two.click(two.all(".legend button")[0])
    assert len(two.shown()) == 4
    assert two.all(".legend button")[0].get_attribute("aria-pressed") == "false"
    two.all(".legend button")[0].send_keys(Keys.ENTER)
    two.until(lambda: len(two.shown()) == 5)
    assert (
        two.run("return document.activeElement.getAttribute('aria-pressed')") == "true"
    )  # the focus stays where it was


def looks(page: OpenedPage) -> dict[str, tuple[str, str]]:
    """Line -> its colour and its dashes, as the legends show them."""
    return {
        str(button.text): tuple(
            str(button.find_element("tag name", "path").get_attribute(name))
            for name in ("stroke", "stroke-dasharray")
        )
        for button in page.all("#panels figure:not([hidden]) .legend button")
    }  # type: ignore[return-value]


def test_a_run_has_one_colour_in_every_panel(two: OpenedPage) -> None:
    before = looks(two.tick("plant.force").tick("plant.ratio"))
    for run in ("slow", "fast"):
        assert len({look[0] for line, look in before.items() if line.endswith(run)}) == 1
    assert len({look[0] for look in before.values()}) == 3  # and one of what both share
    assert before["plant.depth, slow"] != before["plant.reference, all"]
    assert before["plant.depth, slow"][1] != before["plant.depth, fast"][1]  # for readers without colours
    assert looks(two.tick("slow"))["plant.depth, fast"] == before["plant.depth, fast"]


def test_signals_of_one_run_have_different_colours_and_dashes(opened: Open, tmp_path: Path) -> None:
    write_run(tmp_path, "alone")
    for part in (0, 1):
        assert len({look[part] for look in looks(opened(tmp_path)).values()}) == 2


def test_zooming_one_panel_zooms_all(two: OpenedPage) -> None:
    two.tick("plant.force").tick("plant.ratio")
    before = two.ranges()
    assert before == [[0.0, 10.0]] * 4
    two.drag(two.all("#panels .plot")[2], 0.2, 0.5)
    two.until(lambda: two.ranges() != before)
    two.settled()
    ranges = two.ranges()
    assert ranges == [ranges[0]] * 4
    pixel = 10.0 / 1000.0  # s, of a plot about 1000 px wide
    assert ranges[0] == pytest.approx([2.0, 5.0], abs=2.0 * pixel)
    fields = [float(str(two.one(f).get_attribute("value"))) for f in ("#from", "#to")]
    assert fields == pytest.approx(ranges[0], rel=1e-5)  # shown with six digits
    two.click(two.one("#whole"))
    assert two.ranges() == before


def test_the_time_can_be_typed(two: OpenedPage) -> None:
    two.tick("plant.force").write("#from", "2.5").write("#to", "7.5")
    assert two.ranges() == [[2.5, 7.5]] * 3
    two.write("#to", "1")  # ends before it begins: nothing changes
    assert two.ranges() == [[2.5, 7.5]] * 3
    assert two.one("#to").get_attribute("value") == "7.5"


def test_the_difference_to_a_run(two: OpenedPage) -> None:
    two.choose("#view", "difference to slow")
    assert sorted(two.shown()) == [f"{ERROR}, fast", "plant.depth, fast", "plant.reference, fast"]
    difference = recording(phase=0.5)["plant.depth"] - recording()["plant.depth"]
    assert two.line("plant.depth, fast")["y"] == difference.tolist()
    assert set(two.line("plant.reference, fast")["y"]) == {0.0}


def test_at_a_jump_the_difference_is_to_the_value_after_it(opened: Open, tmp_path: Path) -> None:
    (tmp_path / "base.csv").write_text("t,plant.depth [m]\n0,1\n2,1\n2,-5\n2,4\n3,4\n")
    at = np.array([1.0, 2.0, 3.0])
    Recording(("plant.depth",), ("m",), at, 10.0 * at[:, None]).write(tmp_path / "run.csv")
    page = opened(tmp_path / "run.csv", tmp_path / "base.csv").choose("#view", "difference to base")
    assert page.line("plant.depth, run") == {"x": at.tolist(), "y": [9.0, 16.0, 26.0]}


def test_runs_of_different_length_share_the_axis(opened: Open, tmp_path: Path) -> None:
    write_run(tmp_path, "long", recording(points=201))
    write_run(tmp_path, "short")
    assert opened(tmp_path).ranges() == [[0.0, 20.0]] * 2


def test_a_gap_stays_a_gap(opened: Open, tmp_path: Path) -> None:
    """Values that are not a number are drawn as nothing, also in a line that is thinned."""
    for points in (101, 9001):
        run = recording(points)
        run["plant.depth"][50] = math.nan
        write_run(tmp_path, f"run {points}", run)
        y = opened(tmp_path / f"run {points}.json").line("plant.depth")["y"]
        assert [value is None for value in y].count(True) == 1  # as JSON says it


def test_a_long_line_is_decimated_to_its_extremes_and_the_page_says_so(opened: Open, tmp_path: Path) -> None:
    run = recording(points=15_501, step=0.02)
    run["plant.depth"][7_777] = 9.0  # a spike of one point
    run["plant.depth"][12_345] = -9.0
    write_run(tmp_path, "long", run)
    page = opened(tmp_path / "long.json")
    assert "3 of 3 lines are decimated" in page.one("#drawn").text
    assert "each of 2000 columns of time" in page.one("#drawn").text
    line = page.line("plant.depth")
    drawn = dict(zip(line["x"], line["y"], strict=True))
    assert len(drawn) <= 4_002
    recorded = dict(zip(run.time.tolist(), run["plant.depth"].tolist(), strict=True))
    assert drawn.items() < recorded.items()
    assert {run.time[i] for i in (0, 7_777, 12_345, 15_500)} <= drawn.keys()
    blue = page.run("return PALETTE.light[0]")
    assert page.has_ink(page.one("#panels .plot"), run.time[7_777], 8.9, blue)


def test_many_long_runs_are_there_in_seconds(opened: Open, tmp_path: Path) -> None:
    """Five runs of 15 501 points and 20 signals, most of them drawn: 96 lines."""
    for i in range(5):
        write_run(tmp_path, f"run{i}", recording(15_501, 0.02, 0.1 * i, signals=20))
    page = opened(tmp_path)
    begin = time.perf_counter()
    page.driver.refresh()
    page.settled()
    loaded = time.perf_counter() - begin
    begin = time.perf_counter()
    page.click(page.one("[aria-label='all or none of the signals in N']"))
    redrawn = time.perf_counter() - begin
    assert len(page.shown()) == 5 * (2 + 17) + 1  # depth, its error, forces; the reference is one line
    print(f"loaded in {loaded:.1f} s, 96 lines drawn in {redrawn:.1f} s")
    assert max(loaded, redrawn) < 15.0  # some 2 s here; a busy machine with one core takes several times that


def test_a_recording_alone_and_one_of_a_single_point_are_drawn(opened: Open, tmp_path: Path) -> None:
    recording(points=1).write(tmp_path / "point.parquet")
    recording().write(tmp_path / "alone.csv")
    page = opened(tmp_path / "point.parquet", tmp_path / "alone.csv")
    assert {"plant.depth, point", "plant.depth, alone"} <= set(page.shown())
    assert "has no scenario" in str(page.one("#what-was-run").get_property("textContent"))


def test_measured_data_lie_over_the_run_and_are_joined_across_empty_cells(
    opened: Open, tmp_path: Path
) -> None:
    log = tmp_path / "log.csv"
    log.write_text("time,depth [cm]\n0,-80\n4,\n8,-80\n")
    page = opened(write_run(tmp_path, "run"), log)
    assert "depth, log" in page.shown()
    assert captions(page)[0] == "Signals in m"
    assert page.line("depth, log") == {"x": [0, 4, 8], "y": [-0.8, None, -0.8]}
    colour = looks(page)["depth, log"][0]
    page.write("#from", "3.9").write("#to", "4.1")
    plot = page.one("#panels .plot")
    assert any(page.has_ink(plot, 3.95 + 0.01 * i, -0.8, colour) for i in range(10))
