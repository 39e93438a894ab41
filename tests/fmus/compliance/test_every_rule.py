"""Each rule is shown to find what it is there for."""

from fmus.compliance.behaviour import FUNDAMENTAL
from fmus.compliance.rule import MODULES, all_rules
from tests.mutants.slaves import MUTANTS

from .archives import FALSE_CLAIMS

BY_A_TEST_OF_ITS_OWN = {"library-exports", "library-loads", "clocks-have-partitions"}


def test_every_rule_has_a_mutant_that_breaks_it() -> None:
    lists = {rule for mutant in MUTANTS for rule in mutant.rules} | {rule for rule, *_ in FALSE_CLAIMS}
    assert lists | BY_A_TEST_OF_ITS_OWN == {rule.name for rule in all_rules()}


def test_the_order_of_rules_is_that_of_topics_and_not_of_imports() -> None:
    modules = dict.fromkeys(rule.module for rule in all_rules())
    assert [module.rpartition(".")[2] for module in modules] == list(MODULES)


def test_every_rule_that_another_one_needs_exists() -> None:
    names = {rule.name for rule in all_rules()}
    assert [(rule.name, need) for rule in all_rules() for need in rule.needs if need not in names] == []
    assert set(FUNDAMENTAL) <= names
