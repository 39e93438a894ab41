"""The pages' scripts without a browser: what they compute and hand to the charts, in Node.js."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from orchestration.report import render
from orchestration.results import metrics
from orchestration.results.recording import Recording
from tests.orchestration.results.page_scripts import SHARED, evaluated

FILES = Path(render.__file__).with_name("files")


@pytest.mark.parametrize(("down", "direction"), [(True, -1), (False, 1)])
def test_a_depth_grows_downwards(down: bool, direction: int) -> None:
    lines = '[{ label: "z", x: [0, 1], y: [2, null] }]'
    drawn = f"(chart(document.body, {lines}, {{ down: {json.dumps(down)} }}), charts[0].options.scales.y.dir)"
    assert evaluated(drawn, page={}) == direction


def test_every_value_of_a_histogram_is_in_a_bin() -> None:
    """The largest one is in the last, and values that are no numbers in none."""
    first = '{ label: "a", color: "#111111", values: [-2, -1.9, 0, 3, NaN, 3] }'
    groups = f'[{first}, {{ label: "b", color: "", values: [0.5] }}]'
    drawn = f"(histogram(document.body, {groups}), charts[0].data.map(([x, y]) => [x[0], x.at(-1), y]))"
    (least, last, counts), (*_, others) = evaluated(drawn, SHARED / "points.js", page={})
    assert (least, last) == (-2.0, pytest.approx(2.75))
    assert (len(counts), sum(counts), counts[0], counts[-1]) == (20, 5, 2, 2)
    assert (sum(others), others[10]) == (1, 1)


LIVE: dict[str, Any] = {
    "columns": [],
    "panels": [],
    "metrics": [],
    "runs": [{"label": "a", "values": [2.0, 3.0, 9.0]}, {"label": "b", "values": [2.0, 4.0, 9.0]}],
    "sliders": [
        {"name": "p", "indices": [0], "low": 1.0, "high": 100.0, "isLogarithmic": True, "value": 2.0},
        {"name": "q", "indices": [1], "low": -4.0, "high": 6.0, "isLogarithmic": False, "value": 3.0},
    ],
}


def test_a_slider_has_the_value_of_its_place_between_the_limits_and_back() -> None:
    at = "page.sliders.map((slider) => [0, 0.25, 1].map((x) => valueAt(slider, x)))"
    logarithmic, linear = evaluated(at, FILES / "live.js", page=LIVE)
    assert logarithmic == pytest.approx([1.0, 100.0**0.25, 100.0])
    assert linear == [-4.0, -1.5, 6.0]
    back = "page.sliders.map((slider) => [0, 0.25, 1].map((x) => share(slider, valueAt(slider, x))))"
    assert evaluated(back, FILES / "live.js", page=LIVE) == [pytest.approx([0.0, 0.25, 1.0])] * 2


def test_sliders_change_every_run_but_where_it_differs_from_the_first() -> None:
    run = (
        "(simulate = (program, own) => (charts.push([...own]), [new Float64Array(1)]), "
        "chosen = ({ name }) => ({ p: 7, q: 8 })[name], runAll({}), charts)"
    )
    assert evaluated(run, FILES / "live.js", page=LIVE) == [[7.0, 8.0, 9.0], [7.0, 4.0, 9.0]]


@pytest.mark.parametrize("window", [None, [1.0, 3.0], [2.0, 9.0]])
def test_metrics_of_the_live_page_are_those_of_a_recording(window: list[float] | None) -> None:
    """Settled in the window to 3 s, at the end of which the error is large again; settled from the start."""
    time = np.arange(6.0)
    run = Recording(
        ("a.y", "a.r"), ("m", "m"), time, np.array([[0, 2, 1, 1.05, 1, 9], [1, 1, 1, 1, 1, 2.0]]).T
    )
    calls: list[dict[str, Any]] = [
        {"function": "settling_time", "signal": "a.y", "target": 1.0, "band": 0.1},
        {"function": "settling_time", "signal": "a.y", "target": 1.0, "band": 9.0},
        {"function": "rmse", "signal": "a.y", "reference": "a.r", "scale": 100.0},
    ]
    declared = {str(i): call | ({"window": window} if window else {}) for i, call in enumerate(calls)}
    page = {
        **LIVE,
        "columns": [{"name": name, "shown": True} for name in run.names],
        "metrics": [*declared.values()],
    }
    columns = json.dumps([time.tolist(), *run.values.T.tolist()])
    of_run = f"{columns}.map((column) => Float64Array.from(column))"
    expression = f"page.metrics.map((metric) => String(measured(metric, {of_run})))"
    shown = [*map(float, evaluated(expression, FILES / "live.js", page=page))]
    assert shown == pytest.approx([*metrics.evaluate(run, declared).values()], rel=1e-14, nan_ok=True)  # sums


def test_the_difference_of_two_runs_is_taken_on_lines_between_the_points_of_the_first() -> None:
    def run(name: str, time: list[float], values: list[float]) -> dict[str, Any]:
        signal = {"name": "z", "unit": "m", "values": values, "error_of": None, "steps": None, "down": True}
        facts = {"name": name, "label": name, "is_measured": False, "in_metrics": ["z"]}
        return {**facts, "time": time, "signals": [signal]}

    runs = [
        run("base", [0.0, 4.0, 6.0], [1.0, 9.0, 5.0]),
        run("other", [-1.0, 1.0, 5.0, 6.0], [0.0, 4.0, 2.0, 5.0]),
    ]
    drawn = "charts[0].data[0]"
    time, difference = evaluated(
        drawn, FILES / "signals.js", page={"runs": runs, "axes": {}}, ids={"view": {"value": "0"}}
    )
    assert list(time.values()) == [-1.0, 1.0, 5.0, 6.0]
    assert difference == [None, 1.0, -5.0, 0.0]


def column(name: str, kind: str, values: list[float]) -> dict[str, Any]:
    return {"name": name, "unit": "", "kind": kind, "values": values}


def drawn_points(shown: str, place: int, **changes: Any) -> Any:
    """What the points of a sweep's first drawing are, or of its last one (-1)."""
    sweep = {
        "samples": [5.0, 7.0, 9.0],
        "first": ["k", "rmse"],
        "grid": None,
        "groups": [{"name": "all", "members": [0, 1, 2]}],
        "columns": [column("k", "varied", [10.0, 9.0, -3.0]), column("rmse", "metric", [4.0, 5.0, 6.0])],
    }
    ids = {"section.sweep": [{"dataset": {"sweep": "0"}}], "sweeps-compared": None}
    replaced = f"scatter = (place, points) => charts.push(points.map({shown}))"
    drawn = f"({replaced}, charts.length = 0, redrawAll().then(() => charts.at({place})))"
    page = {"sweeps": [sweep | changes], "compared": []}
    return evaluated(drawn, SHARED / "points.js", FILES / "sweeps.js", page=page, ids=ids)


def test_a_point_of_a_sweep_is_its_sample() -> None:
    assert drawn_points("({ sample }) => sample", -1) == [5.0, 7.0, 9.0]


def test_a_map_has_its_numbers_in_ascending_order() -> None:
    assert drawn_points("({ x, y, share }) => [x, y, share]", 0, grid=["k", "k"]) == [
        [2, 2, 0.0],
        [1, 1, 0.5],
        [0, 0, 1.0],
    ]


@pytest.mark.parametrize(
    ("least", "largest", "ends"), [(-4, -4, [-4.2, -3.8]), (0, 0, [-1, 1]), (-3, 1, [-3.2, 1.2])]
)
def test_an_axis_of_points_has_room_about_them(least: float, largest: float, ends: list[float]) -> None:
    padded = f"padded(null, {least}, {largest})"
    assert evaluated(padded, SHARED / "points.js", page={}) == pytest.approx(ends)
