"""The sentences of FMI 2.0.5 that bind an FMU, each with the rules that check it or why none does.

The data are the TOML files in `sentences/`: one for each section of the standard, in its order, with a table
for each clause, and `rules.toml` with the level of each rule.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

_FOLDER = resources.files("fmus.compliance") / "sentences"
NO_DEMANDS = {
    "should": "the sentence says should",
    "note": "it stands in an informative note",
    "importer": "it binds the importer",
    "explanation": "it explains",
}
ADVICE = "advice"  # begins the clause of a rule that no sentence of FMI demands


@dataclass(frozen=True)
class Sentence:
    """One sentence in other words. Exactly one of rules and not_observable is not empty.

    not_observable: why no check of an FMU from outside can see it broken.
    no_demand: why it demands nothing of an FMU, one of `NO_DEMANDS`; empty if it does.
    """

    clause: str
    text: str
    rules: tuple[str, ...] = ()
    not_observable: str = ""
    no_demand: str = ""


@cache
def _tables() -> Mapping[str, Mapping[str, Any]]:
    """Returns heading of a clause -> sentence -> its rules, or a table with the fields of `Sentence`."""
    paths = sorted((path for path in _FOLDER.iterdir() if path.name[0].isdigit()), key=lambda p: p.name)
    return {
        heading: entries
        for path in paths
        for heading, entries in tomllib.loads(path.read_text(encoding="utf-8")).items()
    }


@cache
def rule_table() -> Mapping[str, Any]:
    """Returns `rules.toml`: level -> rule -> reason, and the lists "off" and "pythonfmu" of rules."""
    return tomllib.loads((_FOLDER / "rules.toml").read_text(encoding="utf-8"))


@cache
def levels() -> dict[str, tuple[str, str]]:
    """Returns name of a rule -> its level ("error", "deviation", "advice") and the reason."""
    tables = {level: rule_table()[level] for level in ("error", "deviation", "advice")}
    return {name: (level, reason) for level, table in tables.items() for name, reason in table.items()}


@cache
def sentences() -> tuple[Sentence, ...]:
    """Returns all sentences, in the order of the standard."""
    return tuple(
        _sentence(heading.split()[0], text, entry)
        for heading, entries in _tables().items()
        for text, entry in entries.items()
    )


def _sentence(clause: str, text: str, entry: Any) -> Sentence:
    fields = entry if isinstance(entry, dict) else {"rules": entry}
    return Sentence(clause, text, **{**fields, "rules": tuple(fields.get("rules", ()))})


@cache
def titles() -> dict[str, str]:
    """Returns clause -> its title in the standard, of every clause that holds sentences."""
    return {clause: title for clause, _, title in (heading.partition(" ") for heading in _tables())}


def sentences_of(rule_name: str) -> tuple[Sentence, ...]:
    """Returns the sentences that a rule checks; none for advice."""
    return tuple(sentence for sentence in sentences() if rule_name in sentence.rules)
