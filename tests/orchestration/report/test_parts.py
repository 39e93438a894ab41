"""Parts of a page that need no browser: TOML, embedded numbers, differences, statistics."""

import base64
import hashlib
import json
import math
import re
import tomllib
import zlib
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from orchestration.errors import OrchestrationError
from orchestration.report.embedded import COLUMNS, packed, run_data
from orchestration.report.find import found_results
from orchestration.report.render import differences, shortened
from orchestration.report.result import RunResult, SweepResult, correlations, distributions, strongest, toml
from orchestration.results.panels import drawn_points
from orchestration.scenarios import scenario

from .made_up import PROVENANCE, SCENARIO, recording, write_run

TEXTS = st.text(st.characters(exclude_categories=["Cs"]))
VALUES = st.recursive(
    TEXTS | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | st.booleans(),
    lambda inner: st.lists(inner, max_size=6) | st.dictionaries(TEXTS, inner, max_size=4),
    max_leaves=12,
)


@given(content=st.dictionaries(TEXTS, VALUES, max_size=4))
def test_toml_says_what_it_was_given(content: dict) -> None:
    assert tomllib.loads(toml(content)) == content


@pytest.mark.parametrize("name", scenario.shipped())
def test_shipped_scenarios_are_written_as_they_are(name: str) -> None:
    resolved = json.loads(json.dumps(scenario.load(scenario.find(name)).resolved))
    assert tomllib.loads(toml(resolved)) == resolved


def test_short_lists_stand_on_one_line() -> None:
    assert toml({"points": [[0.0, 1.5], [2.0, -1.0]]}) == "points = [\n    [0.0, 1.5],\n    [2.0, -1.0],\n]\n"
    assert toml({"names": ["a,  b[1]", "c"]}) == 'names = ["a,  b[1]", "c"]\n'


def test_a_scenario_that_toml_cannot_say_is_refused(tmp_path: Path) -> None:
    document = write_run(tmp_path, "dive", parameters={"plant.mass": None})
    with pytest.raises(OrchestrationError, match="expected values of TOML"):
        found_results([document])


def test_the_chart_library_is_as_it_was_published() -> None:
    """With the hashes that stand beside its licence."""
    files = resources.files("orchestration.results") / "page_files"
    hashes = re.findall(r"([0-9a-f]{64})  (\S+)", (files / "uplot.LICENSE").read_text())
    assert [name for _, name in hashes] == ["uplot.js", "uplot.css"]
    for expected, name in hashes:
        assert hashlib.sha256((files / name).read_bytes()).hexdigest() == expected


@given(
    points=st.integers(1, 12_000),
    few=st.lists(st.floats(-1e3, 1e3) | st.sampled_from([math.nan, math.inf]), min_size=1, max_size=50),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_decimated_line_keeps_ends_extremes_of_each_column_and_gaps(
    points: int, few: list[float], seed: int
) -> None:
    """Exactly; and no more than three points of a column, of steps of any length."""
    draw = np.random.default_rng(seed)
    time, values = np.cumsum(draw.exponential(size=points)), draw.choice(few, points)
    kept = drawn_points(time, values, COLUMNS)
    assert (np.diff(kept) > 0).all()
    if points <= 2 * COLUMNS:
        assert kept.tolist() == list(range(points))
        return
    assert (kept[0], kept[-1], len(kept) <= 3 * COLUMNS + 2) == (0, points - 1, True)
    column = ((time - time[0]) * (COLUMNS / (time[-1] - time[0]))).astype(int)
    for number in np.unique(column):
        whole, drawn = values[column == number], values[kept[column[kept] == number]]
        assert np.isfinite(whole).all() == np.isfinite(drawn).all()
        for extreme in (np.min, np.max):
            finite = [part[np.isfinite(part)] for part in (whole, drawn)]
            assert len(finite[0]) == 0 or extreme(finite[0]) == extreme(finite[1])


def test_a_long_run_is_embedded_with_its_extremes_and_the_steps_between_its_points() -> None:
    long = recording(points=15_501, step=0.02)
    long["plant.depth"][7_777] = 9.0
    data = run_data(RunResult("run", long))["signals"][0]
    values, steps = (unpacked(data[key]) for key in ("values", "steps"))
    assert len(values) == len(steps) <= 2 * COLUMNS + 2
    np.testing.assert_array_equal(values, long["plant.depth"][np.cumsum(steps).astype(int)])
    assert (values.max(), values.min()) == (9.0, long["plant.depth"].min())
    assert run_data(RunResult("run", recording()))["signals"][0]["steps"] == ""  # every point


def unpacked(text: str) -> np.ndarray:
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(8, -1)
    return np.frombuffer(planes.T.tobytes(), "<f8")


@given(values=arrays(np.float64, st.integers(0, 20), elements=st.floats(width=64)))
def test_embedded_numbers_are_exact(values: np.ndarray) -> None:
    assert unpacked(packed(values)).tobytes() == values.astype("<f8").tobytes()


def test_every_signal_of_a_metric_is_drawn_first() -> None:
    energy = {"function": "energy_residual", "signal": "plant.force", "flow": "plant.ratio", "unit": "J"}
    scenario_data = {**SCENARIO, "metrics": {**SCENARIO["metrics"], "energy": energy}}
    data = run_data(RunResult("run", recording(), scenario_data, PROVENANCE))
    assert data["in_metrics"] == [
        "plant.depth",
        "plant.depth - plant.reference",
        "plant.force",
        "plant.ratio",
        "plant.reference",
    ]


def test_differences_are_by_setting_and_the_many_are_counted() -> None:
    run = RunResult("run", recording(), SCENARIO, PROVENANCE)
    heavy = replace(
        run, name="heavy", scenario={**SCENARIO, "parameters": {"plant.mass": 7.0}, "title": "Heavy"}
    )
    other = replace(run, name="other", provenance={**PROVENANCE, "algorithm": "gauss-seidel"})
    assert differences([run, replace(run, name="again")]) == {}
    assert differences([run, heavy, other]) == {
        "parameters: plant.mass": {"7.0": "heavy", "5.5": "run, other"},
        "run: algorithm": {"gauss-seidel": "other", "jacobi": "run, heavy"},
    }
    many = [replace(run, name=f"run{i}") for i in range(4)]
    assert differences([heavy, *many]) == {"parameters: plant.mass": {"7.0": "heavy", "5.5": "the other 4"}}
    without = replace(run, name="without", scenario={k: v for k, v in SCENARIO.items() if k != "parameters"})
    assert differences([run, without])["parameters: plant.mass"] == {"5.5": "run", "absent": "without"}


@pytest.mark.parametrize(
    ("names", "shown"),
    [
        (["nominal-l1", "nominal-extended"], ["l1", "extended"]),
        (["x-l1-ideal", "x-l1-smooth-ideal"], ["ideal", "smooth-ideal"]),
        (["before/dive", "after/dive"], ["before", "after"]),
        (["a-l1-ideal", "b-l2-ideal"], ["a-l1", "b-l2"]),
        (["nominal", "nominal-l1"], ["nominal", "nominal-l1"]),
        (["a-b"], ["a-b"]),
        ([], []),
    ],
)
def test_names_are_shortened_to_the_parts_that_differ(names: list[str], shown: list[str]) -> None:
    assert list(shortened(names).values()) == shown


def test_the_error_of_a_run_is_scaled_as_its_rmse_and_stands_beside_its_signal() -> None:
    run = RunResult("run", recording(points=3), SCENARIO, PROVENANCE, metric_units={"rmse": "cm"})
    signals = run_data(run)["signals"]
    names = [signal["name"] for signal in signals]
    assert names[:3] == ["plant.depth", "plant.depth - plant.reference", "plant.reference"]
    error = signals[1]
    assert (error["unit"], error["error_of"], error["down"]) == ("cm", "m", False)
    difference = recording(points=3)["plant.depth"] - recording(points=3)["plant.reference"]
    np.testing.assert_array_equal(unpacked(error["values"]), 100.0 * difference)
    assert "plant.depth - plant.reference" in run_data(run)["in_metrics"]


def sweep(varied: list[float], metric: list[float], kinds: list[str] | None = None) -> SweepResult:
    count = len(metric)
    return SweepResult(
        "sweep",
        np.arange(count),
        {"plant.mass": varied, "plant.kind": kinds or ["a"] * count},
        {"rmse": np.array(metric)},
        ("",) * count,
        {"rmse": "m"},
        scenario={},
        provenance={},
        absent={},
        command="",
    )


def test_distributions_are_over_the_samples_that_have_a_number() -> None:
    (row,) = distributions(sweep([1.0, 2.0, 3.0, 4.0], [3.0, 1.0, math.nan, 2.0]))
    assert (row["group"], row["name"]) == (("a",), "rmse")
    assert list(row["values"].values()) == pytest.approx([3, 2.0, 1.0, 1.0, 1.1, 2.0, 2.9, 3.0])
    (one,) = distributions(sweep([1.0], [5.0]))
    assert list(one["values"].values()) == [1, 5.0, 0.0, 5.0, 5.0, 5.0, 5.0, 5.0]
    assert distributions(sweep([1.0], [math.nan]))[0]["values"] == {}


def test_every_text_that_is_varied_has_a_distribution_of_its_own() -> None:
    rows = distributions(sweep([1.0, 2.0, 3.0, 4.0], [1.0, 11.0, 3.0, 13.0], ["none", "pi", "none", "pi"]))
    assert [(row["group"], row["values"]["mean"]) for row in rows] == [(("none",), 2.0), (("pi",), 12.0)]


def coefficients(made: SweepResult) -> dict[tuple[str, str], float | None]:
    """(what is varied, group) -> its correlation with the metric."""
    return {(row["name"], *row["group"]): row["values"]["rmse"] for row in correlations(made)}


def test_what_a_metric_depends_on_names_texts_and_keeps_their_groups_apart() -> None:
    """The metric rises with the mass in one group and falls in the other; the text shifts its ranks."""
    kinds = ["none", "none", "pi", "pi"]
    assert coefficients(sweep([1.0, 2.0, 1.0, 2.0], [1.0, 2.0, 12.0, 11.0], kinds)) == {
        ("plant.mass", "none"): pytest.approx(1.0),
        ("plant.mass", "pi"): pytest.approx(-1.0),
        ("plant.kind", "all"): pytest.approx(2.0 / math.sqrt(5.0)),  # ranks 1, 2, 3, 4 of means 1.5 and 3.5
    }


def test_rank_correlations_are_of_ranks_and_of_what_varies() -> None:
    """Monotonic but not linear is 1; ties share a rank."""
    rising = sweep([1.0, 2.0, 3.0, 9.0], [0.0, 1.0, 100.0, math.nan])
    assert coefficients(rising)["plant.mass", "a"] == pytest.approx(1.0)
    assert strongest(correlations(rising)) == ("plant.mass", "rmse")
    tied = sweep([1.0, 1.0, 2.0], [1.0, 2.0, 3.0])
    assert coefficients(tied)["plant.mass", "a"] == pytest.approx(math.sqrt(3.0) / 2.0)
    constant = sweep([1.0, 1.0], [1.0, 2.0])
    assert set(coefficients(constant).values()) == {None}
    assert strongest(correlations(constant)) is None
