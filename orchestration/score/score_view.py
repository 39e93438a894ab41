"""Tables of a score, for the terminal and for the page: one controller a row, the best of each column marked.

The best of a column is the best of the runs that did not fail, of controllers that are ranked.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from orchestration.score.protocol_format import COMPARED, DELAY_MARGIN
from orchestration.score.score_document import MICROSECONDS, MetricInfo, Row, Score


@dataclass(frozen=True)
class Cell:
    """A number, not a number where there is none; failed: why the run counts as failed."""

    value: float
    failed: tuple[str, ...] = ()
    is_best: bool = False

    @property
    def text(self) -> str:
        return format(self.value, ".3g") if math.isfinite(self.value) else "-"


@dataclass(frozen=True)
class Column:
    """A heading, the unit of its numbers, what they are, and the cell of a row."""

    title: str
    unit: str
    meaning: str
    cell: Callable[[Row], Cell]
    greatest_is_best: bool = False
    has_best: bool = True


@dataclass(frozen=True)
class ScoreTable:
    """cells: a list for each row of the score, in its order."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    cells: tuple[tuple[Cell, ...], ...]


_OVERVIEW = ("rmse", "total_variation")
_STEP = Column(
    "Communication step",
    "ms",
    "of the runs; half of it changes the cost of tuned gains by at most 2 %",
    lambda row: Cell(1e3 * row.step),
    has_best=False,
)


def overview(score: Score) -> ScoreTable:
    """Means over the cases: those that built-in controllers are tuned on have columns of their own."""
    tuned = [name for name, case in score.protocol.cases.items() if case.tuned_on]
    others = [name for name in score.protocol.cases if name not in tuned]
    columns: list[Column] = []
    groups = ((tuned, "tuned on"), (others, "others"))
    for cases, which in (group for group in groups if group[0]):
        for name in _OVERVIEW:
            metric = score.protocol.metrics[name]
            meaning = f"mean over {len(cases)} cases: {', '.join(cases)}; {metric.meaning}"
            columns.append(Column(f"{metric.title}, {which}", metric.unit, meaning, _mean(name, cases)))
        meaning = f"runs that failed of {', '.join(cases)}"
        columns.append(Column(f"Failed, {which}", f"of {len(cases)}", meaning, _failed(cases)))
    columns += _of_the_row(score)
    if any(math.isfinite(row.step) for row in score.rows):  # earlier scores do not have it
        columns.append(_STEP)
    return _table(score, "Means over the cases", columns)


def of_case(score: Score, case: str) -> ScoreTable:
    """Returns every metric of one case; in the nominal case also those of the row."""
    columns = [
        _column(metric, _one(name, case))
        for name, metric in score.protocol.metrics.items()
        if name not in (DELAY_MARGIN, MICROSECONDS)
    ]
    is_nominal = case == next(iter(score.protocol.cases))
    title = score.protocol.cases[case].title
    return _table(score, title, [*columns, *(_of_the_row(score) if is_nominal else [])])


def of_metric(score: Score, name: str) -> ScoreTable:
    """Returns one metric in every case."""
    metric = score.protocol.metrics[name]
    columns = [
        replace(
            _column(metric, _one(name, case)),
            title=info.title + (" (tuned on)" if info.tuned_on else ""),
            unit="",
        )
        for case, info in score.protocol.cases.items()
    ]
    return _table(score, f"{metric.title} [{metric.unit}]" if metric.unit else metric.title, columns)


def over_plants(score: Score) -> ScoreTable | None:
    """Statistics over the plants; None if there are none."""
    counts = [row.plants.count for row in score.rows if row.plants]
    if not counts or len(counts) < len(score.rows):
        return None
    columns = [Column("Failed", "%", "share of the plants on which the run failed", _failure_rate)]
    for name in COMPARED:
        metric = score.protocol.metrics[name]
        columns += [
            Column(f"{metric.title} {title}", metric.unit, meaning, _statistic(name, statistic))
            for statistic, (title, meaning) in _STATISTICS.items()
        ]
    return _table(score, f"{counts[0]} plants, each with a trajectory of its own", columns)


_STATISTICS = {
    "median": ("median", "not exceeded on half of the plants"),
    "p95": ("p95", "not exceeded on 95 % of the plants"),
    "cvar": ("CVaR", "mean of the worst 5 % of the plants"),
}


def _column(metric: MetricInfo, cell: Callable[[Row], Cell]) -> Column:
    return Column(metric.title, metric.unit, metric.meaning, cell, metric.greatest_is_best)


def _of_the_row(score: Score) -> list[Column]:
    """Returns the metrics that a row has once, which count as those of its nominal run."""
    nominal = next(iter(score.protocol.cases))

    def cell(name: str) -> Callable[[Row], Cell]:
        return lambda row: Cell(getattr(row, name), _reasons(row, nominal))

    return [_column(score.protocol.metrics[name], cell(name)) for name in (DELAY_MARGIN, MICROSECONDS)]


def _metric(row: Row, name: str, case: str) -> float:
    return row.cases[case].metrics.get(name, math.nan) if case in row.cases else math.nan


def _reasons(row: Row, case: str) -> tuple[str, ...]:
    """Returns why the run of a case counts as failed."""
    return tuple(row.cases[case].failed) if case in row.cases else ()


def _one(name: str, case: str) -> Callable[[Row], Cell]:
    return lambda row: Cell(_metric(row, name, case), _reasons(row, case))


def _mean(name: str, cases: Sequence[str]) -> Callable[[Row], Cell]:
    def cell(row: Row) -> Cell:
        values = [_metric(row, name, case) for case in cases]
        failed = (f"{case}: {reason}" for case in cases for reason in _reasons(row, case))
        return Cell(sum(values) / len(values), tuple(failed))

    return cell


def _failed(cases: Sequence[str]) -> Callable[[Row], Cell]:
    return lambda row: Cell(float(sum(bool(_reasons(row, case)) for case in cases)))


def _failure_rate(row: Row) -> Cell:
    return Cell(100.0 * row.plants.failure_rate if row.plants else math.nan)


def _statistic(name: str, statistic: str) -> Callable[[Row], Cell]:
    return lambda row: Cell(getattr(row.plants.metrics[name], statistic) if row.plants else math.nan)


def _table(score: Score, title: str, columns: Sequence[Column]) -> ScoreTable:
    marked = []
    for column in columns:
        cells = [column.cell(row) for row in score.rows]
        ranked = [
            column.has_best and not row.unranked and not cell.failed
            for row, cell in zip(score.rows, cells, strict=True)
        ]
        values = [cell.value for cell, is_ranked in zip(cells, ranked, strict=True) if is_ranked]
        best = _best(values, len(cells), column)
        marked.append(
            [
                replace(cell, is_best=is_ranked and cell.value == best)
                for cell, is_ranked in zip(cells, ranked, strict=True)
            ]
        )
    return ScoreTable(title, tuple(columns), tuple(score.rows), tuple(zip(*marked, strict=True)))


def _best(values: Sequence[float], rows: int, column: Column) -> float:
    """Returns the best number of those that are ranked; not a number where all of the rows are equal."""
    known = [value for value in values if math.isfinite(value)]
    if not known or rows < 2 or (len(known) == rows and len(set(known)) == 1):
        return math.nan
    return max(known) if column.greatest_is_best else min(known)
