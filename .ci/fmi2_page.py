"""Page reference/fmi2.md, which rule checks which sentence of FMI 2.0.5, from the code."""

import re
from collections import Counter
from collections.abc import Sequence

from fmus.compliance.rule import Level, Rule, all_rules
from fmus.compliance.sentences import (
    NO_DEMANDS,
    Sentence,
    levels,
    sentences,
    sentences_of,
    titles,
)
from orchestration.cli.explain import markdown_table

_HEAD = """\
# FMI 2.0.5, sentence by sentence

Sentences of FMI 2.0.5 that bind an FMU, by clause and in our words, with the rules of `l1-depth check`
that check them ([what the check does](compliance.md)), or the reason why none does.
The text of the standard is public: repository `modelica/fmi-standard`, tag `v2.0.5`.
`python -m tests.mutants` makes FMUs that each break one sentence, where there is such a mutant, and prints
which rules find it."""

_NOT_CHECKED = "not checked"
_LEVELS = """\
The level of a rule is the consequence of breaking it. *error*: an importer that follows the standard fails,
crashes or gets a wrong result. *deviation*: a sentence demands it, but no known importer fails because
of it. *advice*: no sentence demands it."""


def page() -> str:
    """The page with its line end."""
    rules = all_rules()
    parts = [_HEAD, _counts(sentences(), rules), *map(_section, titles()), _rules(rules)]
    return "\n\n".join(parts) + "\n"


def _counts(entries: Sequence[Sentence], rules: Sequence[Rule]) -> str:
    checked = sum(bool(entry.rules) for entry in entries)
    left_out = sum(entry.not_observable.startswith(_NOT_CHECKED) for entry in entries)
    counts = Counter(rule.level for rule in rules)
    unseen = len(entries) - checked - left_out
    return (
        f"{len(entries)} sentences: {checked} are checked, {unseen} cannot be observed, "
        f"{left_out} are not checked for the reason given. "
        f"{len(rules)} rules: "
        f"{counts[Level.ERROR]} errors, {counts[Level.DEVIATION]} deviations, {counts[Level.ADVICE]} advice."
    )


def _section(clause: str) -> str:
    rows = [(entry.text, _checked_by(entry)) for entry in sentences() if entry.clause == clause]
    return f"## {_heading(clause)}\n\n{markdown_table(('What the text says', 'Checked by'), rows)}"


def _heading(clause: str) -> str:
    return f"{clause} {titles()[clause]}"


def _checked_by(entry: Sentence) -> str:
    if entry.rules:
        names = ", ".join(f"`{name}`" for name in entry.rules)
        return f"{names} ({NO_DEMANDS[entry.no_demand]})" if entry.no_demand else names
    reason = entry.not_observable
    return reason if reason.startswith(_NOT_CHECKED) else f"not observable: {reason}"


def _rules(rules: Sequence[Rule]) -> str:
    rows = [
        (
            f'<a id="{rule.name}"></a>`{rule.name}`',
            _clauses(rule),
            rule.claim,
            rule.level,
            levels()[rule.name][1],
        )
        for rule in rules
    ]
    heads = ("Rule", "Clause", "What holds", "Level", "Reason for the level")
    return f"## Rules\n\n{_LEVELS}\n\n{markdown_table(heads, rows)}"


def _clauses(rule: Rule) -> str:
    """Links to the clauses whose sentences a rule checks, or what kind of advice it is."""
    clauses = dict.fromkeys(sentence.clause for sentence in sentences_of(rule.name))
    links = ", ".join(f"[{clause}](#{_anchor(_heading(clause))})" for clause in clauses)
    of_fmi3 = ", ".join(dict.fromkeys(sentence.clause for sentence in sentences_of(rule.name, 3)))
    return "; ".join(filter(None, [links or rule.clause, of_fmi3 and f"FMI 3.0.2: {of_fmi3}"]))


def _anchor(heading: str) -> str:
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
