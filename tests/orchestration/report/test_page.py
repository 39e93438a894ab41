"""The page as such: tables, texts from files, colours, small screens, print, help for every reader."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import pyarrow.parquet as pq
import pytest

from tests.orchestration.results.opened import OpenedPage

from .made_up import PROVENANCE, recording, write_run, write_sweep

if TYPE_CHECKING:
    from selenium.webdriver.remote.webelement import WebElement

Open = Callable[..., OpenedPage]
TICKS = "return document.querySelector('#panels .plot').chart.axes[0].stroke()"


@pytest.fixture
def everything(opened: Open, tmp_path: Path) -> OpenedPage:
    """Three runs, one of them with other metrics and parameters, and a sweep."""
    write_run(tmp_path, "a", measured={"rmse": 12.1, "settling_time": -2.0})
    write_run(tmp_path, "b", recording(phase=0.1), {"rmse": 4.35, "settling_time": -10.0})
    write_run(tmp_path, "c", measured={"overshoot": -0.5}, parameters={"plant.mass": 7.0})
    write_sweep(tmp_path)
    return opened(tmp_path)


def test_runs_with_the_same_metrics_stand_side_by_side(everything: OpenedPage) -> None:
    tables = [" ".join(table.text.split()) for table in everything.all("#metrics table")]
    assert tables == ["Run rmse [cm] settling_time [s] a 12.1 ★ -2 b ★ 4.35 -10", "Run overshoot c -0.5"]


def test_runs_are_sorted_by_a_metric_and_have_the_part_of_their_names_that_differs(
    opened: Open, tmp_path: Path
) -> None:
    """The best is marked but where neither less nor more is better; a run that did not settle is no best."""
    metrics = {name: {"function": name, "signal": "plant.depth"} for name in ("rmse", "mean")}
    metrics["settling_time"] = metrics.pop("mean")
    values = {"l1-ideal": (12.1, 3.0), "pid-ideal": (-4.0, 1.0), "smooth-ideal": (math.nan, 2.0)}
    for name, (rmse, mean_depth) in values.items():
        measured = {"rmse": rmse, "settling_time": mean_depth}
        write_run(tmp_path, f"nominal-{name}", measured=measured, metrics=metrics)
    page = opened(tmp_path)

    def rows() -> list[str]:
        return [" ".join(row.text.split()) for row in page.all("#metrics tbody tr")]

    assert rows() == ["l1 12.1 3", "pid ★ -4 1", "smooth not a number 2"]
    heading = page.all("#metrics th button")[1]
    assert [row[:2] for row in (page.click(heading), rows())[1]] == ["pi", "l1", "sm"]
    assert page.one("#metrics tbody th").get_attribute("title") == "nominal-pid-ideal"
    assert [row[:2] for row in (page.click(heading), rows())[1]] == ["l1", "pi", "sm"]
    labels = [label.text for label in page.all("#choose-runs label")]
    assert labels == ["l1", "pid", "smooth"]


def heading(page: OpenedPage, text: str) -> "WebElement":
    (cell,) = [cell for cell in page.all(".distributions th") if cell.text == text]
    return cell


def test_a_heading_sorts_its_column_as_numbers_and_back(everything: OpenedPage) -> None:
    def values() -> list[float]:
        return [float(cell.text) for cell in everything.all(".distributions td[data-label=mean]")]

    metric, mean = (heading(everything, text) for text in ("Metric", "mean"))
    everything.click(mean.find_element("tag name", "button"))
    ascending = values()
    assert ascending == sorted(ascending)
    assert ascending != sorted(ascending, key=str)  # 5.5 before 10.5: not as texts
    assert ascending[0] < 0.0
    assert mean.get_attribute("aria-sort") == "ascending"
    everything.click(mean.find_element("tag name", "button"))
    assert values() == ascending[::-1]
    everything.click(metric.find_element("tag name", "button"))
    assert mean.get_attribute("aria-sort") == "none"


def test_what_differs_between_runs_is_said(everything: OpenedPage) -> None:
    said = everything.one(".differences").text.split("\n")
    assert said == ["parameters: plant.mass", "7.0 c", "5.5 a, b"]


def test_what_was_run_is_there(everything: OpenedPage) -> None:
    article = everything.all("#what-was-run article")[0]
    everything.click(article.find_element("tag name", "summary"))
    everything.click(article.find_elements("tag name", "summary")[1])
    for text in (
        "jacobi",
        "communication step size [s]",
        "0.1",
        "Vehicle",
        "1f2e-3d4c",
        '"plant.mass" = 5.5',
    ):
        assert text in article.text


def test_every_control_has_a_name_and_every_section_a_link(everything: OpenedPage) -> None:
    controls = [control for control in everything.all("input, select, button") if control.is_displayed()]
    assert len(controls) > 30
    for control in controls:
        assert control.accessible_name, control.get_attribute("outerHTML")
    sections = {section.get_attribute("id") for section in everything.all("main > section")}
    assert {link.get_attribute("href").partition("#")[2] for link in everything.all("nav a")} == sections  # type: ignore[union-attr]


def test_the_keyboard_reaches_every_control_of_the_signals(everything: OpenedPage) -> None:
    labels = everything.run(
        "return [...document.querySelectorAll('#signals :is(input, select, button)')]"
        ".every((control) => control.tabIndex === 0)"
    )
    assert labels


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_texts_and_lines_stand_out_in_both_colour_schemes(everything: OpenedPage, scheme: str) -> None:
    """Contrasts of WCAG 2.2: 4.5 for texts, 3 for lines."""
    everything.emulate(prefers_color_scheme=scheme)
    everything.run("return redrawAll().then(() => true)")
    everything.settled()
    paper = colour_of(everything, "body", "background-color")
    assert (luminance(paper) < 0.1) == (scheme == "dark")
    for selector in ("body", "footer", "thead th", "nav a", ".unit", "summary"):
        assert contrast(colour_of(everything, selector, "color"), paper) >= 4.5, selector
    lines = everything.run("return PALETTE[arguments[0]]", scheme)
    drawn = {path.get_attribute("stroke") for path in everything.all(".legend path")}
    assert drawn <= set(lines)
    for line in lines:
        assert contrast(of_hex(line), paper) >= 3.0, line
    assert contrast(of_hex(everything.run(TICKS)), paper) >= 4.5


def test_nothing_is_wider_than_the_screen(everything: OpenedPage) -> None:
    for details in everything.all("details"):
        everything.run("arguments[0].open = true", details)
    for width in (320, 390, 768, 1280, 2560):
        everything.at_width(width)
        everything.until(lambda: plots_fit(everything))
        page = "document.documentElement"
        assert everything.run(f"return {page}.scrollWidth") == everything.run(f"return {page}.clientWidth")


def test_no_heading_is_broken_within_a_word(opened: Open, tmp_path: Path) -> None:
    """Of many runs, whose names are long, in a browser of any width."""
    for i in range(9):
        write_run(tmp_path, f"nominal-ExtendedDepthController-{i}", measured={"rmse": 0.088813 + i})
    write_sweep(tmp_path)
    page = opened(tmp_path)
    for width in (390, 740, 900, 1280):
        assert page.at_width(width).broken_words(".cards thead th") == []


def test_a_phone_shows_a_long_value_below_its_label(everything: OpenedPage) -> None:
    for details in everything.all("details"):
        everything.run("arguments[0].open = true", details)
    everything.at_width(390)
    everything.run(
        "document.querySelector('.cards td[data-label=Model]').append(' with a long text'.repeat(9))"
    )
    assert everything.broken_words(".cards td") == []
    assert everything.squeezed_labels() == []


def plots_fit(page: OpenedPage) -> bool:
    return page.run(
        "return [...document.querySelectorAll('.plot canvas')]"
        ".every((canvas) => canvas.getBoundingClientRect().right <= document.documentElement.clientWidth)"
    )


def test_print_is_light_without_controls_and_as_wide_as_paper(everything: OpenedPage) -> None:
    everything.emulate(prefers_color_scheme="dark")
    before = widths(everything, "#panels figure:not([hidden])")
    everything.run("dispatchEvent(new Event('beforeprint'))")  # as a browser: the medium changes after it
    everything.settled()
    everything.emulate(prefers_color_scheme="dark", media="print")
    assert not any(control.is_displayed() for control in everything.all(".controls, nav"))
    assert luminance(colour_of(everything, "body", "color")) < 0.1
    assert {path.get_attribute("stroke") for path in everything.all(".legend path")} <= set(
        everything.run("return PALETTE.light")
    )
    assert luminance(of_hex(everything.run(TICKS))) < 0.1
    assert widths(everything, "#panels figure:not([hidden])") == {660}
    assert widths(everything, ".histograms figure") == {205}  # three of them beside each other
    everything.run("dispatchEvent(new Event('afterprint'))")
    everything.emulate(prefers_color_scheme="dark", media="screen")
    everything.until(lambda: widths(everything, "#panels figure:not([hidden])") == before)
    assert everything.one(".legend path").get_attribute("stroke") in everything.run("return PALETTE.dark")


def widths(page: OpenedPage, figures: str) -> set[float]:
    """Of the plots in these figures, px."""
    return set(
        page.run(
            "return [...document.querySelectorAll(arguments[0] + ' canvas')]"
            ".map((canvas) => canvas.getBoundingClientRect().width)",
            figures,
        )
    )


HOSTILE = "</script><script>window.hacked = 1</script><img src=x onerror='window.hacked = 2'>%{x}&amp;"


def test_texts_from_files_stay_texts(opened: Open, tmp_path: Path) -> None:
    """Wherever a text of a file is shown: it is there literally, and nothing of it is markup."""
    run = recording()
    odd = replace(run, names=(HOSTILE, *run.names[1:]), units=(HOSTILE, *run.units[1:]))
    fmus = {HOSTILE: {"guid": HOSTILE, "model": HOSTILE, "tool": HOSTILE}}
    odd = replace(odd, provenance={**PROVENANCE, "fmus": fmus, HOSTILE: HOSTILE})
    name = HOSTILE.replace("/", "|")
    write_run(tmp_path, name, odd, {HOSTILE: 1.0}, title=HOSTILE, parameters={HOSTILE: HOSTILE}, metrics={})
    write_run(tmp_path, "plain", replace(odd, values=odd.values + 1.0), {HOSTILE: 2.0}, metrics={})
    page = opened(tmp_path, title=HOSTILE)
    boxes = page.all("#choose-signals input")
    for box in boxes:
        if not box.is_selected():
            page.click(box)
    assert page.run("return window.hacked") is None
    assert page.driver.title == HOSTILE
    assert page.all("img") == []
    assert len(page.all("script")) == 7  # the data, uPlot and ours
    assert page.one("h1").text == HOSTILE
    shown = page.run("return document.querySelector('main').textContent")
    assert shown.count("onerror='window.hacked = 2'") > 10
    assert page.run("return document.querySelector('.plot').chart.axes[1].label").endswith(f" [{HOSTILE}]")
    assert any(line.startswith(f"{HOSTILE}, ") for line in page.shown())


def test_hostile_texts_of_sweeps_stay_texts(opened: Open, tmp_path: Path) -> None:
    path = write_sweep(tmp_path)
    sweep = pq.read_table(path)
    renamed = [
        HOSTILE if name == "plant.inertia" else HOSTILE + "2" if name == "rmse" else name
        for name in sweep.column_names
    ]
    errors = [HOSTILE if i == 0 else None for i in range(len(sweep))]
    column = sweep.schema.get_field_index("error")
    sweep = sweep.set_column(column, sweep.schema.field(column), [errors]).rename_columns(renamed)
    sweep = sweep.replace_schema_metadata(pq.read_schema(path).metadata)
    hostile = tmp_path / "hostile.parquet"
    pq.write_table(sweep, hostile)
    page = opened(hostile)
    (option,) = [
        option.text for option in page.all(".across option") if option.text.startswith(f"{HOSTILE} [")
    ]
    page.choose(".across", option).write("input.sample", "0")
    assert page.run("return window.hacked") is None
    assert page.all("img") == []
    assert HOSTILE in page.one(".chosen").text
    assert HOSTILE in page.one(".failures").text
    assert page.run("return document.querySelector('.scatter').chart.axes[0].label") == option


def test_the_policy_of_the_page_stops_scripts_and_requests(opened: Open, tmp_path: Path) -> None:
    """Should a text ever get through as an element: it neither runs nor fetches anything."""
    page = opened(write_run(tmp_path, "run"))
    page.run(
        'const image = \'<img src="http://127.0.0.1:9/x" onerror="hacked = 1">\';'
        "document.body.insertAdjacentHTML('beforeend', image);"
        "const script = document.createElement('script'); script.textContent = 'hacked = 2';"
        "document.body.append(script)"
    )
    page.until(lambda: page.run("return document.querySelector('img').complete"))
    assert page.run("return window.hacked") is None
    complaints = page.complaints()
    assert len(complaints) >= 2
    assert all("Content Security Policy" in complaint for complaint in complaints)
    assert page.fetched() == ["http://127.0.0.1:9/x"]  # asked for: Chromium notes what it then blocks too


def test_the_page_says_what_made_it_and_holds_its_data_as_plain_json(opened: Open, tmp_path: Path) -> None:
    page = opened(write_run(tmp_path, "run"))
    assert re.fullmatch(r"l1-depth [\d.]+, uPlot [\d.]+", page.one("footer").text)
    data = json.loads(page.one("#data").get_attribute("textContent") or "")
    assert [run["name"] for run in data["runs"]] == ["run"]


def numbers(colour: str) -> tuple[float, ...]:
    return tuple(float(number) for number in re.findall(r"[\d.]+", colour)[:3])


def of_hex(colour: str) -> tuple[float, ...]:
    return tuple(bytes.fromhex(colour[1:]))


def colour_of(page: OpenedPage, selector: str, which: str) -> tuple[float, ...]:
    return numbers(page.one(selector).value_of_css_property(which))


def luminance(colour: tuple[float, ...]) -> float:
    """Relative luminance of sRGB, WCAG 2.2."""
    red, green, blue = (
        c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4
        for c in (channel / 255.0 for channel in colour)
    )
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


def contrast(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)
