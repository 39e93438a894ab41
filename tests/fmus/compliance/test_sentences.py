"""The table of the standard leads from each sentence to its rules and back."""

import runpy
from pathlib import Path

from fmus.compliance.examine import all_rules
from fmus.compliance.sentences import sentences, titles

ROOT = Path(__file__).parents[3]


def test_every_rule_that_a_sentence_names_exists() -> None:
    names = {rule.name for rule in all_rules()}
    assert [(s.clause, name) for s in sentences() for name in s.rules if name not in names] == []


def test_every_sentence_stands_in_a_clause_with_a_title() -> None:
    assert {sentence.clause for sentence in sentences()} == set(titles())


def test_the_page_of_the_standard_is_what_the_code_gives() -> None:
    """Printed by `python .ci/fmi2_page.py`."""
    page = runpy.run_path(str(ROOT / ".ci" / "fmi2_page.py"))["page"]()
    assert (ROOT / "docs" / "reference" / "fmi2.md").read_text(encoding="utf-8") == page
