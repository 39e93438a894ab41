"""In each copy of an FMU that is broken at one place, the rule that it breaks is named."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import pytest

from fmus.build.documentation.reference_results import LS_REF

from .archives import Members, breaks, broken_rules, members, write
from .mutants import ARCHIVE_MUTANTS, XML, XML_MUTANTS

Change = Callable[[Members], Members]
EXPERIMENT = f"extra/{LS_REF}/L1Controller.exp"  # it would be run again for each


def _replaced(content: Members, old: str, new: str) -> Members:
    xml = content[XML].decode()
    assert old in xml
    other = {path: data for path, data in content.items() if path != EXPERIMENT}
    return other | {XML: xml.replace(old, new, 1).encode()}


MUTANTS = [
    *((rule, partial(_replaced, old=old, new=new)) for rule, old, new in XML_MUTANTS),
    *ARCHIVE_MUTANTS,
]


@pytest.fixture
def mutant(built: Mapping[str, Path], tmp_path: Path) -> Callable[[Change], Path]:
    return lambda change: write(change(members(built["L1Controller"])), tmp_path / "mutant.fmu")


@pytest.mark.parametrize(("rule", "change"), MUTANTS)
def test_the_rule_that_is_broken_finds_it(
    mutant: Callable[[Change], Path], rule: str, change: Change
) -> None:
    assert breaks(mutant(change), rule)


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "change"), MUTANTS)
def test_the_whole_check_names_the_rule_that_is_broken(
    mutant: Callable[[Change], Path], rule: str, change: Change
) -> None:
    broken = broken_rules(mutant(change))
    assert rule in broken, broken
