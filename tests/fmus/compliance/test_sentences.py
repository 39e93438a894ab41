"""The table of the standard leads from each sentence to its rules and back."""

import re
import runpy
from pathlib import Path

from fmus.compliance.examine import all_rules
from fmus.compliance.rule import Stage
from fmus.compliance.sentences import ADVICE, sentences, sentences_of, titles

ROOT = Path(__file__).parents[3]


def test_every_rule_that_a_sentence_names_exists() -> None:
    names = {rule.name for rule in all_rules()}
    assert [(s.clause, name) for s in sentences() for name in s.rules if name not in names] == []


def test_a_rule_names_a_clause_of_each_section_whose_sentences_it_checks_or_is_advice() -> None:
    """A rule may say less exactly than its sentences where in a section they stand, but no other section."""
    for rule in all_rules():
        clauses = {sentence.clause for sentence in sentences_of(rule.name)}
        if rule.stage is Stage.BEHAVIOUR:
            continue
        assert clauses or rule.clause.startswith(ADVICE), rule.name
        named = set(re.findall(r"\d(?:\.\d)+", rule.clause)) & set(titles())
        assert named <= clauses, (rule.name, clauses)


def test_every_sentence_stands_in_a_clause_with_a_title() -> None:
    assert {sentence.clause for sentence in sentences()} == set(titles())


def test_the_page_of_the_standard_is_what_the_code_gives() -> None:
    """Printed by `python .ci/fmi2_page.py`."""
    page = runpy.run_path(str(ROOT / ".ci" / "fmi2_page.py"))["page"]()
    assert (ROOT / "docs" / "reference" / "fmi2.md").read_text(encoding="utf-8") == page
