"""The scripts of the page of a score without a browser."""

from pathlib import Path
from typing import Any

import pytest

from orchestration.studies.score import score_rendering
from tests.orchestration.results.page_scripts import SHARED, evaluated

SCRIPTS = SHARED / "points.js", Path(score_rendering.__file__).parent / "files" / "score.js"


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
        score_row("e", 2.0, 3.5, [0.0, 0.0]),
        score_row("f", 2.5, 3.0, [0.0, 0.0]),
    ],
}


CASE = {"case": {"value": "c"}, "plant-metric": None}


def test_the_error_of_a_score_is_the_depth_less_its_reference_in_cm() -> None:
    drawn = (
        'charts.filter(({ options }) => options.axes[1].label === "Error [cm]")[0].data.map(([x, y]) => y)'
    )
    errors = evaluated(drawn, *SCRIPTS, page=SCORE, ids=CASE)
    assert [pytest.approx(error) for error in ([50.0, -30.0], [0.0, 0.0])] == errors


def test_the_front_of_a_score_has_what_no_other_beats_in_both_metrics() -> None:
    front = "front(page.rows).map((row) => row.name)"
    assert evaluated(front, *SCRIPTS, page=SCORE, ids=CASE) == [
        "b",
        "d",
        "a",
    ]
