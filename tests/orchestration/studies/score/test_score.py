"""A score: rows of controllers that run and of those that do not, and what the files hold of it."""

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from orchestration.errors import OrchestrationError, ScenarioError
from orchestration.studies.score import score_document
from orchestration.studies.score.closed_loop import ClosedLoop, Controller, tuned
from orchestration.studies.score.draws import drawn_cases, plants, repeated_cases
from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.score.score import run_count, score_controllers
from orchestration.studies.score.score_document import Row, Score
from orchestration.studies.score.score_rows import delay_margin_of
from orchestration.studies.score.score_tables import of_metric, over_draws, over_plants
from tests.foreign_fmus import Misdeed
from tests.orchestration.studies.score.controllers import rogue_doing
from tests.orchestration.studies.score.made_up_score import made_up_score
from tests.shared_builds import Build

Written = Callable[..., Path]
MINE = Controller("mine", "L1DepthController", parameters={"augmentation": "pi", "proportional_gain": 8.0})
SEED = 11


@pytest.fixture(scope="module")
def path(small_protocol: Written) -> Path:
    return small_protocol()


@pytest.fixture(scope="module")
def document(path: Path, rogue: Build) -> Score:
    """A full score of two controllers beside the one of the protocol."""
    controllers = [MINE, rogue_doing(rogue(), Misdeed.SEGFAULT)]
    done: list[int] = []
    result = score_controllers(
        controllers, read_protocol(path), full=True, seed=SEED, workers=2, progress=done.append
    )
    assert sum(done) == run_count(2, read_protocol(path), full=True) == 3 * (2 + 3 + 2 * 2)
    return result.document


def row(document: Score, name: str) -> Row:
    return next(row for row in document.rows if row.name == name)


@pytest.mark.slow
def test_a_row_has_the_metrics_of_the_loop_in_the_drawn_cases(document: Score, path: Path) -> None:
    mine, other = row(document, "mine"), row(document, "l1-pi")
    assert [mine.scored, other.scored] == [True, False]
    protocol = read_protocol(path)
    with ClosedLoop(MINE, protocol) as loop:
        for case in drawn_cases(protocol, SEED):
            metrics = loop.metrics(case)
            assert mine.cases[case.name].metrics == pytest.approx(metrics, nan_ok=True, rel=0.0)
    tuned = other.cases["nominal"].metrics["rmse"]
    assert tuned < mine.cases["nominal"].metrics["rmse"]
    assert mine.microseconds > 0.0


def test_a_full_row_has_many_draws_of_each_case(document: Score, path: Path) -> None:
    mine, protocol = row(document, "mine"), read_protocol(path)
    assert list(mine.draws) == list(mine.cases)
    with ClosedLoop(MINE, protocol) as loop:
        for draws in repeated_cases(protocol, SEED, 2):
            runs = mine.draws[draws[0].name]
            assert runs.metrics["rmse"].values == [loop.metrics(draw)["rmse"] for draw in draws]
            assert runs.metrics["rmse"].values[0] == mine.cases[draws[0].name].metrics["rmse"]
            assert (runs.count, runs.failed, runs.failure_rate) == (2, {}, 0.0)
            assert runs.failure_interval == (0.0, pytest.approx(1.0 - 0.025**0.5))
    crashed = row(document, "segfault").draws["nominal"]
    assert (crashed.failure_rate, list(crashed.failed)) == (1.0, ["0", "1"])


def test_a_row_has_the_delay_margin_of_each_draw_of_the_noise(document: Score, path: Path) -> None:
    mine, protocol = row(document, "mine"), read_protocol(path)
    with ClosedLoop(MINE, protocol) as loop:
        margins = [delay_margin_of(loop, draw) for draw in repeated_cases(protocol, SEED, 2)[0]]
    assert mine.delay_margins == margins
    assert min(margins) < mine.delay_margin == sum(margins) / 2.0
    assert math.isnan(row(document, "segfault").delay_margin)


def test_failure_rates_over_plants_stand_between_the_ends_of_their_intervals(document: Score) -> None:
    """Of three plants: none or all of them failed."""
    table = over_plants(document)
    assert table is not None
    assert [column.title for column in table.columns[:3]] == ["Failed", "Failed, at least", "Failed, at most"]
    shown = {
        row.name: [cell.value for cell in cells[:3]]
        for row, cells in zip(table.rows, table.cells, strict=True)
    }
    none = 0.025 ** (1.0 / 3.0)
    assert shown["mine"] == pytest.approx([0.0, 0.0, 100.0 * (1.0 - none)])
    assert shown["segfault"] == pytest.approx([100.0, 100.0 * none, 100.0])


def test_a_table_has_the_median_of_the_draws_and_marks_where_some_failed(document: Score) -> None:
    table = over_draws(document)
    assert table is not None
    assert [column.title for column in table.columns] == ["Nominal", "2 N step at 1 m"]
    cells = {row.name: row_cells[0] for row, row_cells in zip(table.rows, table.cells, strict=True)}
    first, second = row(document, "mine").draws["nominal"].metrics["rmse"].values
    assert (cells["mine"].value, cells["mine"].failed) == (min(first, second), ())
    assert cells["segfault"].failed == ("2 of 2 draws",)
    assert cells["l1-pi"].is_best
    score = document.model_copy(deep=True)
    score.rows[0].draws = {}
    assert over_draws(score) is None


def test_what_crashes_has_its_row_and_the_others_are_scored(document: Score) -> None:
    for case in row(document, "segfault").cases.values():
        assert case.failed == ["the worker process ended: SIGSEGV"]
    plants_of_it = row(document, "segfault").plants
    assert plants_of_it is not None
    assert plants_of_it.failed["2"] == ["not run: its process ended 3 times before"]
    assert plants_of_it.failure_rate == 1.0
    assert plants_of_it.metrics["rmse"].median == math.inf
    assert not any(case.failed for case in row(document, "mine").cases.values())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("misdeed", "reason"),
    [
        (Misdeed.ERROR, r"controller at t = 1\S* s: fmi2DoStep returned error"),
        (Misdeed.NAN_OUTPUT, "expected a finite"),
    ],
)
def test_a_failure_is_told_in_the_words_of_the_run(
    path: Path, rogue: Build, misdeed: Misdeed, reason: str
) -> None:
    bad, good = score_controllers([rogue_doing(rogue(), misdeed)], read_protocol(path)).document.rows
    for case in bad.cases.values():
        (complaint,) = case.failed
        assert re.search(reason, complaint), complaint
    assert not any(case.failed for case in good.cases.values())


@pytest.mark.slow
def test_what_hangs_is_asked_for_nothing_more(path: Path, rogue: Build) -> None:
    hanging = rogue_doing(rogue(), Misdeed.HANG)
    hung, mine, _ = score_controllers([hanging, MINE], read_protocol(path), timeout=20.0).document.rows
    first, second = (case.failed for case in hung.cases.values())
    assert first == ["it took longer than the timeout of 20 s"]
    assert second == ["not run: it took too long before"]
    assert not mine.cases["nominal"].failed


def test_what_does_not_fit_the_vehicle_is_refused_before_anything_runs(path: Path) -> None:
    wrong = replace(MINE, parameters={"velocity_source": "speedometer"})
    with pytest.raises(OrchestrationError, match=r"velocity_source = 'speedometer': expected one of"):
        score_controllers([wrong], read_protocol(path))
    with pytest.raises(ScenarioError, match=r"two controllers are called 'mine'"):
        score_controllers([MINE, MINE], read_protocol(path))


def test_all_controllers_get_the_same_plants(document: Score, path: Path) -> None:
    protocol = read_protocol(path)
    mine, other = row(document, "mine").plants, row(document, "l1-pi").plants
    assert mine is not None
    assert other is not None
    with ClosedLoop(tuned(protocol, "l1-pi"), protocol) as loop:
        cases = plants(protocol, SEED)
        assert other.metrics["rmse"].values == [loop.metrics(case, names=["rmse"])["rmse"] for case in cases]
    (difference,) = [
        entry
        for entry in document.differences
        if (entry.scored, entry.other, entry.metric) == ("mine", "l1-pi", "rmse")
    ]
    pairs = zip(mine.metrics["rmse"].values, other.metrics["rmse"].values, strict=True)
    assert difference.median_difference == sorted(a - b for a, b in pairs)[1]
    assert difference.p == 0.25  # 2 of the 2^3 signs
    assert difference.p_holm == difference.p  # the only pair: there is none with what crashes


@pytest.mark.slow
def test_the_document_is_what_its_schema_says_and_reads_back(document: Score) -> None:
    import jsonschema  # costs a second

    text = document.model_dump_json()
    schema = json.loads(score_document.SCHEMA.read_text(encoding="utf-8"))
    jsonschema.validate(json.loads(text), schema)
    assert json.loads(text)["rows"][0]["cases"]["hold-step"]["metrics"]["lag"] is None
    back = Score.model_validate_json(text)
    assert math.isnan(back.rows[0].cases["hold-step"].metrics["lag"])
    assert back.model_dump_json() == text


def test_the_shipped_schema_is_that_of_the_types() -> None:
    assert score_document.SCHEMA.read_text(encoding="utf-8") == score_document.schema()


def test_a_run_that_failed_is_not_the_best_also_with_the_best_number() -> None:
    document = made_up_score().document
    best, failed = row(document, "pid").cases["nominal"], row(document, "l1").cases["nominal"]
    failed.metrics["rmse"] = best.metrics["rmse"]
    cells = of_metric(document, "rmse").cells
    marks = {shown.name: cells[i][0].is_best for i, shown in enumerate(document.rows)}
    assert failed.failed
    assert marks == {"mine": False, "pid": True, "l1": False}
