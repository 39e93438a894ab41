"""A score in the terminal."""

from rich.table import Table
from rich.text import Text

from orchestration.study import score_view
from orchestration.study.score_document import Score
from orchestration.study.score_view import Cell, ScoreTable

BEST, FAILED = "*", "!"


def score_tables(score: Score) -> list[Table]:
    """The overview, the nominal case, the errors of all cases, and the plants if there are any.

    Controllers are the columns, so that many figures fit.
    """
    nominal = next(iter(score.protocol.cases))
    tables = [
        score_view.overview(score),
        score_view.of_case(score, nominal),
        score_view.of_figure(score, "rmse"),
        score_view.over_plants(score),
    ]
    return [_table(table) for table in tables if table]


def differences_table(score: Score) -> Table | None:
    """The scored controllers against the others, plant by plant; None without plants."""
    if not score.differences:
        return None
    table = Table(title="Plant by plant: the scored controller minus another one")
    for heading in ("Scored", "Other", "Figure"):
        table.add_column(heading)
    for heading in ("Median difference", "95 % interval", "p, Holm"):
        table.add_column(heading, justify="right")
    titles = {row.name: row.title for row in score.rows}
    for entry in score.differences:
        figure = score.protocol.figures[entry.figure]
        low, high = entry.interval
        table.add_row(
            titles[entry.scored],
            titles[entry.other],
            figure.title,
            f"{entry.median_difference:.3g} {figure.unit}",
            f"{low:.3g} to {high:.3g}",
            f"{entry.p_holm:.2g}",
        )
    return table


def _table(shown: ScoreTable) -> Table:
    """The table with controllers as columns."""
    table = Table(title=shown.title)
    table.add_column("")
    for row in shown.rows:
        table.add_column(Text(row.title, "bold" if row.scored else ""), justify="right")
    for index, column in enumerate(shown.columns):
        heading = f"{column.title} [{column.unit}]" if column.unit else column.title
        table.add_row(Text(heading), *(_cell(cells[index]) for cells in shown.cells))
    return table


def _cell(cell: Cell) -> Text:
    marks = BEST * cell.is_best + FAILED * bool(cell.failed)
    return Text(f"{cell.text}{marks}", "bold green" if cell.is_best else "red" if cell.failed else "")
