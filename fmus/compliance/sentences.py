"""The sentences of FMI 2.0.5 and 3.0.2 that bind an FMU, each with the rules that check it or why none does.

The data are the TOML files in `sentences/`: one for each section of FMI 2.0.5, in its order, with a table
for each clause; `fmi3.toml` with the clauses of FMI 3.0.2; and `rules.toml` with the level of each rule.
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
    "may": "the sentence permits it",
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
def _tables(fmi: int) -> Mapping[str, Mapping[str, Any]]:
    """Returns heading of a clause -> sentence -> its rules, or a table with the fields of `Sentence`."""
    paths = sorted((path for path in _FOLDER.iterdir() if path.name[0].isdigit()), key=lambda p: p.name)
    paths = paths if fmi == 2 else [_FOLDER / "fmi3.toml"]
    return {
        heading: entries
        for path in paths
        for heading, entries in tomllib.loads(path.read_text(encoding="utf-8")).items()
    }


@cache
def rule_table() -> Mapping[str, Any]:
    """Returns `rules.toml`: level -> rule -> reason, and the lists "both" and "pythonfmu" of rules."""
    return tomllib.loads((_FOLDER / "rules.toml").read_text(encoding="utf-8"))


@cache
def levels() -> dict[str, tuple[str, str]]:
    """Returns name of a rule -> its level ("error", "deviation", "advice") and the reason."""
    tables = {level: rule_table()[level] for level in ("error", "deviation", "advice")}
    return {name: (level, reason) for level, table in tables.items() for name, reason in table.items()}


@cache
def sentences(fmi: int = 2) -> tuple[Sentence, ...]:
    """Returns all sentences of a version of the standard, in its order."""
    return tuple(
        _sentence(heading.split()[0], text, entry)
        for heading, entries in _tables(fmi).items()
        for text, entry in entries.items()
    )


def _sentence(clause: str, text: str, entry: Any) -> Sentence:
    fields = entry if isinstance(entry, dict) else {"rules": entry}
    return Sentence(clause, text, **{**fields, "rules": tuple(fields.get("rules", ()))})


@cache
def titles(fmi: int = 2) -> dict[str, str]:
    """Returns clause -> its title in the standard, of every clause that holds sentences."""
    return {clause: title for clause, _, title in (heading.partition(" ") for heading in _tables(fmi))}


def sentences_of(rule_name: str, fmi: int = 2) -> tuple[Sentence, ...]:
    """Returns the sentences that a rule checks; none for advice."""
    return tuple(sentence for sentence in sentences(fmi) if rule_name in sentence.rules)


@cache
def clauses_of(rule_name: str, fmi: int) -> str:
    """Returns the clauses of the sentences that a rule checks, with their titles, or ""."""
    clauses = dict.fromkeys(sentence.clause for sentence in sentences_of(rule_name, fmi))
    return ", ".join(f"{clause} {titles(fmi)[clause]}" for clause in clauses)
