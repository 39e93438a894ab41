"""The page of a score in a browser: tables, tracking, the price of accuracy, plants."""

import json
import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from selenium import webdriver

from fmus.errors import MissingExtraError
from orchestration.studies.score import score_rendering
from orchestration.studies.score.command import write_score
from orchestration.studies.score.score import ScoreResult
from orchestration.studies.score.score_rendering import html_page, preselected
from tests.orchestration.results.opened import OpenedPage

from .made_up_score import made_up_score


@pytest.fixture(scope="module")
def html() -> str:
    return html_page(made_up_score(), "Score of <mine>")


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
    page = html_page(made_up, "Score")
    assert "<dt>Current &lt;0.05 m/s&gt;</dt><dd>boat lacks plant.current_velocity</dd>" in page


@pytest.mark.parametrize("error", [RuntimeError("no page"), MissingExtraError("a page needs jinja2")])
def test_a_page_that_cannot_be_made_stands_beside_no_score_of_another_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], error: Exception
) -> None:
    """The score is kept, which takes long to make; the page of another one is removed."""

    def fail(result: ScoreResult, title: str) -> str:
        raise error

    made, file = made_up_score(), tmp_path / "score.json"
    write_score(made, made, file, "Before")
    assert capsys.readouterr().out.splitlines() == [str(file), str(file.with_suffix(".html"))]
    other = made.document.model_copy(update={"seed": 7})
    monkeypatch.setattr(score_rendering, "html_page", fail)
    with suppress(RuntimeError):
        write_score(replace(made, document=other), made, file, "After")
    no_page = "l1-depth: no page: a page needs jinja2\n" if isinstance(error, MissingExtraError) else ""
    assert capsys.readouterr() == (f"{file}\n", no_page)
    assert (json.loads(file.read_text())["seed"], file.with_suffix(".html").exists()) == (7, False)


def lines(page: OpenedPage, plot: str) -> dict[str, list[float]]:
    """Name -> y of the lines of a plot."""
    return dict(
        page.run(
            f"const {{chart}} = document.getElementById('{plot}');"
            "return chart.series.slice(1).map((line, i) => [line.label, chart.data[i + 1]])"
        )
    )


def test_the_best_of_each_column_that_did_not_fail_is_marked(opened_score: OpenedPage) -> None:
    page = opened_score.choose("#table", "RMSE [cm]")
    (table,) = [table for table in page.all("[data-table]") if table.is_displayed()]
    cells = [row.text.split("\n")[0] for row in table.find_elements("css selector", "tbody tr")]
    assert [cell.split(" r ")[1] for cell in cells] == ["2 3", "★ 1 ★ 1.5", "✗ 3 4.5"]


def test_a_button_draws_and_hides_a_controller(opened_score: OpenedPage) -> None:
    """At first the scored one, and those that are ranked: l1 failed the nominal case."""
    drawn = lines(opened_score, "error")
    assert set(drawn) == {"<mine>", "<pid>"}
    assert drawn["<pid>"] == pytest.approx([0.0, -1.0, -1.0])
    assert drawn["<mine>"] == pytest.approx([0.0, -2.0, -2.0])
    opened_score.choose("#case", "Buoyancy +0.2 N")
    assert lines(opened_score, "error")["<pid>"] == pytest.approx([0.0, -1.5, -1.5])
    for number in (1, 2):
        opened_score.click(opened_score.all("#lines button")[number])
    assert set(lines(opened_score, "depth")) == {"<mine>", "<l1>", "reference"}


def with_others(*of_others: tuple[str, float, float, float]) -> ScoreResult:
    """The made-up score with more rows: name, RMSE, total variation and delay margin."""
    made_up = made_up_score()
    document = made_up.document
    for name, rmse, variation, margin in of_others:
        row = document.rows[1].model_copy(deep=True)
        row.name, row.title, row.delay_margin = name, name, margin
        row.cases["nominal"].metrics |= {"rmse": rmse, "total_variation": variation}
        document.rows.append(row)
    traces = {row.name: made_up.traces.get(row.name, made_up.traces["pid"]) for row in document.rows}
    return replace(made_up, traces=traces)


def test_the_scored_one_is_drawn_beside_the_most_accurate_the_calmest_and_the_most_robust() -> None:
    """Which are three; what is not ranked is none of them."""
    others = [("exact", 0.5, 900.0, 0.02), ("calm", 5.0, 10.0, 0.3), ("slow", 6.0, 500.0, 0.2)]
    document = with_others(*others, ("cheat", 0.0, 0.0, 9.0), ("unknown", 7.0, 500.0, math.nan)).document
    document.rows[-2].unranked = ["its run, repeated, gives other values"]
    assert preselected(document) == ["mine", "exact", "calm", "slow"]


def test_no_two_of_forty_lines_look_alike(browser: "webdriver.Chrome", tmp_path: Path) -> None:
    """And those that are drawn at first differ in colour and in dash, as do their buttons."""
    file = tmp_path / "score.html"
    many = with_others(*((f"other {i}", 2.0 + i, 1000.0 - i, 0.1 + i) for i in range(36)))
    file.write_text(html_page(many, "Score"), encoding="utf-8")
    page = OpenedPage(browser, file)
    at_first = page.run(
        "return document.getElementById('error').chart.series.slice(1)"
        ".map((line) => [line.stroke(), String(line.dash)])"
    )
    assert [len({style[part] for style in at_first}) for part in (0, 1)] == [4, 4]
    buttons = page.run(
        "return [...document.querySelectorAll('#lines path')]"
        ".map((p) => [p.getAttribute('stroke'), p.getAttribute('stroke-dasharray')])"
    )
    assert len({tuple(style) for style in buttons}) == len(buttons) == 39


def test_the_error_stands_beside_the_depth(opened_score: OpenedPage) -> None:
    """On a screen; on a phone below it."""
    corners = "return ['depth', 'error'].map((id) => { const at = document.getElementById(id)"
    corners += ".getBoundingClientRect(); return [at.left, at.top]; })"
    (left, top), (right, beside) = opened_score.run(corners)
    assert (top, left < right) == (beside, True)
    opened_score.at_width(390)
    (left, top), (right, below) = opened_score.run(corners)
    assert (left, top < below) == (right, True)


def test_the_price_joins_what_no_other_beats(opened_score: OpenedPage) -> None:
    """l1 is beaten by both; in the nominal case it failed, too."""
    time, _, front = opened_score.run("return document.getElementById('pareto').chart.data")
    joined = [(x, y) for x, y in zip(time, front, strict=True) if y is not None]
    assert joined == [(1.0, 400.0), (2.0, 300.0)]
    assert marks(opened_score, "pareto", "x", "y", "mark") == [
        [2.0, 300.0, "circle"],
        [1.0, 400.0, "circle"],
        [3.0, 500.0, "cross"],
    ]


def marks(page: OpenedPage, plot: str, *keys: str) -> list[list[Any]]:
    """These keys of each point of a plot."""
    return page.run(
        "const [plot, keys] = arguments;"
        "return document.getElementById(plot).points.map((point) => keys.map((key) => point[key] ?? null))",
        plot,
        keys,
    )


def test_plants_stand_above_the_name_of_each_controller(opened_score: OpenedPage) -> None:
    """And a bar at their median."""
    points = marks(opened_score, "boxes", "x", "y", "mark")
    for i, median in enumerate((2.0, 1.0, 3.0)):
        (bar,) = [[x, y] for x, y, mark in points if mark == "bar" and round(x) == i]
        assert bar == [i, median]
        assert [y for x, y, mark in points if mark is None and round(x) == i] == [median, 2.0 * median]
    names = opened_score.run("return document.getElementById('boxes').chart.axes[0].values()")
    assert names == ["<mine>", "<pid>", "<l1>"]


def test_a_phone_breaks_no_word_of_a_table(opened_score: OpenedPage) -> None:
    opened_score.at_width(390)
    for part in ("thead th", "tbody th", "tbody td"):
        assert opened_score.broken_words(f".cards {part}") == []
    assert opened_score.squeezed_labels() == []
    caption, table = opened_score.run(
        "return ['caption', 'table'].map((name) => document.querySelector(name).clientWidth)"
    )
    assert caption == table


def test_paper_is_wide_enough_for_every_chart_and_every_word_of_a_heading(opened_score: OpenedPage) -> None:
    """A browser prints as soon as the handlers of `beforeprint` are done, which wait for no other event."""
    widths = opened_score.run(
        "dispatchEvent(new Event('beforeprint'));"
        "return (async () => {"
        "  for (let i = 0; i < 1000; i++) await null;"
        "  return ['depth', 'force', 'pareto'].map((id) => document.getElementById(id).chart.width);"
        "})()"
    )
    assert widths == [660] * 3
    opened_score.emulate(media="print").at_width(660)
    assert opened_score.broken_words(".cards thead th") == []
    opened_score.run("dispatchEvent(new Event('afterprint'))")
    opened_score.emulate(media="screen")


def test_labels_of_points_do_not_overlap(opened_score: OpenedPage) -> None:
    places = opened_score.run(
        "const place = document.getElementById('pareto'), shown = [];"
        "const at = {x: 2, y: 20, color: '#000000', label: 'a long name'};"
        "const {ctx} = scatter(place, [at, at, at], {x: '', y: ''});"
        "ctx.fillText = (text, x, y) => text === at.label && shown.push([x, y]);"
        "place.chart.redraw(); return new Promise((done) => setTimeout(() => done(shown), 100))"
    )
    heights = sorted(y for _, y in places)
    assert len(heights) == 3
    assert min(b - a for a, b in pairwise(heights)) >= 12  # px of a letter


def test_what_failed_is_told_with_its_reason(opened_score: OpenedPage) -> None:
    text = opened_score.one("#failed").text
    assert "<l1>\nNominal\nbreach 3 s" in text
    assert "<pid>" not in text
