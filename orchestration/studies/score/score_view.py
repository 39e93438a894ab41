"""Tables of a score, for the terminal and for the page: one controller a row, the best of each column marked.

The best of a column is the best of the runs that did not fail, of controllers that are ranked.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from orchestration.results.statistics import profile, ratios_to_best
from orchestration.studies.score.protocol_format import COMPARED, DELAY_MARGIN
from orchestration.studies.score.score_document import MICROSECONDS, MetricInfo, Row, Score


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
_FACTORS = (1.1, 2.0)  # of the least RMSE: as good but for little, and not out of the question
_STEP = Column(
    "Run step",
    "ms",
    "of communication in the runs; half of it changes the error of tuned gains by at most 2 %",
    lambda row: Cell(1e3 * row.step),
    has_best=False,
)


def overview(score: Score) -> ScoreTable:
    """Returns a summary of the cases: those that built-in controllers are tuned on have columns of their own.

    Cases that repeat the nominal one count in the failures of the others alone.
    """
    cases = score.protocol.cases
    tuned = [name for name, case in cases.items() if case.tuned_on]
    others = [name for name in cases if name not in tuned]
    distinct = [name for name in others if not cases[name].repeats_nominal]
    columns: list[Column] = []
    if tuned:
        columns += [_mean(score, name, tuned, "tuned on") for name in _OVERVIEW]
        columns.append(_failed(tuned, "tuned on"))
    if distinct:
        columns += [*_profiles(score, distinct), _mean(score, "total_variation", distinct, "others")]
    if others:
        columns.append(_failed(others, "others"))
    columns += _of_the_row(score)
    if any(math.isfinite(row.step) for row in score.rows):  # earlier scores do not have it
        columns.append(_STEP)
    return _table(score, "Summary of the cases", columns)


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
    meaning = "share of the plants on which the run failed"
    columns = [
        Column("Failed", "%", meaning, _failure_rate),
        *(
            Column(
                title, "%", f"{meaning}: end of the 95 % interval by Clopper and Pearson", _failure_limit(end)
            )
            for end, title in enumerate(("Failed, at least", "Failed, at most"))
        ),
    ]
    for name in COMPARED:
        metric = score.protocol.metrics[name]
        columns += [
            Column(f"{metric.title} {title}", metric.unit, meaning, _statistic(name, statistic))
            for statistic, (title, meaning) in _STATISTICS.items()
        ]
    return _table(score, f"{counts[0]} plants, each with a trajectory of its own", columns)


def over_draws(score: Score) -> ScoreTable | None:
    """Returns the median RMSE over the draws of each case, marked where some failed; None without draws."""
    infos, metric = score.protocol.cases, score.protocol.metrics["rmse"]
    cases = [name for name in infos if score.rows and all(name in row.draws for row in score.rows)]
    meaning = f"median over draws of seeds and times; {metric.meaning}"
    columns = [Column(infos[name].title, "", meaning, _draws(name)) for name in cases]
    return _table(score, f"{metric.title} [{metric.unit}], median of draws", columns) if cases else None


def _draws(case: str) -> Callable[[Row], Cell]:
    def cell(row: Row) -> Cell:
        runs = row.draws[case]
        failed = (f"{len(runs.failed)} of {runs.count} draws",) if runs.failed else ()
        return Cell(runs.metrics["rmse"].median, failed)

    return cell


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


def _mean(score: Score, name: str, cases: Sequence[str], which: str) -> Column:
    """Returns the column of the mean of a metric over cases."""

    def cell(row: Row) -> Cell:
        values = [_metric(row, name, case) for case in cases]
        failed = (f"{case}: {reason}" for case in cases for reason in _reasons(row, case))
        return Cell(sum(values) / len(values), tuple(failed))

    metric = score.protocol.metrics[name]
    meaning = f"mean over {len(cases)} cases: {', '.join(cases)}; {metric.meaning}"
    return Column(f"{metric.title}, {which}", metric.unit, meaning, cell)


def _failed(cases: Sequence[str], which: str) -> Column:
    """Returns the column of the number of cases that failed."""
    meaning = f"runs that failed of {', '.join(cases)}"
    return Column(
        f"Failed, {which}",
        f"of {len(cases)}",
        meaning,
        lambda row: Cell(float(sum(bool(_reasons(row, case)) for case in cases))),
    )


def _profiles(score: Score, cases: Sequence[str]) -> list[Column]:
    """Returns points of the performance profile: the share of cases within a factor of the least RMSE."""
    errors = [
        [math.nan if _reasons(row, case) else _metric(row, "rmse", case) for case in cases]
        for row in score.rows
    ]
    shares = profile(ratios_to_best(errors, [not row.unranked for row in score.rows]), _FACTORS)
    by_row = dict(zip((row.name for row in score.rows), 100.0 * shares, strict=True))
    meaning = (
        f"share of the cases {', '.join(cases)} in which the run did not fail and its RMSE is at most {{:g}} "
        "times the least one of the ranked controllers: performance profile of Dolan and Moré (2002)"
    )
    return [
        Column(
            f"RMSE up to {factor:g} x best",
            "%",
            meaning.format(factor),
            lambda row, index=index: Cell(float(by_row[row.name][index])),
            greatest_is_best=True,
        )
        for index, factor in enumerate(_FACTORS)
    ]


def _failure_rate(row: Row) -> Cell:
    return Cell(100.0 * row.plants.failure_rate if row.plants else math.nan)


def _failure_limit(end: int) -> Callable[[Row], Cell]:
    return lambda row: Cell(100.0 * row.plants.failure_interval[end] if row.plants else math.nan)


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
