"""Each sentence of FMI that an FMU breaks by what it does is found by its rules and no others."""

from pathlib import Path

import pytest

from tests.mutants.behaviour import BEHAVIOUR_MUTANTS, LEGAL, write_slave
from tests.mutants.mutant import Mutant, broken_rules, unexpected

QUICK = ("steps beyond the stop time", "keeps the pointer to its name", "a changed rounding mode")


@pytest.mark.parametrize(
    "mutant",
    [m if m.name in QUICK else pytest.param(m, marks=pytest.mark.slow) for m in BEHAVIOUR_MUTANTS],
    ids=lambda mutant: mutant.name,
)
def test_a_mutant_that_runs_is_found_by_its_rules_and_no_others(mutant: Mutant, tmp_path: Path) -> None:
    assert list(unexpected(mutant, mutant.broken_rules(tmp_path))) == []


@pytest.mark.parametrize(
    "index", [0, *(pytest.param(i, marks=pytest.mark.slow) for i in range(1, len(LEGAL)))]
)
def test_the_slave_that_does_nothing_wrong_breaks_no_rule(index: int, tmp_path: Path) -> None:
    flags, changes, allowed = LEGAL[index]
    broken = broken_rules(write_slave(tmp_path, "", flags, changes), is_static=False)
    assert set(broken) == set(allowed)
