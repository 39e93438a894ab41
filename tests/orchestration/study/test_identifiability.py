"""The study of what the figures determine: its stages, its summaries, and the page about it."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import qmc

from orchestration.results.formats import FigureFormat
from orchestration.scenarios import scenario
from orchestration.study import figure_fits, identifiability, posterior_summary
from orchestration.study.eight_figures import Fit
from orchestration.study.identifiability_tables import tables, write_points
from orchestration.study.open_numbers import FREE, FREQUENCY, VALUES
from orchestration.study.posterior import VARIANTS
from orchestration.study.stages import Stages, content_key, imported_sources
from orchestration.study.vehicle_runs import VehicleRuns

ROOT = Path(__file__).parents[3]
EXPLANATION = ROOT / "docs" / "explanation"
DOCUMENT = json.loads((EXPLANATION / "identification.json").read_text(encoding="utf-8"))
PAGE = (EXPLANATION / "identification.md").read_text(encoding="utf-8")


@pytest.fixture
def points() -> dict[str, np.ndarray]:
    """A hundred points over all ranges, with figures a little above the published ones."""
    shares = qmc.LatinHypercube(len(FREE), rng=1).random(100).T
    columns = {free.name: free.value(share) for free, share in zip(FREE, shares, strict=True)}
    figures = {" ".join(figure): value + np.linspace(0.0, 1.0, 100) for figure, value in VALUES.items()}
    return columns | figures | {"density": np.ones(100), "draw": np.arange(100)}


@pytest.mark.parametrize("name", tables(DOCUMENT))
def test_the_page_has_the_tables_of_the_study(name: str) -> None:
    assert tables(DOCUMENT)[name] in PAGE


def test_every_range_of_all_points_rests_on_enough_draws() -> None:
    for variant in DOCUMENT["variants"].values():
        assert variant["effective_draws"] >= identifiability.FULL.enough >= 200.0


def test_the_study_holds_what_the_code_asks_for() -> None:
    """So that a figure, a range or a reading that is added does not leave the page behind."""
    assert list(DOCUMENT["variants"]) == [variant.name for variant in VARIANTS]
    ranges = {"shipped ranges": figure_fits.SHIPPED_RANGES, "wide ranges": figure_fits.WIDE}
    for name, free in ranges.items():
        fit = DOCUMENT["fits"][name]
        assert list(fit["left_out"]) == [" ".join(figure) for figure in VALUES]
        assert set(fit["all"]["values"]) == {number.name for number in free}
        for number in free:
            assert number.low <= fit["all"]["values"][number.name] <= number.high


def test_the_shipped_parameter_file_is_the_fit_in_wide_ranges(tmp_path: Path) -> None:
    path = scenario.SHIPPED / "parameters" / "all-figures.toml"
    identifiability.write_parameters(DOCUMENT["fits"]["wide ranges"]["all"], tmp_path / "written.toml")
    written, shipped = (tomllib.loads(file.read_text()) for file in (tmp_path / "written.toml", path))
    assert written == shipped
    assert all("not a published value" in entry["source"] for entry in shipped["parameters"].values())


@pytest.mark.parametrize("name", ["nominal-extended", "buoyancy-l1"])
def test_a_scenario_takes_the_shipped_parameter_file(name: str) -> None:
    """Its figures are those that the study found with seed 1, to the four digits of the file."""
    path = scenario.SHIPPED / "parameters" / "all-figures.toml"
    values = {key: float(str(value)) for key, value in scenario.parameter_values(path).items()}
    with VehicleRuns() as runs:
        measured = runs.one(name, values)
    figures = DOCUMENT["fits"]["wide ranges"]["all"]["figures"]
    for metric, tolerance in (("settling_time", 0.1), ("rmse", 0.01)):
        _, low, high = figures[f"{name} {metric}"]
        assert low - tolerance <= measured[metric] <= high + tolerance


def test_a_stage_that_is_done_is_not_done_again(tmp_path: Path) -> None:
    done: list[str] = []

    def compute() -> dict[str, list[float]]:
        done.append("computed")
        return {"values": [1.0, 2.0]}

    names: list[str] = []
    for _ in range(2):
        stages = Stages(tmp_path, "key", names.append)
        assert stages.document("plain", compute) == {"values": [1.0, 2.0]}
        assert stages.arrays("columns", compute)["values"].tolist() == [1.0, 2.0]
    assert done == ["computed", "computed"]
    assert names == ["plain", "columns"] * 2


def test_a_stage_of_other_content_is_done_again(tmp_path: Path) -> None:
    file, computed = tmp_path / "source.py", list[str]()
    for text in ("a = 1\n", "a = 1\n", "a = 2\n"):
        file.write_text(text, encoding="utf-8")
        Stages(tmp_path, content_key([file])).document("plain", lambda text=text: computed.append(text))
    assert computed == ["a = 1\n", "a = 2\n"]


@pytest.mark.parametrize(
    ("enough", "expected"),
    [(1.0, ["draws-1-101"]), (1e9, ["draws-1-101", "draws-1-102", "draws-1-201", "draws-1-202"])],
)
def test_draws_that_are_not_enough_guide_another_round(
    tmp_path: Path, enough: float, expected: list[str]
) -> None:
    """The variant of 2 s, whose pilot is given, as it takes a while."""
    names = list[str]()
    stages = Stages(tmp_path, "key", names.append)
    guide = np.random.default_rng(1).uniform([0.25, 0.1], [0.45, 0.5], (20, 2))
    stages.arrays("pilot-1", lambda: {"positions": guide, "weights": np.ones(20), "runs": 0})
    effort = identifiability.Effort(rounds=2, batches=2, draws=100, extensions=4, enough=enough)
    points, counts = identifiability.posterior(stages, 1, effort)
    assert names[2:] == expected
    batches = [dict(np.load(tmp_path / "key" / f"{name}.npz")) for name in expected]
    assert len(points["draw"]) == counts["points"] == sum(len(batch["draw"]) for batch in batches)
    assert counts["draws"] == sum(len(np.unique(batch["draw"])) for batch in batches)
    assert counts["runs"] == sum(int(batch["runs"]) for batch in batches)


def test_a_key_is_of_what_the_study_imports_of_its_room() -> None:
    """And of what is imported by that; nothing of the score, and for the model nothing that runs FMUs."""
    study = Path(identifiability.__file__)
    every, model = (
        {path.name for path in imported_sources(file)} for file in (study, study.with_name("posterior.py"))
    )
    assert model == {"posterior.py", "proposal.py", "open_numbers.py", "depth_loop_model.py"}
    assert model | {"missing_effects.py", "eight_figures.py", "figure_fits.py", "vehicle_runs.py"} <= every
    assert not {"score.py", "identifiability_tables.py", "margins.py"} & every


def test_what_a_reader_sees_alone_is_no_content(tmp_path: Path) -> None:
    file, keys = tmp_path / "source.py", list[str]()
    for text in (
        "def f(x):\n    return x + 1\n",
        '"""What f is."""\n\n\ndef f(x):\n    """One more."""\n    return (x\n    + 1)  # more\n',
        "def f(x):\n    return x + 2\n",
    ):
        file.write_text(text, encoding="utf-8")
        keys.append(content_key([file], {"given": 1.0}))
    assert keys[0] == keys[1] != keys[2]
    assert content_key([file], {"given": 2.0}) != keys[2]


def test_a_result_of_other_rooms_is_content_of_the_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    """A figure of a run counts in the key of runs alone; a value of the vehicle counts in both."""
    model, runs = identifiability.model_key(), identifiability.runs_key()
    monkeypatch.setattr(VehicleRuns, "one", lambda *given: {"rmse": 0.0})
    assert identifiability.model_key() == model
    other_runs = identifiability.runs_key()
    heavier = {**identifiability.shipped_values(), "plant.inertia": 6.0}
    monkeypatch.setattr(identifiability, "shipped_values", lambda: heavier)
    assert identifiability.model_key() != model
    assert len({runs, other_runs, identifiability.runs_key()}) == 3


def test_the_summary_of_a_column_and_of_a_change(points: dict[str, np.ndarray]) -> None:
    ranges = posterior_summary.ranges(points)
    assert ranges["nominal-l1 rmse"] == pytest.approx([12.1, 12.12, 12.6, 13.07, 13.1], abs=0.01)
    assert ranges["change-l1 rmse"] == pytest.approx([1.7] * 5)
    assert (
        posterior_summary.ranges({name: column[:0] for name, column in points.items()})["plant.inertia"] == []
    )


def test_a_point_counts_by_its_density(points: dict[str, np.ndarray]) -> None:
    half = np.arange(100) < 50
    uneven = {**points, "density": np.where(half, 3.0, 1.0)}
    assert posterior_summary.share_of(uneven, half) == pytest.approx(0.75)
    assert posterior_summary.ranges(uneven)["nominal-l1 rmse"][2] == pytest.approx(12.1 + 1.0 / 3.0, abs=0.01)
    alone = {**points, "density": np.where(np.arange(100) < 1, 1.0, 1e-12)}
    assert max(posterior_summary.narrowed(alone).values()) < 0.01


def test_fast_is_what_adapts_fast_and_may_adapt_far() -> None:
    bounds = {"controller.sigma_bound": np.array([2.0, 2.0, 1.0, 2.0])}
    bounds["controller.theta_bound[1]"] = np.array([2.0, 2.0, 2.0, 1.0])
    fast = posterior_summary.is_fast({FREQUENCY: np.array([3.0, 1.0, 3.0, 3.0]), **bounds})
    assert fast.tolist() == [True, False, False, False]


def test_what_the_figures_do_not_narrow_is_one(points: dict[str, np.ndarray]) -> None:
    """The points of a hypercube are at random within their cells of 1 %."""
    assert list(posterior_summary.narrowed(points).values()) == pytest.approx([1.0] * len(FREE), rel=0.03)
    half = {free.name: free.value(np.linspace(0.25, 0.75, 100)) for free in FREE}
    half["density"] = np.ones(100)
    assert list(posterior_summary.narrowed(half).values()) == pytest.approx([0.5] * len(FREE), rel=0.03)


def test_numbers_that_depend_on_each_other_are_named(points: dict[str, np.ndarray]) -> None:
    product = {**points, "plant.inertia": 20.0 / points["plant.quadratic_damping"]}
    (pair,) = posterior_summary.correlations(product)
    assert pair[:2] == ("plant.quadratic_damping", "plant.inertia")
    assert (
        pair[2] < -0.95
    )  # the logarithm of the one is the negative logarithm of the other, seen over its range
    assert not posterior_summary.correlations(points)


def test_the_fits_begin_at_the_point_with_the_nearest_figures(points: dict[str, np.ndarray]) -> None:
    start = figure_fits.nearest_to_all(points)
    assert start == {free.name: points[free.name][0] for free in figure_fits.WIDE}


def test_a_fit_is_written_as_mean_and_range() -> None:
    fit = Fit({"gain": 2.0}, {("nominal-l1", "rmse"): np.array([12.0, 12.3])}, cost=0.123456)
    document = figure_fits.fit_document(fit)
    assert document == {
        "values": {"gain": 2.0}, "cost": 0.1235, "figures": {"nominal-l1 rmse": [12.15, 12.0, 12.3]},
    }  # fmt: skip


def test_the_figure_is_written(points: dict[str, np.ndarray], tmp_path: Path) -> None:
    (file,) = write_points({"one": points, "other": points}, tmp_path / "points", [FigureFormat.PNG])
    assert file.read_bytes().startswith(b"\x89PNG")
