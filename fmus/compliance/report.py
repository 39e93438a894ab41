"""What the check found: lines for people, JSON for programs."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fmus.compliance.rule import OUTCOMES, Result

Findings = Mapping[Path, Sequence[Result]]


def count(findings: Findings, outcome: str) -> int:
    """How many messages of an outcome ("error", "warning") there are in all."""
    return sum(len(r.messages) for results in findings.values() for r in results if r.outcome == outcome)


def summary(results: Sequence[Result]) -> str:
    """One line: how many rules passed, and so on."""
    counts = Counter(result.outcome for result in results)
    return ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES if counts[outcome])


def lines(results: Sequence[Result], every: bool = False) -> list[str]:
    """A line for each message: outcome, rule, clause, message. every: a line for the other rules too."""
    return [
        f"{result.outcome}: {result.rule.name} ({result.rule.clause}): {message}"
        for result in results
        for message in result.messages
        or [result.not_judged or result.not_applicable or result.rule.claim] * every
    ]


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
    return {
        **{"rule": rule.name, "clause": rule.clause, "claim": rule.claim, "outcome": result.outcome},
        **{
            "messages": list(result.messages),
            "not_applicable": result.not_applicable,
            "not_judged": result.not_judged,
        },
    }


def write_json(findings: Findings, file: str) -> None:
    """To a file, or to standard output if that is called "-"."""
    text = json.dumps(document(findings), indent=2) + "\n"
    if file == "-":
        print(text, end="")
    else:
        Path(file).write_text(text, encoding="utf-8")
