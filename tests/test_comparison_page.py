"""What docs/explanation/comparison.md says follows from the run that ships beside it, and from the searches.

A metric stands before a comment with the expression that gives it: 1.02<!-- {tuned/l1.nominal.rmse} -->.
What a sentence says besides is a condition: <!-- holds: {tuned/l1.nominal.rmse} < 2 -->.
"""

import json
import re
import runpy
import tomllib
from dataclasses import astuple
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from orchestration.score import compare
from orchestration.score.closed_loop import GAINS, tuned_gains
from orchestration.score.protocol import read_protocol
from orchestration.score.score_document import OF_A_ROW, Score
from orchestration.score.statistics import compare as paired
from orchestration.score.statistics import distribution

EXPLANATION = Path(__file__).parent.parent / "docs" / "explanation"
PAGE = (EXPLANATION / "comparison.md").read_text(encoding="utf-8")
CLAIMS = PAGE[PAGE.index("## What follows") : PAGE.index("## Tables")]
METRIC = re.compile(r"(?<![\w.])(-?\d[\d.]*)<!-- (.+?) -->")
HOLDS = re.compile(r"<!-- holds: (.+?) -->", re.DOTALL)
SENTENCE = re.compile(r"(?<=\.)\s+(?=(?:[-*] ?)*[A-Z])")
WITHDRAWN = ["the tuned L1 with PI is a PID", "the extension still helps a tuned law", "projection"]
NUMBER = re.compile(r"(?<![\w/.-])-?\d+(\.\d+)?(?![\w/])")


@pytest.fixture(scope="module")
def document() -> Score:
    return Score.model_validate_json((EXPLANATION / "comparison.json").read_text(encoding="utf-8"))


def metrics(document: Score) -> dict[str, float]:
    """By the keys of the page, such as "tuned/l1.nominal.rmse", "tuned/l1.plants.rmse.p95"."""
    found: dict[str, float] = {}
    for row in document.rows:
        found |= {f"{row.name}.{name}": getattr(row, name) for name in OF_A_ROW}
        for case, result in row.cases.items():
            found |= {f"{row.name}.{case}.{name}": number for name, number in result.metrics.items()}
        if row.plants:
            found[f"{row.name}.plants.failure_rate"] = row.plants.failure_rate
            for name, over_plants in row.plants.metrics.items():
                for statistic in ("median", "p95", "cvar"):
                    found[f"{row.name}.plants.{name}.{statistic}"] = getattr(over_plants, statistic)
    for entry in document.differences:
        numbers = (entry.median_difference, *entry.interval, entry.p_holm)
        for part, number in zip(("median", "low", "high", "p"), numbers, strict=True):
            found[f"{entry.other}.difference.{entry.metric}.{part}"] = number
    return found


def value(document: Score, expression: str) -> Any:
    """Of Python, over keys in braces: {tuned/l1.nominal.rmse}, {search/l1.cost}, {gain/pid.kp}."""
    code, metrics_by_key = re.sub(r"\{(.+?)\}", r"metric('\1')", expression), metrics(document)

    def metric(key: str) -> float:
        kind, _, rest = key.partition("/")
        name, _, item = rest.partition(".")
        if kind == "search":
            return search(name, item)
        return float(tuned_gains(name)[item]) if kind == "gain" else metrics_by_key[key]

    def order(which: str, league: str, key: str) -> list[str]:
        """The controllers of a league, the one with the least metric first."""
        names = [row.name for row in compare.part(document, which, league).rows]
        return [name.partition("/")[2] for name in sorted(names, key=lambda name: metric(f"{name}.{key}"))]

    tuned = [row.name for row in document.rows if row.name.startswith(f"{compare.TUNED}/")]
    known = {f.__name__: f for f in (metric, order, search, abs, max, min, set)}
    names = [*read_protocol().controllers]
    return eval(" ".join(code.split()), {**known, "names": names, "tuned": tuned, "__builtins__": {}})


@cache
def search(name: str, key: str) -> Any:
    """What the file of a tuning says of its search."""
    return tomllib.loads((GAINS / f"{name}.toml").read_text(encoding="utf-8"))["tuning"][key]


def test_every_metric_agrees_with_the_run_to_the_digits_printed(document: Score) -> None:
    metrics = METRIC.findall(PAGE)
    assert len(metrics) > 20
    for printed, expression in metrics:
        digits = len(printed.partition(".")[2])
        assert f"{float(value(document, expression)):.{digits}f}" == printed, expression


def test_every_condition_holds(document: Score) -> None:
    conditions = HOLDS.findall(PAGE)
    assert len(conditions) > 10
    assert not [condition for condition in conditions if value(document, condition) is not True]


def test_every_sentence_of_what_follows_can_be_checked() -> None:
    """But for those that say what was run."""
    findings = CLAIMS[: CLAIMS.index("**Limits.**")]
    sentences = [text for part in findings.strip().split("\n\n")[1:] for text in SENTENCE.split(part)]
    assert not [text for text in sentences if "<!--" not in text]


def test_findings_stay_withdrawn_while_the_adaptation_gain_of_l1_is_not_tuned() -> None:
    """What is found of a law with a gain held, beside laws with all gains free, is of the tuning."""
    assert not [name for name in read_protocol().controllers if "adaptation_gain" in tuned_gains(name)]
    assert "estimate_gain" in tuned_gains("mrac")
    assert [words for words in WITHDRAWN if words in PAGE] == WITHDRAWN
    assert not [words for words in WITHDRAWN if words in CLAIMS]


def test_no_metric_of_the_claims_stands_without_what_gives_it() -> None:
    prose = re.sub(r"`.*?`|\]\(.*?\)", "", HOLDS.sub("", METRIC.sub("", CLAIMS)))
    assert not [line for line in prose.splitlines() if NUMBER.search(line)]


def test_the_tables_are_those_of_the_run(document: Score) -> None:
    shown = dict(re.findall(r"<!-- table: (.+?) -->\n+((?:\|.*\n)+)", PAGE))
    assert {name: text.rstrip("\n") for name, text in shown.items()} == compare.tables(document)


def test_the_statistics_are_those_of_the_plants(document: Score) -> None:
    """As far as the file has the values on each plant: of the two controllers that are compared below."""
    count, checked = read_protocol().tables.plants.count, []
    for row in document.rows:
        assert row.plants is not None
        assert row.plants.count == count
        assert row.plants.failure_rate == len(row.plants.failed) / count
        for metric in row.plants.metrics.values():
            if metric.values:
                checked.append(row.name)
                assert len(metric.values) == count
                statistics = [metric.median, metric.p95, metric.cvar]
                # the file has eight digits of them
                assert statistics == pytest.approx(astuple(distribution(metric.values)), rel=1e-7)
    assert sorted(checked) == sorted([compare.PAPERS, "tuned/pid"])


def test_the_differences_are_of_the_same_plants(document: Score) -> None:
    papers, pid = (
        next(row.plants for row in document.rows if row.name == name)
        for name in (compare.PAPERS, "tuned/pid")
    )
    assert papers is not None
    assert pid is not None
    expected = paired(papers.metrics["rmse"].values, pid.metrics["rmse"].values)
    given = [metrics(document)[f"tuned/pid.difference.rmse.{part}"] for part in ("median", "low", "high")]
    assert given == pytest.approx([expected.median_difference, expected.low, expected.high])


def test_the_committed_run_is_what_the_page_reads_of_a_comparison() -> None:
    """Printed by `python .ci/comparison_page.py results/comparison.json`."""
    text = (EXPLANATION / "comparison.json").read_text(encoding="utf-8")
    page = runpy.run_path(str(EXPLANATION.parent.parent / ".ci" / "comparison_page.py"))
    assert page["written"](page["reduced"](json.loads(text))) == text
    assert len(text) < 300_000  # a document of the repository, not a store of results


def test_the_run_is_of_the_protocol_and_the_gains_that_ship(document: Score) -> None:
    protocol = read_protocol()
    assert document.protocol.version == protocol.version
    assert {row.name for row in document.rows} == {c.name for c in compare.controllers(protocol)}
    for row in document.rows:
        which, _, name = row.name.partition("/")
        gains = tuned_gains(name) if which == compare.TUNED else {}
        assert row.parameters == {**protocol.controllers[name].parameters, **gains}, row.name
