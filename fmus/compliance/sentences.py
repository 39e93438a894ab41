"""The sentences of FMI 2.0.5 that bind an FMU, each with the rules that check it or why none does.

The data are the TOML files in `sentences/`: one for each section of the standard, in its order, and
`rules.toml` with the level of each rule.
"""

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from typing import Any

_RULES = "rules.toml"
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

    def __post_init__(self) -> None:
        if bool(self.rules) == bool(self.not_observable):
            got = "both" if self.rules else "neither"
            raise ValueError(
                f"sentence {self.clause}, {self.text!r}: expected rules or not_observable, got {got}"
            )


@dataclass(frozen=True)
class RuleLevel:
    """Level of one rule ("error", "deviation", "advice"), and its reason."""

    level: str
    reason: str


@cache
def _files() -> dict[str, Mapping[str, Any]]:
    """Returns name -> content of each file, in the order of the names."""
    folder = resources.files("fmus.compliance") / "sentences"
    texts = {
        path.name: path.read_text(encoding="utf-8")
        for path in folder.iterdir()
        if path.name.endswith(".toml")
    }
    return {name: tomllib.loads(texts[name]) for name in sorted(texts)}


@cache
def levels() -> dict[str, RuleLevel]:
    """Returns name of a rule -> its level."""
    tables = {level: table for level, table in _files()[_RULES].items() if isinstance(table, dict)}
    return {name: RuleLevel(level, why) for level, table in tables.items() for name, why in table.items()}


def off_by_default() -> frozenset[str]:
    """Returns the names of the rules that are judged only on demand."""
    return frozenset(_files()[_RULES]["off"])


def made_by_pythonfmu() -> frozenset[str]:
    """Returns the names of the rules that FMUs break because PythonFMU's binary does."""
    return frozenset(_files()[_RULES]["pythonfmu"])


@cache
def sentences() -> tuple[Sentence, ...]:
    """Returns all sentences, in the order of the standard."""
    entries = [entry for file in _files().values() for entry in file.get("sentence", ())]
    return tuple(Sentence(**entry | {"rules": tuple(entry.get("rules", ()))}) for entry in entries)


@cache
def titles() -> dict[str, str]:
    """Returns clause -> its title in the standard, of every clause that holds sentences."""
    return {clause: title for file in _files().values() for clause, title in file.get("titles", {}).items()}


def sentences_of(rule_name: str) -> tuple[Sentence, ...]:
    """Returns the sentences that a rule checks; none for advice."""
    return tuple(sentence for sentence in sentences() if rule_name in sentence.rules)
