"""Mutants that the file alone shows: of the model description and of the archive."""

from functools import partial

from tests.mutants.base import Members, changed, written
from tests.mutants.mutant import Mutant


def _mutant(name: str, clause: str, rules: str, members: Members) -> Mutant:
    return Mutant(name, clause, frozenset(rules.split()), partial(written, members))


STATIC_MUTANTS = tuple(
    _mutant(name, clause, rules, changed((old, new)))
    for name, clause, rules, old, new in [
        (
            "an element that the schema does not know",
            "2.2",
            "schema",
            "<LogCategories>",
            "<X/><LogCategories>",
        ),
        (
            "a unit defined twice",
            "2.2.2",
            "unit-names-are-unique",
            "  </UnitDefinitions>",
            '<Unit name="kg"/></UnitDefinitions>',
        ),
    ]
)
