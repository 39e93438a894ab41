"""Tables of a score: one controller a row, the best of each column marked.

The best of a column is the best of the runs that did not fail, of controllers that are ranked.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

from fmus.errors import number_text
from orchestration.results.statistics import profile, ratios_to_best
from orchestration.studies.score.protocol_format import COMPARED
from orchestration.studies.score.score_document import OF_A_ROW, CaseResult, MetricInfo, Row, Score

_OVERVIEW = ("rmse", "total_variation")
# factors of the least RMSE: still acceptable, and almost as good
_FACTORS = (2.0, 1.1)
_STEP = MetricInfo(
    title="Run step",
    unit="ms",
    meaning="of communication in the runs; half of it changes the error of tuned gains by at most 2 %",
)
_STATISTICS = {
    "median": ("median", "not exceeded on half of the plants"),
    "p95": ("p95", "not exceeded on 95 % of the plants"),
    "cvar": ("CVaR", "mean of the worst 5 % of the plants"),
}


@dataclass(frozen=True)
class Cell:
    """A value, NaN if missing, and the reasons why its run failed."""

    value: float
    failed: tuple[str, ...] = ()
    is_best: bool = False

    @property
    def text(self) -> str:
        # by way of three digits: 1020, not 1.02e+03
        return number_text(float(f"{self.value:.3g}")) if math.isfinite(self.value) else "-"


class Column(MetricInfo):
    """A description of numbers, and the cell of each row."""

    cells: list[Cell]


@dataclass(frozen=True)
class ScoreTable:
    """cells: a tuple for each row of the score, in its order."""

    title: str
    rows: Sequence[Row]
    columns: Sequence[Column]

    @property
    def cells(self) -> list[tuple[Cell, ...]]:
        return list(zip(*(column.cells for column in self.columns), strict=True))


def all_tables(score: Score) -> dict[str, dict[str, ScoreTable]]:
    """Returns every table by its key, in groups by their headings; tables of --full only for such a score."""
    groups = {
        "All cases": {"overview": overview(score)},
        "A case": {f"case-{case}": of_case(score, case) for case in score.protocol.cases},
        "A metric": {
            f"metric-{name}": of_metric(score, name)
            for name in score.protocol.metrics
            if name not in OF_A_ROW
        },
    }
    draws, plants = over_draws(score), over_plants(score)
    if draws:
        groups["Draws of the cases"] = {"draws": draws}
    if plants:
        groups["Plants"] = {"plants": plants}
    return groups


def overview(score: Score) -> ScoreTable:
    """Returns a summary, the most important numbers first: a terminal shows as many as fit its width.

    Cases that built-in controllers are tuned on have columns of their own; cases that repeat the nominal
    one count in the failures alone.
    """
    cases = score.protocol.cases
    tuned = [name for name, case in cases.items() if case.tuned_on]
    others = [name for name in cases if name not in tuned]
    distinct = [name for name in others if not cases[name].repeats_nominal]
    margin, step = _of_the_row(score)
    plants = over_plants(score)
    columns = [
        _of_case(score, "rmse", score.nominal, title="RMSE, nominal"),
        _failed(score, list(cases), "cases"),
        margin,
        *([plants.columns[0].model_copy(update={"title": "Failed plants"})] if plants else []),
        *(_profiles(score, distinct) if distinct else []),
        _of_case(score, "total_variation", score.nominal, title="Total variation, nominal"),
        *(_mean(score, name, tuned, "tuned on") for name in _OVERVIEW if tuned),
    ]
    if distinct:
        columns.append(_mean(score, "total_variation", distinct, "others"))
    if others:
        columns.append(_failed(score, others, "others"))
    columns.append(step)
    # earlier versions of score.json have no step
    if any(math.isfinite(row.step) for row in score.rows):
        steps = [Cell(1e3 * row.step) for row in score.rows]
        columns.append(_column(score, _STEP, steps, has_best=False))
    return ScoreTable("Summary of the cases", score.rows, columns)


def of_case(score: Score, case: str) -> ScoreTable:
    """Returns every metric of one case; in the nominal case also the metrics of the row."""
    metrics = score.protocol.metrics
    columns = [_of_case(score, name, case) for name in metrics if name not in OF_A_ROW]
    of_the_row = _of_the_row(score) if case == score.nominal else []
    return ScoreTable(score.protocol.cases[case].title, score.rows, columns + of_the_row)


def of_metric(score: Score, name: str) -> ScoreTable:
    """Returns one metric in every case."""
    columns = [
        _of_case(score, name, case, title=info.title + (" (tuned on)" if info.tuned_on else ""), unit="")
        for case, info in score.protocol.cases.items()
    ]
    return ScoreTable(score.protocol.metrics[name].heading, score.rows, columns)


def over_plants(score: Score) -> ScoreTable | None:
    """Returns statistics over the plants; None for a score without plants."""
    plants = [row.plants for row in score.rows if row.plants]
    if not plants or len(plants) < len(score.rows):
        return None
    meaning = "share of the plants on which the run failed"
    of_end = f"{meaning}: end of the 95 % interval by Clopper and Pearson"
    shares = [
        ("Failed", meaning, [runs.failure_rate for runs in plants]),
        ("Failed, at least", of_end, [runs.failure_interval[0] for runs in plants]),
        ("Failed, at most", of_end, [runs.failure_interval[1] for runs in plants]),
    ]
    columns = [
        _column(score, MetricInfo(title=title, unit="%", meaning=what), [Cell(100.0 * x) for x in values])
        for title, what, values in shares
    ]
    for name in COMPARED:
        metric = score.protocol.metrics[name]
        for statistic, (title, meaning) in _STATISTICS.items():
            cells = [Cell(getattr(runs.metrics[name], statistic)) for runs in plants]
            columns.append(_column(score, metric, cells, title=f"{metric.title} {title}", meaning=meaning))
    title = f"{plants[0].count} plants, each with another trajectory"
    return ScoreTable(title, score.rows, columns)


def over_draws(score: Score) -> ScoreTable | None:
    """Returns the median RMSE over the draws of each case, marked where some failed; None without draws."""
    infos, metric = score.protocol.cases, score.protocol.metrics["rmse"]
    columns: list[Column] = []
    for case in (name for name in infos if score.rows and all(name in row.draws for row in score.rows)):
        draws = [row.draws[case] for row in score.rows]
        failed = [(f"{len(x.failed)} of {x.count} draws",) if x.failed else () for x in draws]
        cells = [Cell(x.metrics["rmse"].median, why) for x, why in zip(draws, failed, strict=True)]
        meaning = f"median over draws of seeds and times; {metric.meaning}"
        columns.append(_column(score, metric, cells, title=infos[case].title, unit="", meaning=meaning))
    return ScoreTable(f"{metric.heading}, median of draws", score.rows, columns) if columns else None


def _of_the_row(score: Score) -> list[Column]:
    """Returns the metrics that a row has once; they count as metrics of its nominal run."""
    failed = [_cell(row, "", score.nominal).failed for row in score.rows]
    return [
        _column(
            score,
            score.protocol.metrics[name],
            [Cell(getattr(row, name), why) for row, why in zip(score.rows, failed, strict=True)],
        )
        for name in OF_A_ROW
    ]


def _cell(row: Row, name: str, case: str) -> Cell:
    """Returns a metric of a case, not a number where the row has none."""
    result = row.cases.get(case, CaseResult())
    return Cell(result.metrics.get(name, math.nan), tuple(result.failed))


def _of_case(score: Score, name: str, case: str, **changes: Any) -> Column:
    cells = [_cell(row, name, case) for row in score.rows]
    return _column(score, score.protocol.metrics[name], cells, **changes)


def _mean(score: Score, name: str, cases: Sequence[str], which: str) -> Column:
    """Returns the column of the mean of a metric over cases."""
    means: list[Cell] = []
    for row in score.rows:
        of_case = {case: _cell(row, name, case) for case in cases}
        failed = (f"{case}: {reason}" for case, cell in of_case.items() for reason in cell.failed)
        means.append(Cell(sum(cell.value for cell in of_case.values()) / len(cases), tuple(failed)))
    metric = score.protocol.metrics[name]
    meaning = f"mean over {len(cases)} cases: {', '.join(cases)}; {metric.meaning}"
    return _column(score, metric, means, title=f"{metric.title}, {which}", meaning=meaning)


def _failed(score: Score, cases: Sequence[str], which: str) -> Column:
    """Returns the column of the number of cases that failed."""
    meaning = f"runs that failed of {', '.join(cases)}"
    info = MetricInfo(title=f"Failed, {which}", unit=f"of {len(cases)}", meaning=meaning)
    counts = [float(sum(bool(_cell(row, "", case).failed) for case in cases)) for row in score.rows]
    return _column(score, info, list(map(Cell, counts)))


def _profiles(score: Score, cases: Sequence[str]) -> Iterator[Column]:
    """Yields points of the performance profile: the share of cases within a factor of the least RMSE."""
    runs = [[_cell(row, "rmse", case) for case in cases] for row in score.rows]
    errors = [[math.nan if run.failed else run.value for run in of_row] for of_row in runs]
    shares = profile(ratios_to_best(errors, [not row.unranked for row in score.rows]), _FACTORS)
    for factor, of_rows in zip(_FACTORS, 100.0 * shares.T, strict=True):
        info = MetricInfo(
            title=f"RMSE up to {factor:g} x best",
            unit="%",
            meaning=f"share of the cases {', '.join(cases)} in which the run did not fail and its RMSE is at "
            f"most {factor:g} times the least one of the ranked controllers: performance profile of Dolan "
            "and Moré (2002)",
            greatest_is_best=True,
        )
        yield _column(score, info, [Cell(float(share)) for share in of_rows])


def _column(
    score: Score, info: MetricInfo, cells: Sequence[Cell], has_best: bool = True, **changes: Any
) -> Column:
    """Returns the column of a cell for each row, its best marked unless all of the rows are equal.

    changes: of the description
    """
    ranked = [
        has_best and not row.unranked and not cell.failed for row, cell in zip(score.rows, cells, strict=True)
    ]
    known = [
        c.value for c, is_ranked in zip(cells, ranked, strict=True) if is_ranked and math.isfinite(c.value)
    ]
    all_equal = len(known) == len(cells) and len(set(known)) == 1
    best = math.nan
    if known and len(cells) > 1 and not all_equal:
        best = max(known) if info.greatest_is_best else min(known)
    marked = [
        replace(c, is_best=is_ranked and c.value == best) for c, is_ranked in zip(cells, ranked, strict=True)
    ]
    return Column(**{**info.model_dump(), **changes}, cells=marked)
