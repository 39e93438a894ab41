"""A score in the terminal."""

from collections.abc import Iterable

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from orchestration.studies.score import score_view
from orchestration.studies.score.score_document import Score
from orchestration.studies.score.score_view import Cell, ScoreTable

BEST, FAILED = "*", "!"
_COLUMN_WIDTH = 13  # with its padding and its edge
_PADDING = 3


def score_tables(score: Score) -> list[ScoreTable]:
    """Returns the overview, the nominal case, the errors of all cases, and the many runs if there are any."""
    nominal = next(iter(score.protocol.cases))
    tables = [
        score_view.overview(score),
        score_view.of_case(score, nominal),
        score_view.of_metric(score, "rmse"),
        score_view.over_draws(score),
        score_view.over_plants(score),
    ]
    return [table for table in tables if table]


def in_parts(tables: Iterable[ScoreTable], width: int) -> list[Table]:
    """Returns the tables for a terminal; one that does not fit its width is in parts."""
    return [part for table in tables for part in _parts(table, width)]


def differences_table(score: Score) -> Table | None:
    """Returns the scored controllers against the others, plant by plant; None without plants."""
    if not score.differences:
        return None
    table = Table(title="Plant by plant: one controller minus another one")
    for heading in ("Scored", "Other", "Metric"):
        table.add_column(heading)
    for heading in ("Pairs", "Median difference", "Interval", "p, Holm", "Verdict"):
        table.add_column(heading, justify="right")
    titles = {row.name: row.title for row in score.rows}
    for entry in score.differences:
        metric = score.protocol.metrics[entry.metric]
        low, high = entry.interval
        table.add_row(
            titles[entry.scored],
            titles[entry.other],
            metric.title,
            str(entry.pairs),
            f"{entry.median_difference:.3g} {metric.unit}",
            f"{low:.3g} to {high:.3g}",
            f"{entry.p_holm:.2g}",
            entry.verdict,
        )
    return table


def _parts(shown: ScoreTable, width: int) -> list[Table]:
    """Returns the table in as many parts as its columns need."""
    first = (
        1
        + 2 * _PADDING
        + sum(
            max(len(text) for text in texts)
            for texts in ([row.title for row in shown.rows], ["Inputs", *(row.symbols for row in shown.rows)])
        )
    )
    count = max(1, (width - first) // _COLUMN_WIDTH)
    return [
        _table(shown, range(begin, min(begin + count, len(shown.columns))))
        for begin in range(0, len(shown.columns), count)
    ]


def _table(shown: ScoreTable, columns: range) -> Table:
    title = Text(shown.title if columns[0] == 0 else f"{shown.title}, continued")
    table = Table(title=title, box=SIMPLE_HEAD)
    table.add_column("", no_wrap=True)
    table.add_column("Inputs")
    for column in (shown.columns[index] for index in columns):
        heading = f"{column.title} [{column.unit}]" if column.unit else column.title
        table.add_column(Text(heading), justify="right", width=_COLUMN_WIDTH - _PADDING)
    for row, cells in zip(shown.rows, shown.cells, strict=True):
        label = Text(row.title, "bold" if row.scored else "")
        table.add_row(label, row.symbols, *(_cell(cells[index]) for index in columns))
    return table


def _cell(cell: Cell) -> Text:
    marks = BEST * cell.is_best + FAILED * bool(cell.failed)
    return Text(f"{cell.text}{marks}", "bold green" if cell.is_best else "red" if cell.failed else "")
