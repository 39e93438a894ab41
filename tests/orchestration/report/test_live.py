"""The live page in Chromium: the numbers of its runs, its sliders, its charts, its messages."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from selenium import webdriver

from orchestration import Recording, simulate
from orchestration.report.live_page import live_page
from orchestration.results import metrics
from orchestration.scenarios import scenario
from orchestration.scenarios.fmu_files import build_missing
from orchestration.scenarios.scenario import Scenario
from orchestration.system.experiment import Event
from orchestration.system.faults import Delay, Fault, Noise
from tests.orchestration.results.opened import OpenedPage

RELATIVE = (
    1e-9  # of the largest value of a signal: elementary functions of two C libraries differ in the last bit
)
MOST_BYTES = 700_000
FAULTS = (
    Fault("controller.measured_depth", Noise(0.005, 3), 5.0, 8.0),
    Fault("plant.voltage[1]", Delay(0.1)),
)
EVENTS = (Event(3.011, {"plant.external_force": 0.5}), Event(10.0, {"plant.external_force": 0.1}))
FEW = ("plant.depth", "plant.external_force", "controller.measured_depth", "controller.depth_reference")

# Initial values follow from each other: y = u / 2 + 1 in both, so that both begin at 2.
BLOCK = """
from dataclasses import dataclass

from fmus.block import Block, variable
from fmus.numerics import where


@dataclass(frozen=True)
class Parameters:
    gain: float = variable(0.5, "Gain", min=-1.0, max=1.0)
    is_reversed: bool = variable(False, "Whether it counts down")
    stride: int = variable(1, "What is counted", min=1, max=9)


@dataclass(frozen=True)
class Inputs:
    u: float = variable(0.0, "Input")
    is_counting: bool = variable(False, "Whether it counts")
    start: int = variable(0, "First number", min=-9, max=9)


@dataclass(frozen=True)
class State:
    x: float = 0.0
    count: int = 0


@dataclass(frozen=True)
class Outputs:
    y: float = variable(0.0, "Output")
    count: int = variable(0, "Number of steps")
    is_high: bool = variable(False, "Whether y is above 2.5")


def requirements(p, _):
    return ((p.gain * p.stride < 1.7, "gain * stride < 1.7"),)


def initial_state(t, u, p, _):
    return State(p.gain * u.u + 1.0, u.start)


def step(t, h, s, u, p, _):
    stride = where(p.is_reversed, -p.stride, p.stride)
    return State(s.x + h * (u.u - s.x + 1.0), s.count + where(u.is_counting, stride, 0))


def output(t, s, p, _):
    return Outputs(s.x, s.count, s.x > 2.5)


{name} = Block.of_module(__name__, "{name}", "A block of a user", step_size=0.1)
"""
LOOP = """
title = "Two blocks of a user"
record = ["one.y", "one.count", "one.is_high", "two.y", "two.count", "two.is_high"]
connections = [
    ["one.y", "two.u"],
    ["two.y", "one.u", {factor = 0.5, offset = 1.0}],
    ["one.is_high", "two.is_counting"],
    ["two.is_high", "one.is_counting"],
]
components = { one = "One.py", two = "Two.py" }
experiment = { stop_time = 5.0, step_size = 0.1 }
parameters = { "one.is_reversed" = true, "one.stride" = 2 }
inputs = { "one.start" = -3, "two.start" = 4 }
"""

Open = Callable[..., OpenedPage]


@pytest.fixture
def open_live(browser: "webdriver.Chrome", tmp_path: Path) -> Iterator[Open]:
    """Opens the live page of scenarios; afterwards nothing must have gone wrong and nothing been fetched."""
    pages: list[OpenedPage] = []

    def open_page(*scenarios: Scenario, sliders: tuple[str, ...] = ()) -> OpenedPage:
        text = live_page({one.title: one for one in scenarios}, sliders)
        assert len(text.encode()) < MOST_BYTES
        file = tmp_path / "live.html"
        file.write_text(text, encoding="utf-8")
        pages.append(OpenedPage(browser, file))
        return pages[-1]

    yield open_page
    for page in pages:
        assert page.complaints() == []
        assert page.fetched() == []


def loaded(name: str, **settings: Any) -> Scenario:
    return scenario.load(scenario.find(name), settings=settings)


def with_experiment(one: Scenario, **settings: Any) -> Scenario:
    return replace(one, experiment=replace(one.experiment, **settings))


def native(one: Scenario) -> Recording:
    return simulate(one.system, one.experiment)


def assert_equal(page: OpenedPage, *recordings: Recording) -> None:
    """The page's numbers are those of native runs."""
    results = page.run("return results.map((columns) => columns.map((column) => [...column]))")
    for (time, *columns), recording in zip(results, recordings, strict=True):
        assert time == recording.time.tolist()
        for name, column in zip(recording.names, columns, strict=True):
            tolerance = RELATIVE * float(np.abs(recording[name]).max())
            np.testing.assert_allclose(column, recording[name], rtol=0.0, atol=tolerance, err_msg=name)


def refusal(page: OpenedPage) -> str:
    """Returns the message of a run that failed, "" if none did."""
    status = page.one("#status")
    return status.text if status.get_attribute("class") == "failed" else ""


def move(page: OpenedPage, name: str, share: float) -> float:
    """Moves a slider to a share of its way, waits for the new runs, and returns its value."""
    page.run("window.before = results")
    page.run(
        "const input = document.getElementById('sliders').elements[arguments[0]];"
        "input.value = arguments[1];"
        "input.dispatchEvent(new Event('input', {bubbles: true}))",
        name,
        share,
    )
    page.until(lambda: refusal(page) or page.run("return results !== window.before"))
    return page.run("return chosen(page.sliders.find(({name}) => name === arguments[0]))", name)


def test_runs_beside_each_other_have_the_numbers_of_native_runs(open_live: Open) -> None:
    extended, plain = loaded("nominal-extended"), loaded("nominal-l1")
    page = open_live(extended, plain)
    first, second = native(extended), native(plain)
    assert_equal(page, first, second)
    assert np.abs(first["plant.depth"] - second["plant.depth"]).max() > 0.01


def test_a_slider_leaves_what_differs_between_runs(open_live: Open) -> None:
    light, heavy = (
        with_experiment(loaded("nominal-l1", **{"plant.inertia": value}), stop_time=10.0)
        for value in (5.5, 7.0)
    )
    page = open_live(light, replace(heavy, title="heavy"))
    assert_equal(page, native(light), native(heavy))
    lighter = loaded("nominal-l1", **{"plant.inertia": move(page, "plant.inertia", 0.1)})
    assert_equal(page, native(with_experiment(lighter, stop_time=10.0)), native(heavy))


@pytest.mark.parametrize(
    ("name", "settings"),
    [
        ("nominal-extended", {"algorithm": "gauss-seidel", "extrapolation": 1}),
        ("nominal-extended", {"faults": FAULTS, "events": EVENTS, "record": FEW}),
        ("hold-jonswap-sea", {"step_sizes": {"controller": 0.1}, "extrapolation": 1}),
        ("hold-force-sine", {"start_time": 50.0, "stop_time": 60.0, "step_size": 0.03}),
    ],
)
def test_what_an_experiment_can_have_the_page_has(open_live: Open, name: str, settings: dict) -> None:
    one = replace(with_experiment(loaded(name), **{"stop_time": 10.0, **settings}), metrics={})
    assert_equal(open_live(one), native(one))


def test_a_slider_sets_what_a_setting_sets_and_the_button_takes_it_back(open_live: Open) -> None:
    extended, plain = loaded("nominal-extended"), loaded("nominal-l1")
    page = open_live(extended, plain)
    chosen = {
        "controller.proportional_gain": move(page, "controller.proportional_gain", 0.7),
        "plant.thruster_gain[1]": (thrust := move(page, "plant.thrust", 0.2)),
        "plant.thruster_gain[2]": thrust,
        "plant.buoyancy_change": move(page, "plant.buoyancy_change", 0.9),
    }
    assert thrust == pytest.approx(0.2 * 1.5**0.2)  # both limits are positive: it is logarithmic
    changed = [loaded(name, **chosen) for name in ("nominal-extended", "nominal-l1")]
    assert_equal(page, *map(native, changed))
    page.run("window.before = results")
    page.click(page.one("button[type=reset]"))
    page.until(lambda: page.run("return results !== window.before"))
    assert_equal(page, native(extended), native(plain))


@pytest.fixture
def of_user(tmp_path: Path) -> Scenario:
    for name in ("One", "Two"):
        (tmp_path / f"{name}.py").write_text(BLOCK.replace("{name}", name), encoding="utf-8")
    file = tmp_path / "loop.toml"
    file.write_text(LOOP, encoding="utf-8")
    loaded = scenario.load_scenario(file)
    build_missing(loaded.system.components.values())
    return loaded


def test_blocks_of_a_user_run_with_all_their_types(open_live: Open, of_user: Scenario) -> None:
    recording = native(of_user)
    assert recording["one.y"][0] == pytest.approx(2.0, rel=1e-11)
    assert {*recording["one.is_high"]} == {0.0, 1.0}
    assert recording["one.count"][-1] < recording["one.count"][0] == -3.0
    page = open_live(of_user, sliders=("one.gain=0:0.8",))
    assert_equal(page, recording)
    assert move(page, "one.gain", 1.0) == 0.8
    parameters = {**of_user.experiment.parameters, "one.gain": 0.8}
    assert_equal(page, native(with_experiment(of_user, parameters=parameters)))


def test_what_an_fmu_refuses_is_shown_and_the_last_runs_stay(open_live: Open, of_user: Scenario) -> None:
    page = open_live(of_user, sliders=("one.gain=0:0.9",))
    before = page.run("return results[0].map((column) => [...column])")
    assert refusal(page) == ""
    move(page, "one.gain", 1.0)
    assert "gain * stride < 1.7" in refusal(page)
    assert page.run("return results[0].map((column) => [...column])") == before
    move(page, "one.gain", 0.5)
    assert refusal(page) == ""


def test_charts_follow_the_sliders_and_signals_are_shown_by_their_buttons(open_live: Open) -> None:
    page = open_live(with_experiment(loaded("nominal-extended"), stop_time=5.0))

    def drawn() -> dict[str, list[float]]:
        return page.run(
            "const {chart} = panels[0].plot;"
            "const lines = chart.series.slice(1).map(({label}, i) => [label, [...chart.data[i + 1]]]);"
            "return Object.fromEntries(lines)"
        )

    def recorded() -> dict[str, list[float]]:
        columns = page.run("return results[0].map((column) => [...column])")
        names = page.run("return page.columns.map(({name}) => name)")
        every = dict(zip(names, columns[1:], strict=True))
        return {name: every[name] for name in ("controller.depth_reference", "plant.depth")}

    before = drawn()
    assert before == recorded()
    move(page, "plant.external_force", 1.0)
    assert drawn() == recorded()
    assert drawn()["controller.depth_reference"] == before["controller.depth_reference"]
    assert drawn()["plant.depth"] != before["plant.depth"]
    page.click(page.one("#panels .legend button[aria-pressed=false]"))  # measured_depth
    assert len(drawn()) == 3
    page.click(page.one("#panels .legend button"))
    assert len(drawn()) == 2


def metrics_shown(page: OpenedPage) -> dict[str, list[str]]:
    """Metric -> its value in each run, as the table beside the sliders has them."""
    return {
        row.find_element("tag name", "th").text.split()[0]: [
            cell.text for cell in row.find_elements("tag name", "td")
        ]
        for row in page.all("#metrics tbody tr")
    }


def test_settling_times_and_rmses_of_both_runs_follow_the_sliders(open_live: Open) -> None:
    """Four digits of what the functions of metrics.py give, which the scenario declares with windows."""
    extended, plain = loaded("nominal-extended"), loaded("nominal-l1")
    page = open_live(extended, plain)

    def expected(*scenarios: Scenario) -> dict[str, list[str]]:
        values = [metrics.evaluate(native(one), one.metrics) for one in scenarios]
        return {name: [f"{value[name]:#.4g}" for value in values] for name in ("settling_time", "rmse")}

    assert metrics_shown(page) == expected(extended, plain)
    value = move(page, "controller.proportional_gain", 0.8)
    stiffer = loaded("nominal-extended", **{"controller.proportional_gain": value})
    assert metrics_shown(page) == expected(stiffer, plain)
    short = with_experiment(extended, stop_time=30.0)  # on the way down
    assert metrics_shown(open_live(short))["settling_time"] == ["not settled"]


def test_on_paper_the_metrics_and_the_values_of_the_sliders_stand_without_the_sliders(
    open_live: Open,
) -> None:
    page = open_live(loaded("nominal-extended"))
    page.emulate(media="print")
    assert page.one(".controls td").is_displayed()
    assert page.one(".slider output").is_displayed()
    assert not any(one.is_displayed() for one in page.all(".controls input, .controls button"))


def test_a_slider_shows_from_when_on_an_event_sets_its_variable(open_live: Open) -> None:
    page = open_live(with_experiment(loaded("nominal-extended"), stop_time=15.0, events=EVENTS))
    (note,) = page.all(".slider small")
    assert note.text == "until 3.011 s, then an event sets it"
    assert note.find_element("xpath", "../input").get_attribute("name") == "plant.external_force"


def test_axes_have_the_names_of_their_quantities(open_live: Open) -> None:
    page = open_live(with_experiment(loaded("nominal-extended"), stop_time=5.0))
    titles = page.run(
        "return panels.filter(({plot}) => !plot.hidden).map(({plot: {chart}}) => chart.axes[1].label)"
    )
    assert titles == ["Depth [m]", "Force [N]"]


def test_times_that_a_drag_chooses_stay_chosen_when_a_slider_moves(open_live: Open) -> None:
    page = open_live(with_experiment(loaded("nominal-extended"), stop_time=10.0))

    def times() -> list[list[float]]:
        return page.run(
            "return panels.filter(({plot}) => !plot.hidden)"
            ".map(({plot: {chart}}) => [chart.scales.x.min, chart.scales.x.max])"
        )

    assert times() == [[0.0, 10.0]] * 2
    page.drag(page.one("#panels .plot"), 0.25, 0.5)
    assert times() == [[pytest.approx(2.5, abs=0.1), pytest.approx(5.0, abs=0.1)]] * 2
    move(page, "plant.external_force", 1.0)
    assert times() == [[pytest.approx(2.5, abs=0.1), pytest.approx(5.0, abs=0.1)]] * 2
