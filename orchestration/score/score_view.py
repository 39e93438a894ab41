"""Tables of a score, for the terminal and for the page: one controller a row, the best of each column marked.

The best of a column is the best of its league among the runs that did not fail.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestration.score.protocol_format import COMPARED, DELAY_MARGIN
from orchestration.score.score_document import MICROSECONDS, CaseResult, MetricInfo, Row, Score


@dataclass(frozen=True)
class Column:
    """A heading, the unit of its numbers, and what they are."""

    title: str
    unit: str
    meaning: str


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
class ScoreTable:
    """cells: a list for each row of the score, in its order."""

    title: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    cells: tuple[tuple[Cell, ...], ...]


_Value = Callable[[Row], tuple[float, Sequence[str]]]
_OVERVIEW = ("rmse", "total_variation")


def overview(score: Score) -> ScoreTable:
    """Means over the cases: those that built-in controllers are tuned on have columns of their own."""
    tuned = [name for name, case in score.protocol.cases.items() if case.tuned_on]
    others = [name for name in score.protocol.cases if name not in tuned]
    entries: list[tuple[Column, bool, _Value]] = []
    groups = ((tuned, "tuned on"), (others, "others"))
    for cases, which in (group for group in groups if group[0]):
        for name in _OVERVIEW:
            metric = score.protocol.metrics[name]
            meaning = f"mean over {len(cases)} cases: {', '.join(cases)}; {metric.meaning}"
            entries.append(
                (Column(f"{metric.title}, {which}", metric.unit, meaning), False, _mean(name, cases))
            )
        column = Column(f"Failed, {which}", f"of {len(cases)}", f"runs that failed of {', '.join(cases)}")
        entries.append((column, False, _failed(cases)))
    return _table(score, "Means over the cases", [*entries, *_of_the_row(score)])


def of_case(score: Score, case: str) -> ScoreTable:
    """Returns every metric of one case; in the nominal case also those of the row."""
    entries = [
        (Column(metric.title, metric.unit, metric.meaning), metric.greatest_is_best, _one(name, case))
        for name, metric in score.protocol.metrics.items()
        if name not in (DELAY_MARGIN, MICROSECONDS)
    ]
    is_nominal = case == next(iter(score.protocol.cases))
    title = score.protocol.cases[case].title
    return _table(score, title, [*entries, *(_of_the_row(score) if is_nominal else [])])


def of_metric(score: Score, name: str) -> ScoreTable:
    """Returns one metric in every case."""
    metric = score.protocol.metrics[name]
    entries = [
        (
            Column(info.title + (" (tuned on)" if info.tuned_on else ""), "", metric.meaning),
            metric.greatest_is_best,
            _one(name, case),
        )
        for case, info in score.protocol.cases.items()
    ]
    return _table(score, _titled(metric), entries)


def over_plants(score: Score) -> ScoreTable | None:
    """Statistics over the plants; None if there are none."""
    counts = [row.plants.count for row in score.rows if row.plants]
    if not counts or len(counts) < len(score.rows):
        return None
    column = Column("Failed", "%", "share of the plants on which the run failed")
    entries: list[tuple[Column, bool, _Value]] = [(column, False, _failure_rate)]
    for name in COMPARED:
        metric = score.protocol.metrics[name]
        for statistic in ("median", "p95", "cvar"):
            column = Column(
                f"{metric.title} {_STATISTICS[statistic][0]}", metric.unit, _STATISTICS[statistic][1]
            )
            entries.append((column, False, _statistic(name, statistic)))
    return _table(score, f"{counts[0]} plants, each with a trajectory of its own", entries)


_STATISTICS = {
    "median": ("median", "not exceeded on half of the plants"),
    "p95": ("p95", "not exceeded on 95 % of the plants"),
    "cvar": ("CVaR", "mean of the worst 5 % of the plants"),
}


def _titled(metric: MetricInfo) -> str:
    return f"{metric.title} [{metric.unit}]" if metric.unit else metric.title


def _of_the_row(score: Score) -> list[tuple[Column, bool, _Value]]:
    """Returns the metrics that a row has once, which count as those of its nominal run."""
    nominal = next(iter(score.protocol.cases))

    def value(name: str) -> _Value:
        return lambda row: (getattr(row, name), _result(row, nominal).failed)

    metrics = {name: score.protocol.metrics[name] for name in (DELAY_MARGIN, MICROSECONDS)}
    return [
        (Column(metric.title, metric.unit, metric.meaning), metric.greatest_is_best, value(name))
        for name, metric in metrics.items()
    ]


def _result(row: Row, case: str) -> CaseResult:
    return row.cases.get(case, CaseResult())


def _one(name: str, case: str) -> _Value:
    return lambda row: (_result(row, case).metrics.get(name, math.nan), _result(row, case).failed)


def _mean(name: str, cases: Sequence[str]) -> _Value:
    def value(row: Row) -> tuple[float, Sequence[str]]:
        values = [_result(row, case).metrics.get(name, math.nan) for case in cases]
        failed = [f"{case}: {reason}" for case in cases for reason in _result(row, case).failed]
        return sum(values) / len(values), failed

    return value


def _failed(cases: Sequence[str]) -> _Value:
    return lambda row: (float(sum(bool(_result(row, case).failed) for case in cases)), ())


def _failure_rate(row: Row) -> tuple[float, Sequence[str]]:
    return 100.0 * row.plants.failure_rate if row.plants else math.nan, ()


def _statistic(name: str, statistic: str) -> _Value:
    return lambda row: (getattr(row.plants.metrics[name], statistic) if row.plants else math.nan, ())


def _table(score: Score, title: str, entries: Sequence[tuple[Column, bool, _Value]]) -> ScoreTable:
    columns = []
    for _, greatest_is_best, value in entries:
        cells = [Cell(number, tuple(failed)) for number, failed in map(value, score.rows)]
        best = {league: _best(score, cells, league, greatest_is_best) for league in score.protocol.leagues}
        columns.append(
            [
                Cell(cell.value, cell.failed, cell.value == best[row.league] and not cell.failed)
                for row, cell in zip(score.rows, cells, strict=True)
            ]
        )
    rows = tuple(zip(*columns, strict=True))
    return ScoreTable(title, tuple(column for column, _, _ in entries), tuple(score.rows), rows)


def _best(score: Score, cells: Sequence[Cell], league: str, greatest: bool) -> float:
    """Returns the best number of a league, of runs that did not fail; not a number where all are equal."""
    rows = [row.league == league for row in score.rows]
    values = [
        cell.value
        for cell, is_of_it in zip(cells, rows, strict=True)
        if is_of_it and not cell.failed and math.isfinite(cell.value)
    ]
    if not values or sum(rows) < 2 or (len(values) == sum(rows) and len(set(values)) == 1):
        return math.nan
    return max(values) if greatest else min(values)
