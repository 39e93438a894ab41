"""Sweeps, clicked through in a browser."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from orchestration.report.find import found_results
from orchestration.report.result import SweepResult, common_metrics, paired_differences
from orchestration.results.statistics import paired
from orchestration.sweep import table
from tests.orchestration.results.opened import OpenedPage

from .made_up import FAILED, write_sweep

Open = Callable[..., OpenedPage]


@pytest.fixture
def swept(opened: Open, tmp_path: Path) -> OpenedPage:
    return opened(write_sweep(tmp_path))


@pytest.fixture
def rows(tmp_path: Path) -> list[dict[str, Any]]:
    """The same, as the file has them."""
    return table.read(write_sweep(tmp_path))[0].to_pylist()


def succeeded(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if not row["error"]]


def points(page: OpenedPage) -> dict[str, list[Any]]:
    return page.run(
        "const {points} = document.querySelector('.scatter');"
        "return {x: points.map((point) => point.x), y: points.map((point) => point.y)}"
    )


def facts(page: OpenedPage) -> dict[str, str]:
    """What is shown of the chosen sample."""
    names, values = (page.all(f".chosen {tag}") for tag in ("dt", "dd"))
    return {name.text: value.text for name, value in zip(names, values, strict=True)}


def test_every_metric_has_its_histogram_of_the_samples_that_succeeded(
    swept: OpenedPage, rows: list[dict[str, Any]]
) -> None:
    counts = swept.run(
        "return [...document.querySelectorAll('.histograms .plot')]"
        ".map(({chart}) => chart.data[1].reduce((sum, count) => sum + count, 0))"
    )
    metrics = [name for name in rows[0] if not name.startswith(("plant.", "sample", "warned", "error"))]
    assert counts == [len(rows) - len(FAILED)] * len(metrics)
    bins = swept.run("return document.querySelectorAll('.histograms .plot')[arguments[0]].chart.data", 1)
    of_rmse, edges = np.histogram([row["rmse"] for row in succeeded(rows)], bins=20)
    assert bins == [pytest.approx(edges[:-1]), of_rmse.tolist()]
    captions = [caption.text for caption in swept.all(".histograms figcaption")]
    assert [caption.split(" [")[0] for caption in captions] == metrics
    assert "rmse [cm]" in captions


def test_at_first_the_strongest_dependence_is_drawn(swept: OpenedPage, rows: list[dict[str, Any]]) -> None:
    assert points(swept)["x"] == [row["plant.inertia"] for row in succeeded(rows)]


def test_the_selects_choose_what_is_drawn_against_what(swept: OpenedPage, rows: list[dict[str, Any]]) -> None:
    swept.choose(".across", "plant.inertia [kg]").choose(".up", "rmse [cm]")
    drawn = points(swept)
    assert drawn["x"] == [row["plant.inertia"] for row in succeeded(rows)]
    assert drawn["y"] == [row["rmse"] for row in succeeded(rows)]
    titles = swept.run("return document.querySelector('.scatter').chart.axes.map((axis) => axis.label)")
    assert titles == ["plant.inertia [kg]", "rmse [cm]"]
    swept.choose(".across", "sample")
    assert points(swept)["x"] == [row["sample"] for row in succeeded(rows)]
    swept.choose(".up", "sample")
    assert points(swept)["x"] == list(range(len(rows)))


def test_a_click_on_a_point_shows_its_sample_and_how_to_run_it_again(
    swept: OpenedPage, rows: list[dict[str, Any]]
) -> None:
    swept.choose(".across", "plant.inertia [kg]").choose(".up", "holding_thrust [N]")
    sample = max(range(len(rows)), key=lambda i: rows[i]["plant.inertia"])  # at the edge: nothing covers it
    at = rows[sample]["plant.inertia"], rows[sample]["holding_thrust"]
    swept.point_at(swept.one(".scatter"), *at)
    assert swept.one(".scatter .tip").text.startswith(f"sample {sample}: ")
    swept.click_point(swept.one(".scatter"), *at)
    swept.until(lambda: facts(swept))
    assert swept.one(".chosen h4").text == f"Sample {sample}"
    assert float(facts(swept)["plant.inertia [kg]"]) == rows[sample]["plant.inertia"]
    assert float(facts(swept)["holding_thrust [N]"]) == rows[sample]["holding_thrust"]
    assert swept.one(".chosen code").text == f"l1-depth sweep monte-carlo --sample {sample}"
    assert points(swept)["x"][len(succeeded(rows)) :] == [rows[sample]["plant.inertia"]]  # the ring


def test_a_sample_is_found_by_its_number_also_one_that_failed(swept: OpenedPage) -> None:
    swept.write("input.sample", "7")
    assert FAILED[7] in swept.one(".chosen").text
    assert "plant.inertia [kg]" in facts(swept)
    assert "rmse [cm]" not in facts(swept)
    swept.write("input.sample", "100")
    assert swept.one(".chosen").text == "No sample 100: expected 0 to 99."


def test_failed_samples_are_listed_with_their_errors(swept: OpenedPage, rows: list[dict[str, Any]]) -> None:
    failures = swept.all(".failures tbody tr")
    assert len(failures) == len(FAILED)
    for row, (sample, error) in zip(failures, FAILED.items(), strict=True):
        assert row.text.startswith(str(sample))
        assert error in row.text
        assert str(rows[sample]["plant.sensor_seed"]) in row.text


def test_a_sweep_that_failed_altogether_lists_its_errors(opened: Open, tmp_path: Path) -> None:
    path = write_sweep(tmp_path)
    read, _ = table.read(path)
    failed = [{"sample": 0, "error": "all is lost"}]
    table.write((json.dumps(row).encode() for row in failed), read.schema, path)
    page = opened(path)
    assert "1 sample of" in page.one("section.sweep").text
    assert "all is lost" in page.one("section.sweep").text
    assert page.all(".scatter") == []


def test_ticks_of_a_narrow_histogram_are_different_numbers(opened: Open, tmp_path: Path) -> None:
    page = opened(write_sweep(tmp_path))
    page.run(
        "const [place] = document.querySelectorAll('.histograms .plot');"
        "histogram(place, [{label: '', color: '#000000', values: [1.2073, 1.2075, 1.2084]}]);"
    )
    page.settled()
    page.until(lambda: page.run("return document.querySelector('.histograms .plot').chart.axes[0]._values"))
    ticks = page.run("return document.querySelector('.histograms .plot').chart.axes[0]._values")
    assert len(ticks) == len(set(ticks)) > 1


def test_texts_are_varied_too(opened: Open, tmp_path: Path) -> None:
    path = write_sweep(tmp_path)
    read, _ = table.read(path)
    column = read.schema.get_field_index("plant.sensor_seed")
    kinds = ["pi", "none"] * (len(read) // 2)
    field = read.schema.field(column).with_type(pa.string())
    pq.write_table(read.set_column(column, field, [kinds]), path)
    page = opened(path).choose(".across", "plant.sensor_seed")
    drawn = succeeded(table.read(path)[0].to_pylist())
    names = ["pi", "none"]
    assert [names[x] for x in points(page)["x"]] == [row["plant.sensor_seed"] for row in drawn]
    assert page.run("return document.querySelector('.scatter').chart.axes[0].values()") == names
    bars = page.run(
        "return [...document.querySelectorAll('.histograms .plot')]"
        ".map(({chart}) => chart.series.slice(1).map((bars) => bars.label))"
    )
    assert bars == [names] * len(bars)  # apart, and in colours that the legend names
    assert [" ".join(group.text.split()) for group in page.all(".groups > span")] == [
        "\u25cf pi",
        "\u25c6 none",
    ]
    assert len(page.all(".distributions tbody tr")) == 2 * len(bars)
    assert any(row.text.startswith("plant.sensor_seed all ") for row in page.all(".correlations tbody tr"))


def on_a_grid(path: Path, kinds: tuple[str, ...] = ()) -> tuple[list[float], list[float]]:
    """Varies inertia and buoyancy on a grid of 3 x 4, and the seed, which is a text then, or not at all."""
    read, _ = table.read(path)
    heavy, light = [5.0, 6.0, 7.0], [-0.2, 0.0, 0.2, 0.4]
    points = [(kind, x, y) for kind in kinds or ("",) for x in heavy for y in light]
    columns = {name: read[name] for name in ("sample", "rmse", "holding_thrust", "error")}
    columns |= {
        name: pa.array([p[i] for p in points])
        for i, name in ((1, "plant.inertia"), (2, "plant.buoyancy_change"))
    }
    if kinds:
        columns["plant.sensor_seed"] = pa.array([kind for kind, _, _ in points])
    fields = [read.schema.field(name).with_type(column.type) for name, column in columns.items()]
    schema = pa.schema(fields, read.schema.metadata)
    pq.write_table(pa.Table.from_arrays([*columns.values()], schema=schema), path)
    return heavy, light


def test_a_grid_of_two_numbers_is_a_map_of_each_metric(opened: Open, tmp_path: Path) -> None:
    """The failed samples are no cells, and a press on a cell shows its sample. A grid has no histograms."""
    path = write_sweep(tmp_path, 12)
    heavy, light = on_a_grid(path)
    page = opened(path).choose(".mapped", "rmse [cm]")
    assert not page.all(".histograms figure")
    rows = table.read(path)[0].to_pylist()
    cells = page.run("return document.querySelector('.map').points")
    assert {(heavy[c["x"]], light[c["y"]]): c["label"] for c in cells} == {
        (row["plant.inertia"], row["plant.buoyancy_change"]): f"{row['rmse']:.3g}"
        for row in rows
        if not row["error"]
    }
    assert {min(c["share"] for c in cells), max(c["share"] for c in cells)} == {0.0, 1.0}
    titles = page.run("return document.querySelector('.map').chart.axes.map((axis) => axis.label)")
    assert titles == ["plant.inertia [kg]", "plant.buoyancy_change [N]"]
    page.click_point(page.one(".map"), 2, 1)
    page.until(lambda: facts(page))
    assert (facts(page)["plant.inertia [kg]"], facts(page)["plant.buoyancy_change [N]"]) == ("7", "0")


def test_each_group_of_a_grid_has_its_map(opened: Open, tmp_path: Path) -> None:
    path = write_sweep(tmp_path, 24)
    on_a_grid(path, ("pi", "none"))
    page = opened(path)
    captions = [caption.text for caption in page.all(".maps figcaption")]
    assert captions == ["rmse [cm], pi", "rmse [cm], none"]


def test_other_sweeps_are_no_grid(tmp_path: Path) -> None:
    (drawn,) = found_results([write_sweep(tmp_path, 12)])
    assert isinstance(drawn, SweepResult)
    assert table.grid(drawn.varied) is None
    numbers = {"a.x": [1.0, 2.0, 1.0, 2.0], "a.y": [1.0, 1.0, 2.0, 2.0]}
    assert table.grid(numbers) == ("a.x", "a.y")
    assert table.grid({**numbers, "a.y": [1.0, 1.0, 2.0, 3.0]}) is None
    assert table.grid({**numbers, "a.y": [1.0] * 4}) is None


def test_several_sweeps_stand_in_one_table_with_overlaid_histograms_and_paired_differences(
    opened: Open, tmp_path: Path
) -> None:
    """The same samples with an RMSE that is 0.5 cm larger; one of them varies another value there."""
    base, other = write_sweep(tmp_path, 40, "base"), write_sweep(tmp_path, 40, "other", shift=0.5)
    read, _ = table.read(other)
    rows = read.to_pylist()
    rows[3]["plant.inertia"] += 1.0
    table.write((json.dumps(row).encode() for row in rows), read.schema, other)
    page = opened(base, other)
    pairs = 40 - len(FAILED) - 1
    shown = [row.text.split() for row in page.all(".compared tbody tr") if row.text.startswith("rmse")]
    assert [row[:4] for row in shown] == [["rmse", "cm", name, "38"] for name in ("base", "other")]
    assert float(shown[1][4]) - float(shown[0][4]) == pytest.approx(0.5, abs=1e-3)  # shown with five digits
    (row,) = [row for row in page.all(".paired tbody tr") if row.text.startswith("other rmse")]
    _, _, unit, count, median, low, high, p = row.text.split()
    assert (unit, count, median, low, high) == ("cm", str(pairs), "0.5", "0.5", "0.5")
    tests = len(page.all(".paired tbody tr"))
    assert float(p) < 1e-3 * tests  # all differences have one sign
    (row,) = [row for row in page.all(".paired tbody tr") if row.text.startswith("other holding_thrust")]
    assert row.text.split()[4:] == ["0", "0", "0", "1"]
    counts = page.run(
        "return [...document.querySelectorAll('#sweeps-compared .histograms .plot')]"
        ".map(({chart}) => chart.data.slice(1).map((bars) => bars.reduce((sum, count) => sum + count, 0)))"
    )
    assert counts == [[38, 38]] * len(counts)
    captions = [caption.text for caption in page.all("#sweeps-compared .histograms figcaption")]
    assert captions[:2] == ["settling_time [s]", "rmse [cm]"]  # in the order of the table
    assert [" ".join(group.text.split()) for group in page.all("#sweeps-compared .groups > span")] == [
        "\u25cf base",
        "\u25c6 other",
    ]
    page.click(page.all(".paired th button")[4])
    assert page.all(".paired tbody tr")[-1].text.startswith("other rmse")


def test_the_intervals_of_a_metric_hold_together(tmp_path: Path) -> None:
    (one,) = found_results([write_sweep(tmp_path, 30)])
    assert isinstance(one, SweepResult)
    random = np.random.default_rng(1)
    first, *others = (
        replace(one, name=name, metrics={"rmse": random.normal(size=30)}, errors=("",) * 30) for name in "abc"
    )
    for row, other in zip(paired_differences([first, *others]), others, strict=True):
        assert row["test"] == paired(other.metrics["rmse"], first.metrics["rmse"], comparisons=2)
        assert row["test"].interval != paired(other.metrics["rmse"], first.metrics["rmse"]).interval
        assert row["p"] >= row["test"].p


def test_sweeps_that_vary_nothing_in_common_have_no_pairs(tmp_path: Path) -> None:
    (one,) = found_results([write_sweep(tmp_path, 5)])
    assert isinstance(one, SweepResult)
    varied = {f"other.{name}": values for name, values in one.varied.items()}
    rows = paired_differences([one, replace(one, name="other", varied=varied)])
    assert [row["test"].pairs for row in rows] == [0] * len(one.metrics)
    assert common_metrics([one]) == {}
    units = {**one.units, "rmse": "m"}
    assert "rmse" not in common_metrics([one, replace(one, units=units)])
