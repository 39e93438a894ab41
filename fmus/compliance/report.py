"""What the check found: a table for people, JSON for programs, and the documentation of the rules."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from fmus.compliance.rule import Result, Rule

Findings = Mapping[Path, Sequence[Result]]


def count(findings: Findings, outcome: str) -> int:
    """How many messages of an outcome ("error", "warning") there are in all."""
    return sum(len(r.messages) for results in findings.values() for r in results if r.outcome == outcome)


def summary(results: Sequence[Result]) -> str:
    """One line: how many rules passed, and so on."""
    outcomes = Counter(each.outcome for each in results)
    known = ("passed", "not applicable", "warning", "error")
    return ", ".join(f"{outcomes[each]} {each}" for each in known if outcomes[each])


def lines(results: Sequence[Result]) -> list[str]:
    """A line for each message: what it means, rule, clause, message."""
    return [
        f"{each.outcome}: {each.rule.name} ({each.rule.clause}): {message}"
        for each in results
        for message in each.messages
    ]


def table(title: str, results: Sequence[Result]) -> Table:
    """A row for each rule."""
    found = Table(title=escape(title), title_justify="left")
    for heading in ("Rule", "FMI 2.0.5", "Outcome", "Said"):
        found.add_column(heading, overflow="fold")
    for each in results:
        said = "\n".join(each.messages) or each.not_applicable
        found.add_row(each.rule.name, escape(each.rule.clause), each.outcome, escape(said))
    return found


def document(findings: Findings) -> dict[str, Any]:
    """What is written as JSON."""
    return {
        "errors": count(findings, "error"),
        "warnings": count(findings, "warning"),
        "fmus": [
            {"fmu": str(path), "rules": [_rule(r) for r in results]} for path, results in findings.items()
        ],
    }


def _rule(result: Result) -> dict[str, Any]:
    rule = result.rule
    told = {"rule": rule.name, "clause": rule.clause, "claim": rule.claim, "outcome": result.outcome}
    return {**told, "messages": list(result.messages), "not_applicable": result.not_applicable}


def write_json(findings: Findings, file: str) -> None:
    """To a file, or to standard output if that is called "-"."""
    text = json.dumps(document(findings), indent=2) + "\n"
    if file == "-":
        print(text, end="")
    else:
        Path(file).write_text(text, encoding="utf-8")


def markdown(rules: Sequence[Rule]) -> str:
    """The table of rules that stands in docs/reference/compliance.md."""
    rows = [f"| `{r.name}` | {r.clause} | {r.level} | {r.claim} |" for r in rules]
    return "\n".join(["| rule | FMI 2.0.5 | if broken | what holds |", "|---|---|---|---|", *rows])
