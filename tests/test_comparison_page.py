"""Every figure of docs/explanation/comparison.md is one of the run that ships beside it, or follows from it.

A figure stands before a comment with the expression that gives it: 1.02<!-- {tuned/l1.nominal.rmse} -->.
"""

import math
import re
from dataclasses import astuple
from pathlib import Path

import pytest

from orchestration.study import compare
from orchestration.study.protocol import read_protocol
from orchestration.study.score_document import Score
from orchestration.study.statistics import compare as paired
from orchestration.study.statistics import distribution
from orchestration.study.tuned_gains import tuned_gains

EXPLANATION = Path(__file__).parent.parent / "docs" / "explanation"
PAGE = (EXPLANATION / "comparison.md").read_text(encoding="utf-8")
CLAIMS = PAGE[PAGE.index("## What follows") : PAGE.index("## Tables")]
FIGURE = re.compile(r"(?<![\w.])(-?\d[\d.]*)<!-- (.+?) -->")
NUMBER = re.compile(r"(?<![\w/.-])-?\d+(\.\d+)?(?![\w/])")


@pytest.fixture(scope="module")
def document() -> Score:
    return Score.model_validate_json((EXPLANATION / "comparison.json").read_text(encoding="utf-8"))


def value(document: Score, expression: str) -> float:
    """An expression of Python over keys in braces."""
    code = re.sub(r"\{(.+?)\}", r"figure('\1')", expression)
    names = {"figure": lambda key: compare.figure(document, key), "min": min, "max": max, "__builtins__": {}}
    return float(eval(code, names))


def test_every_figure_agrees_with_the_run_to_the_digits_printed(document: Score) -> None:
    figures = FIGURE.findall(PAGE)
    assert len(figures) > 20
    for printed, expression in figures:
        digits = len(printed.partition(".")[2])
        assert f"{value(document, expression):.{digits}f}" == printed, expression


def test_no_figure_of_the_claims_stands_without_what_gives_it() -> None:
    prose = re.sub(r"`.*?`|\]\(.*?\)", "", FIGURE.sub("", CLAIMS))
    assert not [line for line in prose.splitlines() if NUMBER.search(line)]


def test_the_tables_are_those_of_the_run(document: Score) -> None:
    shown = dict(re.findall(r"<!-- table: (.+?) -->\n+((?:\|.*\n)+)", PAGE))
    assert {name: text.rstrip("\n") for name, text in shown.items()} == compare.tables(document)


def test_the_statistics_are_those_of_the_plants(document: Score) -> None:
    count = read_protocol().tables.plants.count
    for plants in (row.plants for row in document.rows):
        assert plants is not None
        assert plants.count == count
        assert plants.failure_rate == len(plants.failed) / count
        for figure in plants.figures.values():
            assert len(figure.values) == count
            expected = [x if math.isfinite(x) else math.nan for x in astuple(distribution(figure.values))]
            assert [figure.median, figure.p95, figure.cvar] == pytest.approx(expected, nan_ok=True)


def test_the_differences_are_of_the_same_plants(document: Score) -> None:
    papers, pid = (
        next(row.plants for row in document.rows if row.name == name)
        for name in (compare.PAPERS, "tuned/pid")
    )
    assert papers is not None
    assert pid is not None
    expected = paired(papers.figures["rmse"].values, pid.figures["rmse"].values)
    given = [
        compare.figure(document, f"tuned/pid.difference.rmse.{part}") for part in ("median", "low", "high")
    ]
    assert given == pytest.approx([expected.median_difference, expected.low, expected.high])


def test_the_run_is_of_the_protocol_and_the_gains_that_ship(document: Score) -> None:
    protocol = read_protocol()
    assert document.protocol.version == protocol.version
    assert {row.name for row in document.rows} == {c.name for c in compare.controllers(protocol)}
    for row in document.rows:
        which, _, name = row.name.partition("/")
        gains = tuned_gains(name) if which == compare.TUNED else {}
        assert row.parameters == {**protocol.controllers[name].parameters, **gains}, row.name
