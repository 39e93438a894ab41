"""The page of a score in a browser: tables, tracking, the price of accuracy, plants."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from selenium import webdriver

from orchestration.report.score_page import score_page

from .made_up_score import made_up_score
from .opened import OpenedPage


@pytest.fixture(scope="module")
def html() -> str:
    return score_page(made_up_score(), "Score of <mine>")


@pytest.fixture
def opened_score(browser: "webdriver.Chrome", tmp_path: Path, html: str) -> Iterator[OpenedPage]:
    file = tmp_path / "score.html"
    file.write_text(html, encoding="utf-8")
    page = OpenedPage(browser, file)
    yield page
    browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    assert page.complaints() == []
    assert page.fetched() == []


def test_the_statement_stands_above_the_metrics_and_names_are_no_markup(html: str) -> None:
    assert html.index("not on a real vehicle") < html.index('<section id="tables">')
    assert "of protocol 3.0" in html
    assert "&lt;mine&gt;" in html
    assert "<mine>" not in html


def test_a_case_that_the_vehicle_cannot_play_is_named(html: str) -> None:
    assert "Left out" not in html
    made_up = made_up_score()
    made_up.document.protocol.left_out = {"Current <0.05 m/s>": "boat lacks plant.current_velocity"}
    page = score_page(made_up, "Score")
    assert "<dt>Current &lt;0.05 m/s&gt;</dt><dd>boat lacks plant.current_velocity</dd>" in page


def lines(page: OpenedPage, plot: str) -> dict[str, list[float]]:
    """Name -> y of the lines of a plot."""
    return dict(page.run(f"return document.getElementById('{plot}').data.map((t) => [t.name, [...t.y]])"))


def test_the_best_of_each_column_that_did_not_fail_is_marked(opened_score: OpenedPage) -> None:
    page = opened_score.choose("#table", "RMSE [cm]")
    (table,) = [table for table in page.all("[data-table]") if table.is_displayed()]
    cells = [row.text.split("\n")[0] for row in table.find_elements("css selector", "tbody tr")]
    assert [cell.split(" r ")[1] for cell in cells] == ["2 3", "★ 1 ★ 1.5", "✗ 3 4.5"]


def test_all_controllers_are_drawn_and_can_be_hidden(opened_score: OpenedPage) -> None:
    drawn = lines(opened_score, "error")
    assert drawn["&lt;pid&gt;"] == pytest.approx([0.0, -1.0, -1.0])
    assert drawn["&lt;mine&gt;"] == pytest.approx([0.0, -2.0, -2.0])
    opened_score.choose("#case", "Buoyancy +0.2 N")
    assert lines(opened_score, "error")["&lt;pid&gt;"] == pytest.approx([0.0, -1.5, -1.5])
    opened_score.click(opened_score.all("#lines button")[1])
    assert set(lines(opened_score, "depth")) == {"&lt;mine&gt;", "&lt;l1&gt;", "reference"}


def test_the_price_joins_what_no_other_beats(opened_score: OpenedPage) -> None:
    """l1 is beaten by both; in the nominal case it failed, too."""
    front, points = opened_score.run(
        "return document.getElementById('pareto').data.map((t) => [[...t.x], [...t.y]])"
    )
    assert front == [[1.0, 2.0], [400.0, 300.0]]
    assert points == [[2.0, 1.0, 3.0], [300.0, 400.0, 500.0]]
    symbols = opened_score.run("return document.getElementById('pareto').data[1].marker.symbol")
    assert symbols == ["circle", "circle", "x"]


def test_plants_have_a_box_for_each_controller(opened_score: OpenedPage) -> None:
    assert lines(opened_score, "boxes") == {
        "&lt;mine&gt;": [2.0, 4.0],
        "&lt;pid&gt;": [1.0, 2.0],
        "&lt;l1&gt;": [3.0, 6.0],
    }


def test_a_phone_breaks_no_word_of_a_table(opened_score: OpenedPage) -> None:
    opened_score.at_width(390)
    for part in ("thead th", "tbody th", "tbody td"):
        assert opened_score.broken_words(f".cards {part}") == []
    assert opened_score.squeezed_labels() == []
    caption, table = opened_score.run(
        "return ['caption', 'table'].map((name) => document.querySelector(name).clientWidth)"
    )
    assert caption == table


def test_what_failed_is_told_with_its_reason(opened_score: OpenedPage) -> None:
    text = opened_score.one("#failed").text
    assert "<l1>\nNominal\nbreach 3 s" in text
    assert "<pid>" not in text
