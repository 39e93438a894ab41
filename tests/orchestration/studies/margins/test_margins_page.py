"""docs/explanation/margins.md has the metrics of the command."""

from functools import cache
from pathlib import Path

import pytest

from orchestration.scenarios import scenario
from orchestration.studies.margins.fmu_margins import Metric
from orchestration.studies.margins.margins import judge

TEXT = (Path(__file__).parents[4] / "docs" / "explanation" / "margins.md").read_text(encoding="utf-8")


@cache
def metrics(name: str, measured: bool) -> dict[str, Metric]:
    judged = judge(scenario.load(scenario.find(name)), measured=measured).metrics
    return {f"{metric.group}: {metric.name}": metric for metric in judged}


def missing(name: str, measured: bool, groups: tuple[str, ...], column: int) -> list[str]:
    """Rows of the page that do not have the metric of the command in their column of values."""
    lines = [line for line in TEXT.splitlines() if line.startswith("| ")]
    absent, compared = [], 0
    for key, metric in metrics(name, measured).items():
        group, _, own = key.partition(": ")
        cells = [
            line.removeprefix(f"| {own} |").split("|") for line in lines if line.startswith(f"| {own} |")
        ]
        # three columns of values and unit are of the vehicle, two of the example
        own_table = [row for row in cells if len(row) == (3 if name.startswith("example") else 4)]
        compared += bool(group in groups and own_table)
        if group in groups and own_table and own_table[0][column].strip() != metric.shown:
            absent.append(f"{name}: {own} = {metric.shown}, the page has {own_table[0][column]}")
    assert compared >= 4, "the page has lost its tables"
    return absent


THEORY = ("L1-norm condition", "linear loop", "linear loop of the code", "prediction error")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "column"), [("nominal-l1", 0), ("nominal-extended", 1), ("example-extended", 0)]
)
def test_the_page_has_the_metrics_that_follow_from_theory(name: str, column: int) -> None:
    assert not missing(name, False, THEORY, column)


def test_the_table_of_adaptation_gains_is_that_of_the_linear_loop() -> None:
    shown_metrics = metrics("nominal-extended", False)
    for gain in (10, 100, 1000, 10000, 100000):
        shown = shown_metrics[f"linear loop: delay margin, adaptation_gain = {gain}"].shown
        assert f"| {gain} | {shown} |" in TEXT


@pytest.mark.slow
def test_the_page_has_the_certificate_at_both_adaptation_gains() -> None:
    found = []
    for gain in (100.0, 1e5):
        gains = {"controller.adaptation_gain": gain}
        loaded = scenario.load(scenario.find("nominal-extended"), settings=gains)
        judged = judge(loaded, over={"controller.adaptation_gain": (gain,)}, certificate=True)
        found.append([metric for metric in judged.metrics if metric.group == "certificate"])
    assert len(found[0]) == 4
    for at_100, at_1e5 in zip(*found, strict=True):
        assert f"| {at_100.name} | {at_100.shown} | {at_1e5.shown} | N/m |" in TEXT


@pytest.mark.slow
@pytest.mark.parametrize(("name", "column"), [("nominal-l1", 0), ("nominal-extended", 1)])
def test_the_page_has_the_metrics_that_are_measured(name: str, column: int) -> None:
    assert not missing(name, True, ("through the FMUs",), column)


@pytest.mark.slow
def test_the_tables_of_adaptation_gains_and_of_steps_are_measured() -> None:
    shown_metrics = metrics("nominal-extended", True)
    for gain in (10, 100, 1000, 10000, 100000):
        names = [
            f"delay margin, {p}, controller.adaptation_gain = {gain}" for p in ("control", "measurement")
        ]
        cells = " | ".join(shown_metrics[f"through the FMUs: {name}"].shown for name in names)
        assert f"| {cells} | s |" in TEXT
    example = metrics("example-extended", True)
    for step in (1, 0.2, 0.02):
        names = [f"prediction error: largest, r = {r}, step {step:g} ms" for r in (25, 100, 400)]
        assert f"| {step:g} ms | " + " | ".join(example[name].shown for name in names) + " |" in TEXT
