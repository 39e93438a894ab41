"""A score as one interactive page: tables, tracking, the price of accuracy, plants, and what failed."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from orchestration.results.page import packed, page
from orchestration.studies.score.score import ScoreResult
from orchestration.studies.score.score_document import Score
from orchestration.studies.score.score_tables import all_tables

_TEMPLATE = Path(__file__).parent / "files" / "score.html"
_SCRIPTS = ("points.js", "tables.js", "score.js")
_LINES = ("depth", "u")
# whole numbers compress to a quarter of the size
_SCALE = 1e4


def score_page(result: ScoreResult, title: str) -> str:
    """Returns the page of a score or of a comparison."""
    score = result.document
    return page(
        _TEMPLATE,
        _SCRIPTS,
        title=title,
        score=score,
        tables=all_tables(score),
        titles={row.name: row.title for row in score.rows},
        data=_data(result),
    )


def _data(result: ScoreResult) -> dict[str, Any]:
    """Returns the data that the scripts draw."""
    score = result.document
    document = score.model_dump(mode="json", include={"protocol", "rows"})
    for row in document["rows"]:
        traces = result.traces.get(row["name"], {})
        row["traces"] = {
            case: {line: _scaled(trace[line]) for line in _LINES} for case, trace in traces.items() if trace
        }
    return {
        **document,
        "shown": preselected(score),
        "references": _references(result, score),
        "scale": _SCALE,
    }


def preselected(score: Score) -> list[str]:
    """Returns the names of the rows that are drawn at first: the scored rows, and three others.

    Of those that are ranked: the least RMSE, the least total variation and the longest delay margin in the
    nominal case.
    """
    nominal = score.nominal
    others = [row for row in score.rows if not (row.scored or row.unranked or row.cases[nominal].failed)]
    metrics = {row.name: row.cases[nominal].metrics for row in others}
    keys = [
        {name: known.get("rmse", math.inf) for name, known in metrics.items()},
        {name: known.get("total_variation", math.inf) for name, known in metrics.items()},
        {row.name: -row.delay_margin if math.isfinite(row.delay_margin) else math.inf for row in others},
    ]
    names = [row.name for row in score.scored]
    for key in keys:
        names += sorted(key.keys() - set(names), key=lambda name, key=key: (key[name], name))[:1]
    return names


def _references(result: ScoreResult, score: Score) -> dict[str, dict[str, str]]:
    """Returns case -> times and reference, which all controllers have in common."""
    references: dict[str, dict[str, str]] = {}
    for case in score.protocol.cases:
        traces = [rows[case] for rows in result.traces.values() if rows.get(case)]
        if traces:
            longest = max(traces, key=lambda trace: len(trace["time"]))
            references[case] = {name: _scaled(longest[name]) for name in ("time", "reference")}
    return references


def _scaled(values: Sequence[float]) -> str:
    return packed(np.round(_SCALE * np.array(values)))
