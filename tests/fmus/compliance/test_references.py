"""The check replays the reference results that an FMU carries."""

from collections.abc import Callable
from pathlib import Path

import pytest

from fmus.build.documentation.reference_results import LS_REF
from tests.described_fmus import members
from tests.shared_builds import Fmus

from .archives import Members, broken_rules, write

NAME = "DepthReference"
RULE = "reference-results-are-reproduced"
FOLDER = f"extra/{LS_REF}/"
EXPERIMENT = f"{FOLDER}{NAME}.exp"


@pytest.fixture
def messages(built: Fmus, tmp_path: Path) -> Callable[[Members], tuple[str, ...]]:
    """What the rule says of the FMU with other members; no other rule is broken."""

    def judged(changes: Members) -> tuple[str, ...]:
        broken = broken_rules(write(members(built[NAME]) | changes, tmp_path / "changed.fmu"))
        assert set(broken) <= {RULE}
        return broken.get(RULE, ())

    return judged


@pytest.fixture
def results(built: Fmus) -> Callable[[float], Members]:
    """The table of results, its second output at the largest value changed by a part of that."""
    path = f"{FOLDER}{NAME}_ref.csv"
    header, *lines = members(built[NAME])[path].decode().splitlines()
    rows = [line.split(",") for line in lines]

    def changed(part: float) -> Members:
        largest = max(rows, key=lambda row: abs(float(row[1])))
        table = [[row[0], repr(float(row[1]) * (1.0 + part * (row is largest))), *row[2:]] for row in rows]
        return {path: "\n".join([header, *map(",".join, table)]).encode()}

    return changed


def experiment(built: Fmus, old: str, new: str) -> Members:
    text = members(built[NAME])[EXPERIMENT].decode()
    assert old in text
    return {EXPERIMENT: text.replace(old, new).encode()}


def test_a_result_within_the_stated_tolerance_passes_and_one_beyond_it_is_named(
    messages: Callable[[Members], tuple[str, ...]], results: Callable[[float], Members]
) -> None:
    assert messages(results(0.9e-6)) == ()
    (message,) = messages(results(1.1e-6))
    assert message.startswith(f"{EXPERIMENT}: ")
    assert message.endswith("the reference result")


def test_a_tolerance_that_hides_everything_is_not_believed(
    built: Fmus,
    messages: Callable[[Members], tuple[str, ...]],
    results: Callable[[float], Members],
) -> None:
    tolerant = experiment(built, 'tolerance="1e-06"', 'tolerance="1e9"')
    assert messages(tolerant | results(0.9e-3)) == ()
    assert len(messages(tolerant | results(1.1e-3))) == 1


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("stepSize=", "stepSise=", "expected all of them"),
        ('stepSize="', 'stepSize="1e-300" was="', "expected at most 1000000"),
        ('stepSize="', 'stepSize="0.7" was="', "increasing multiples of stepSize"),
        ('stepSize="', 'stepSize="-0.8" was="', "expected all of them"),
        ('source="DepthReference_ref.csv"', 'source="none.csv"', "none.csv"),
        ('source="DepthReference_ref.csv"', 'source="DepthReference.exp"', "DepthReference.exp"),
        ("</Experiments>", "", "not well-formed"),
    ],
)
def test_an_experiment_that_cannot_be_run_is_a_finding(
    built: Fmus,
    messages: Callable[[Members], tuple[str, ...]],
    old: str,
    new: str,
    words: str,
) -> None:
    (message,) = messages(experiment(built, old, new))
    assert words in message


def test_an_experiment_with_parameters_is_left_to_others(
    built: Fmus,
    messages: Callable[[Members], tuple[str, ...]],
    results: Callable[[float], Members],
) -> None:
    parameters = experiment(built, "</Experiment>", "<Parameters/></Experiment>")
    assert messages(parameters | results(0.5)) == ()
