"""What docs/explanation/comparison.md says follows from the run that ships beside it."""

import json
import re
import runpy
from dataclasses import astuple
from pathlib import Path

import pytest

from orchestration.score import compare
from orchestration.score.closed_loop import tuned_gains
from orchestration.score.protocol import read_protocol
from orchestration.score.score_document import OF_A_ROW, Score
from orchestration.score.statistics import compare as paired
from orchestration.score.statistics import distribution

EXPLANATION = Path(__file__).parent.parent / "docs" / "explanation"
PAGE = (EXPLANATION / "comparison.md").read_text(encoding="utf-8")
CLAIMS = PAGE[PAGE.index("## What follows") : PAGE.index("## Tables")]
WITHDRAWN = ["the tuned L1 with PI is a PID", "the extension still helps a tuned law", "projection"]


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


def test_the_findings_are_those_of_the_run(document: Score) -> None:
    m = metrics(document)
    assert m["tuned/l1.nominal.rmse"] < m["start/l1-pi.nominal.rmse"]
    tuned = [row for row in document.rows if row.name.startswith(f"{compare.TUNED}/")]
    identified = min(m["start/l1.delay_margin"], m["start/l1-pi.delay_margin"])
    assert max(row.delay_margin for row in tuned) < 2.0 / 3.0 * identified
    nonlinear = next(row for row in tuned if row.name == "tuned/l1-nonlinear-p")
    assert nonlinear.cases["thruster-lag"].failed
    assert m["tuned/l1-nonlinear-p.thruster-lag.rmse"] > 10.0 * m["tuned/l1-nonlinear-p.nominal.rmse"]
    assert m["tuned/l1-nonlinear-p.plants.failure_rate"] > 0.1
    frozen = {name: m[f"tuned/{name}.frozen.overshoot"] for name in ("l1-inside", "l1-outside", "l1-pi")}
    assert min(frozen["l1-inside"], frozen["l1-outside"]) > 5.0 > frozen["l1-pi"]


def test_findings_stay_withdrawn_while_the_adaptation_gain_of_l1_is_not_tuned() -> None:
    """What is found of a law with a gain held, beside laws with all gains free, is of the tuning."""
    assert not [name for name in read_protocol().controllers if "adaptation_gain" in tuned_gains(name)]
    assert "estimate_gain" in tuned_gains("mrac")
    assert [words for words in WITHDRAWN if words in PAGE] == WITHDRAWN
    assert not [words for words in WITHDRAWN if words in CLAIMS]


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
