"""A score as the text of a terminal and as one interactive page, both of the tables of `score_tables`."""

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from orchestration.studies.score.score import ScoreResult
from orchestration.studies.score.score_document import Score
from orchestration.studies.score.score_tables import Cell, all_tables, overview

_BEST, _FAILED = "*", "!"
_MARKS = (
    f"{_BEST} the best of a column, {_FAILED} a run that failed, - no value, such as the delay margin "
    "of a loop that is not quiet without a delay"
)
_MOST_LINES = 40  # of a terminal
_MOST_ROWS = 20  # of its table, the scored controllers first
_FILE_LINES = 4  # the heading of the files, their two names, and that a controller failed every case
_COLUMN_WIDTH = 13  # with its padding and its edge
_PADDING = 3
_TEMPLATE = Path(__file__).parent / "files" / "score.html"
_SCRIPTS = ("points.js", "tables.js", "score.js")
_LINES = ("depth", "u")
# whole numbers compress to a quarter of the size
_SCALE = 1e4


def terminal_text(score: Score, console: Console) -> str:
    """Returns the summary of a score, why controllers are not ranked and why runs failed.

    These are at most 40 lines with the names of the files, which the command prints below.
    """
    protocol, width = score.protocol, console.width
    with console.capture() as captured:
        console.print(_summary(score, width))
    statement = f"Protocol {protocol.version}, seed {score.seed_text}. {protocol.statement}"
    lines = [statement, *captured.get().splitlines(), _MARKS]
    room = _MOST_LINES - _FILE_LINES - sum(_heights(lines, width))
    return "\n".join([*lines, *_shortened(_reasons(score), room, width), "Every case and metric:"])


def _summary(score: Score, width: int) -> Table:
    """Returns the overview, as many columns and rows as a terminal of this width shows."""
    described = overview(score)
    names = max(len(row.title) for row in score.rows)
    inputs = max(len(text) for text in ("Inputs", *(row.symbols for row in score.rows)))
    columns = max(1, (width - 1 - 2 * _PADDING - names - inputs) // _COLUMN_WIDTH)
    left = len(score.rows) - _MOST_ROWS
    rows = _MOST_ROWS if left > 1 else len(score.rows)
    table = Table(title=described.title, box=SIMPLE_HEAD)
    table.caption = f"and {left} more controllers" if left > 1 else None
    table.add_column("", no_wrap=True)
    table.add_column("Inputs")
    for column in described.columns[:columns]:
        table.add_column(Text(column.heading), justify="right", width=_COLUMN_WIDTH - _PADDING)
    for row, cells in zip(score.rows[:rows], described.cells, strict=False):
        label = Text(row.title, "bold" if row.scored else "")
        table.add_row(label, row.symbols, *map(_shown, cells[:columns]))
    return table


def _shown(cell: Cell) -> Text:
    marks = _BEST * cell.is_best + _FAILED * bool(cell.failed)
    return Text(f"{cell.text}{marks}", "bold green" if cell.is_best else "red" if cell.failed else "")


def _heights(lines: Iterable[str], width: int) -> list[int]:
    """Returns the number of lines that each takes on a terminal."""
    return [max(1, math.ceil(len(line) / width)) for line in lines]


def _shortened(reasons: list[str], room: int, width: int) -> list[str]:
    """Returns the reasons that fit, and the number of the others, two or more."""
    ends = list(accumulate(_heights(reasons, width)))
    if len(reasons) < 2 or ends[-1] <= room:
        return reasons
    count = min(bisect_right(ends, room - 1), len(reasons) - 2)
    return [*reasons[:count], f"and {len(reasons) - count} more reasons"]


def _reasons(score: Score) -> list[str]:
    """Returns why scored controllers are not ranked, why their runs failed, and why cases are left out."""
    reasons: list[str] = []
    for row in score.scored:
        reasons += [f"{row.title} is not ranked: {reason}" for reason in row.unranked]
        for name, case in row.cases.items():
            title = score.protocol.cases[name].title
            failed = [reason for reason in case.failed if f"{title}: {reason}" not in row.unranked]
            if failed:
                reasons.append(f"{row.title}, {title}: {', '.join(failed)}")
    return reasons + [f"left out: {title}: {why}" for title, why in score.protocol.left_out.items()]


def html_page(result: ScoreResult, title: str) -> str:
    """Returns the page of a score or of a comparison; MissingExtraError without the extra `report`."""
    from orchestration.results.page import page

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
    from orchestration.results.page import packed

    return packed(np.round(_SCALE * np.array(values)))
