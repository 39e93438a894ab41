"""The table of the standard leads from each sentence to its rules and back."""

import re
import runpy
from pathlib import Path

from fmus.compliance.rule import Level, Stage, all_rules, of_version
from fmus.compliance.sentences import ADVICE, NO_DEMANDS, levels, rule_table, sentences, sentences_of, titles

ROOT = Path(__file__).parents[3]


def test_every_rule_that_a_sentence_names_exists() -> None:
    names = {rule.name for rule in all_rules()}
    both = *sentences(), *sentences(3)
    assert [(s.clause, name) for s in both for name in s.rules if name not in names] == []


def test_a_sentence_has_rules_or_the_reason_why_no_check_sees_it_broken() -> None:
    assert [(s.clause, s.text) for s in sentences() if bool(s.rules) == bool(s.not_observable)] == []


def test_every_rule_checks_a_sentence_or_is_labelled_advice() -> None:
    rules = [rule for rule in all_rules() if not rule.clause.startswith(ADVICE)]
    assert [rule.name for rule in rules if not (sentences_of(rule.name) or sentences_of(rule.name, 3))] == []


def test_each_rule_has_a_level_with_a_reason_in_one_line_and_no_other_has_one() -> None:
    assert set(levels()) == {rule.name for rule in all_rules()}
    assert [name for name, (level, _) in levels().items() if level not in list(Level)] == []
    assert [name for name, (_, reason) in levels().items() if not 10 < len(reason) <= 90] == []
    assert {*rule_table()["both"], *rule_table()["pythonfmu"]} <= set(levels())


def test_advice_is_what_no_sentence_demands_and_the_rest_is_demanded() -> None:
    for rule in (rule for fmi in (2, 3) for rule in of_version(all_rules(), fmi)):
        demanding = [sentence for sentence in sentences_of(rule.name, rule.fmi) if not sentence.no_demand]
        assert (rule.level is Level.ADVICE) == (not demanding), (rule.name, demanding)
    assert {sentence.no_demand for sentence in (*sentences(), *sentences(3))} == {"", *NO_DEMANDS}


def test_what_no_importer_stumbles_over_is_no_error() -> None:
    """An alias without the unit of another gives no wrong value."""
    assert levels()["alias-units"][0] == Level.ERROR
    assert levels()["alias-units-are-complete"][0] == Level.DEVIATION


def test_a_rule_of_files_names_the_clauses_of_its_sentences() -> None:
    for rule in all_rules():
        if rule.stage is not Stage.BEHAVIOUR:
            named = set(re.findall(r"\d(?:\.\d)+", rule.clause)) & set(titles())
            assert named <= {sentence.clause for sentence in sentences_of(rule.name)}, rule.name


def test_every_clause_that_binds_an_fmu_has_sentences() -> None:
    """Sections 2.1 to 4.3 but for the examples, 3.2.4, 3.3.2, 4.2.5 and 4.3.2."""
    clauses = {sentence.clause for sentence in sentences()}
    sections = {"2.1": 9, "2.2": 9, "2.3": 2, "3.2": 3, "3.3": 1, "4.1": 2, "4.2": 4, "4.3": 1}
    expected = {f"{section}.{i}" for section, count in sections.items() for i in range(1, count + 1)}
    assert (expected | {"3.1"}) - clauses == set()


def test_the_page_of_the_standard_has_a_row_for_each_sentence_and_for_each_rule_its_address() -> None:
    """The page of the site; `helpUri` of SARIF leads to the anchor of a rule."""
    page = runpy.run_path(str(ROOT / ".ci" / "fmi2_page.py"))["page"]()
    assert re.findall(r'^\| <a id="([\w-]+)"></a>`', page, re.M) == [rule.name for rule in all_rules()]
    rows = {entry.text: f"\n| {entry.text.replace('|', chr(92) + '|')} | " for entry in sentences()}
    assert [text for text, row in rows.items() if row not in page] == []
