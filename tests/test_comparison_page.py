"""The site's page explanation/comparison.md is filled from the committed run, and its claims hold there."""

import copy
import json
import math
import re
import sys
from collections.abc import Iterator
from dataclasses import astuple, replace
from functools import cache
from itertools import combinations
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fmus.fmi.description import describe
from orchestration.results.statistics import distribution, holm, paired, proportion_interval
from orchestration.studies.score import score
from orchestration.studies.score.closed_loop import ClosedLoop, built_in, tuned_gains
from orchestration.studies.score.protocol import read_protocol
from orchestration.studies.score.score_document import ManyRuns, Row, Score
from orchestration.studies.score.tune import LARGEST_IMPROVEMENT
from orchestration.studies.score.tune_problem import costs
from orchestration.studies.vehicle import built
from orchestration.system.system import Port
from orchestration.system.values import value_range
from tests.page_text import long_cells, long_sentences

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / ".ci"))
import comparison_fronts  # noqa: E402  # pyright: ignore[reportMissingImports]
import comparison_page  # noqa: E402  # pyright: ignore[reportMissingImports]
from front_points import is_converged  # noqa: E402  # pyright: ignore[reportMissingImports]
from fronts import SPECIAL_CASES  # noqa: E402  # pyright: ignore[reportMissingImports]

sys.path.pop(0)
EXPLANATION = ROOT / "docs" / "explanation"
ROUNDED = 1e-4  # the file has five digits of each number


@pytest.fixture(scope="module")
def document() -> Score:
    return Score.model_validate_json((EXPLANATION / "comparison.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def numbers(document: Score) -> Any:
    return comparison_page.Numbers(document)


@pytest.fixture(scope="module")
def fronts() -> Any:
    return comparison_fronts.committed()


def plants(row: Row) -> ManyRuns:
    assert row.plants is not None
    return row.plants


@pytest.mark.slow
def test_the_page_is_short_and_begins_with_what_it_does_not_show() -> None:
    page = comparison_page.page()
    assert sum(bool(re.search(r"\w", word)) for word in page.split()) <= 1500  # not the rules of tables
    assert re.findall(r"^## (.*)$", page, re.M)[0] == "What this does not show"
    assert not long_sentences(page)
    assert not long_cells(page)


def test_the_headings_of_the_findings_are_those_of_the_run(document: Score, numbers: Any) -> None:
    """Names and numbers below them are filled in."""
    rows = {row.name: row for row in document.rows}
    tuned = [row for row in document.rows if row.name.startswith(f"{score.TUNED}/")]
    slow, quick = (rows[name].draws["nominal"].metrics["rmse"].values for name in ("start/l1-pi", "tuned/l1"))
    assert max(quick) < min(slow)
    identified = min(*rows["start/l1"].delay_margins, *rows["start/l1-pi"].delay_margins)
    assert max(max(row.delay_margins) for row in tuned) < identified
    for case in numbers.repeated:
        often = [row.title for row in tuned if row.draws[case].failure_interval[0] > 0.05]
        assert [row.title for row in numbers.failing_in(0.05).get(case, [])] == often
    assert numbers.failing_in(0.05)
    assert len(numbers.leaders("hold-sea")[1]) > len(tuned) / 2
    assert all(len(numbers.leaders(case)[1]) < len(tuned) / 2 for case in ("", "nominal", "hold-sine"))


def test_delay_margins_are_over_the_noise_of_every_draw(document: Score, numbers: Any) -> None:
    tables = read_protocol().tables
    for row in document.rows:
        assert len(row.delay_margins) == tables.repetitions
        assert row.delay_margin == pytest.approx(median(row.delay_margins), rel=ROUNDED)
        middle, low, high = map(float, re.findall(r"\d+", comparison_page.margin(row)))
        shown = 1e-3 * np.array([low, middle, high])
        assert shown == pytest.approx(np.quantile(row.delay_margins, [0.0, 0.5, 1.0]), abs=0.51e-3)
    bound = tables.cost.bounds["delay_margin"]
    in_all, in_median = ([row.name for row in rows] for rows in numbers.keeping(bound))
    assert in_all == [row.name for row in numbers.tuned if all(m >= bound for m in row.delay_margins)]
    assert in_median == [row.name for row in numbers.tuned if median(row.delay_margins) >= bound]


@pytest.mark.slow
def test_wider_ranges_lower_no_cost_of_a_law_that_ended_at_a_limit(numbers: Any) -> None:
    """A flat cost is excepted; each limit is ten times as far, or the FMU's."""
    protocol = read_protocol()
    assert [row.name for row in numbers.limited()] == [f"{score.TUNED}/{law}" for law in numbers.widened]
    for law, entry in numbers.widened.items():
        table = protocol.controllers[law]
        known = {v.name: value_range(Port("", v)) for v in describe(built(table.fmu)).modelVariables}
        assert entry["ranges"] == {
            gain: [max(limits.low / 10.0, known[gain][0]), min(limits.high * 10.0, known[gain][1])]
            for gain, limits in table.gains.items()
        }
    assert min(numbers.changes_in_wider_ranges()) > -LARGEST_IMPROVEMENT


def test_fronts_are_within_the_bounds_of_the_search_at_one_step(fronts: Any) -> None:
    protocol = read_protocol()
    for document in fronts.documents:
        assert document["protocol"] == protocol.version
        names = [law["name"] for law in document["laws"]]
        assert names == [name for name in protocol.controllers if name in names]
        bounds = document["cost"]["bounds"]
        for law in document["laws"]:
            assert re.fullmatch("[0-9a-f]{12}", law["revision"])
            assert len(law["hypervolumes"]) == len(document["effort"]["seeds"]) > 1
            assert law["is_converged"] == is_converged(law["least_errors_at_half"], law["least_errors"])
            for point in law["points"]:
                assert point["delay_margin"] >= bounds["delay_margin"]
                assert point["total_variation"] <= bounds["total_variation"] * (1.0 + ROUNDED)
    text = comparison_fronts.DATA.read_text(encoding="utf-8")
    assert comparison_fronts.reduced(json.loads(text)) == text


def test_no_law_is_behind_its_own_special_case(fronts: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """And a page on which one is cannot be made."""
    assert fronts.behind() == []
    documents = copy.deepcopy(fronts.documents)
    laws = {law["name"]: law for law in documents[0]["laws"]}
    law, (special, *_) = next((n, [x.law for x in cases]) for n, cases in SPECIAL_CASES.items())
    laws[special]["hypervolumes"][-1] = 1.001 * min(laws[law]["hypervolumes"])
    worse = comparison_fronts.Fronts(documents, fronts.sensitivity)
    assert worse.behind() == [f"{law} on {documents[0]['vehicle']} is behind {special}"]
    monkeypatch.setattr(comparison_fronts, "Fronts", lambda *_: worse)
    with pytest.raises(ValueError, match="expected no law behind its own special case"):
        comparison_page.page()


@pytest.mark.slow
def test_the_gains_of_a_point_have_its_error_and_its_variation(fronts: Any, scenario_fmus: None) -> None:
    """Of the point with the least error of each law on the paper's vehicle."""
    protocol = read_protocol()
    document = next(d for d in fronts.documents if d["vehicle"] == protocol.vehicle.name)
    for law in document["laws"]:
        point = law["points"][-1]
        table = protocol.controllers[law["name"]]
        controller = replace(
            built_in(protocol, law["name"]), parameters={**table.parameters, **point["gains"]}
        )
        with ClosedLoop(controller, protocol) as loop:
            (row,) = costs(loop, [{}])
        # the same program on another machine differs by the rounding of its libm, which noise enlarges
        assert row["error"] == pytest.approx(point["error"], rel=1e-3)
        assert row["cost"] == row["error"]
        variation = max(case["total_variation"] for case in row["metrics"].values())
        assert variation == pytest.approx(point["total_variation"], rel=1e-3)


def made_up_fronts(*volumes: list[float], converged: bool = True) -> Any:
    laws = [
        {"name": name, "title": name, "hypervolumes": column, "is_converged": converged}
        for name, column in zip("abc", volumes, strict=False)
    ]
    return comparison_fronts.Fronts([{"vehicle": "v", "laws": laws}], {})


def test_fronts_are_compared_where_they_are_converged_and_all_pairs_count() -> None:
    first, second, third = [2.0, 2.02, 2.04], [1.9, 1.92, 1.94], [1.0, 1.02, 1.04]
    fronts = made_up_fronts(first, second, third)
    alone = float(comparison_fronts.welch(first, second))
    assert alone < 0.05 / 3
    assert fronts.verdict("a", "b") == "better on v"
    assert fronts.verdict("c", "a") == "worse on v"
    assert fronts.p_values["v", "a", "b"] == pytest.approx(alone)  # the largest of three
    assert fronts.p_values["v", "a", "c"] > comparison_fronts.welch(first, third)
    assert made_up_fronts(first, [1.97, 2.0, 2.03]).verdict("a", "b") == "open on v"
    assert made_up_fronts(first, second, converged=False).verdict("a", "b") == "not converged on v"
    assert made_up_fronts(first).verdict("a", "b") == "not searched on v"
    # one value of all seeds shows no scatter to compare with
    assert made_up_fronts([2.0, 2.0], [1.0, 1.0]).verdict("a", "b") == "open on v"


@pytest.mark.parametrize(("error", "word"), [(0.94, "better"), (0.96, "equal")])
def test_a_law_is_better_than_its_special_case_where_an_error_is_lower(error: float, word: str) -> None:
    """Its seeds begin there: a test of their hypervolumes would find any gain."""
    laws = [
        {
            "name": name,
            "title": name,
            "hypervolumes": [2.0, v],
            "is_converged": True,
            "least_errors": [errors],
        }
        for name, v, errors in (("l1-pi", 2.1, [1.0, error]), ("pid", 1.9, [1.0, 1.0]))
    ]
    found = comparison_fronts.Fronts([{"vehicle": "v", "laws": laws}], {})
    assert found.verdict("l1-pi", "pid") == f"{word} on v"
    assert found.verdict("pid", "l1-pi") == f"{word.replace('better', 'worse')} on v"


def test_the_indices_are_of_the_laws_of_the_protocol(fronts: Any) -> None:
    for found in fronts.sensitivity.values():
        assert [*found["ranks"]] == [*read_protocol().controllers]


def test_the_cases_that_repeat_the_nominal_one_are_those_that_do(document: Score) -> None:
    """The correlation is over tuned and default gains; the search needs its cases anyway."""
    kinds = [score.part(document, which).rows for which in (score.TUNED, score.START)]
    repeating = set[str]()
    for case, info in document.protocol.cases.items():
        pairs = [
            [[row.cases[name].metrics["rmse"] for row in rows] for name in ("nominal", case)]
            for rows in kinds
        ]
        correlations = [np.corrcoef([stats.rankdata(values) for values in pair])[0, 1] for pair in pairs]
        assert comparison_page.Numbers(document).correlation(case) == pytest.approx(
            min(correlations), abs=1e-12
        )
        fails = any(row.cases[case].failed for row in document.rows)
        if min(correlations) > comparison_page.REPEATS and not fails and not info.tuned_on:
            repeating.add(case)
    assert {name for name, info in document.protocol.cases.items() if info.repeats_nominal} == repeating
    drawn = set(document.protocol.cases) - repeating
    assert all(set(row.draws) == drawn for row in kinds[0])


def many_runs(document: Score) -> Iterator[tuple[ManyRuns, int]]:
    tables = read_protocol().tables
    for row in document.rows:
        yield plants(row), tables.plants.count
        for runs in row.draws.values():
            yield runs, tables.repetitions


def test_the_statistics_are_those_of_the_runs(document: Score) -> None:
    """The file has the values of each run for tuned controllers and nominal cases."""
    interval = cache(proportion_interval)  # of few numbers of failures
    for runs, count in many_runs(document):
        assert runs.count == count
        assert runs.failure_rate == pytest.approx(len(runs.failed) / count, rel=ROUNDED)
        assert runs.failure_interval == pytest.approx(interval(len(runs.failed), count), rel=ROUNDED)
        for metric in runs.metrics.values():
            if metric.values:
                statistics = [metric.median, metric.p95, metric.cvar]
                assert statistics == pytest.approx(astuple(distribution(metric.values)), rel=ROUNDED)
    assert all(plants(row).metrics["rmse"].values for row in score.part(document, score.TUNED).rows)


def test_the_differences_are_of_every_pair_on_the_same_plants(document: Score) -> None:
    rows = score.part(document, score.TUNED).rows
    pairs = list(combinations(rows, 2))
    assert [(e.scored, e.other) for e in document.differences] == [(a.name, b.name) for a, b in pairs]
    for entry, (first, second) in zip(document.differences, pairs, strict=True):
        minuend, subtrahend = (plants(row).metrics["rmse"].values for row in (first, second))
        expected = paired(minuend, subtrahend, len(pairs))
        # two errors of rounding in a difference
        near = 2.0 * ROUNDED * float(np.nanmax([minuend, subtrahend]))
        assert entry.median_difference == pytest.approx(expected.median_difference, abs=near)
        assert entry.interval == pytest.approx(expected.interval, abs=near)
        assert entry.verdict == expected.verdict, (first.name, second.name)
    corrected = holm({entry.other + entry.scored: entry.p for entry in document.differences})
    assert [entry.p_holm for entry in document.differences] == pytest.approx(
        [*corrected.values()], rel=ROUNDED
    )


def test_the_profile_is_that_of_the_draws_of_cases_that_are_not_tuned_on(
    document: Score, numbers: Any
) -> None:
    """Cases are counted one by one: within twice the smallest error of the runs that did not fail."""
    rows = score.part(document, score.TUNED).rows
    cases = [name for name in rows[0].draws if not document.protocol.cases[name].tuned_on]
    within, total = dict.fromkeys((row.name for row in rows), 0), 0
    for case in cases:
        for number in range(rows[0].draws[case].count):
            errors = {
                row.name: row.draws[case].metrics["rmse"].values[number]
                for row in rows
                if str(number) not in row.draws[case].failed
            }
            total += 1
            for name, error in errors.items():
                within[name] += error <= 2.0 * min(errors.values())
    expected = {name: 100.0 * count / total for name, count in within.items()}
    assert {name: share[0] for name, share in numbers.profiles(cases, [2.0]).items()} == pytest.approx(
        expected
    )
    assert min(expected.values()) < 50.0 < max(expected.values())


def test_the_best_of_a_case_has_the_least_median_and_none_beside_it_is_worse(numbers: Any) -> None:
    for case in ("", *numbers.repeated):
        best, near = numbers.leaders(case)
        errors = {row.name: numbers.errors(row, case) for row in numbers.tuned}
        assert errors[best.name].median == min(metric.median for metric in errors.values())
        apart = errors.keys() - {best.name, *(row.name for row in near)}
        for name in apart:
            difference = np.subtract(errors[name].values, errors[best.name].values)
            assert np.median(difference) > 0.05 * errors[best.name].median
    assert not math.isnan(numbers.correlation("hold-waves"))


def test_the_figure_shows_every_tuned_controller(document: Score) -> None:
    assert comparison_page.figure(document).startswith(b"\x89PNG")


def test_the_committed_run_is_what_the_page_reads_of_a_comparison() -> None:
    """`python .ci/comparison_page.py results/comparison.json` writes it."""
    text = (EXPLANATION / "comparison.json").read_text(encoding="utf-8")
    assert comparison_page.written(comparison_page.reduced(json.loads(text))) == text
    assert len(text) < 300_000  # a document of the repository, not a store of results


@pytest.mark.slow
def test_the_run_is_of_the_protocol_and_the_gains_that_ship(document: Score) -> None:
    protocol = read_protocol()
    assert document.protocol.version == protocol.version
    shipped = {name: (case.tuned_on, case.repeats_nominal) for name, case in protocol.cases.items()}
    run = {name: (case.tuned_on, case.repeats_nominal) for name, case in document.protocol.cases.items()}
    assert run == shipped
    assert {row.name for row in document.rows} == {c.name for c in score.controllers(protocol)}
    for row in document.rows:
        which, _, name = row.name.partition("/")
        gains = tuned_gains(name, built_in(protocol, name).fmu) if which == score.TUNED else {}
        assert row.parameters == {**protocol.controllers[name].parameters, **gains}, row.name
