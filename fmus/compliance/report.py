"""Report of the check: lines for people, and documents for programs."""

import difflib
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fmus.compliance.rule import CANNOT_LOAD, OUTCOMES, Level, Result, Rule
from fmus.compliance.sentences import sentences_of

Findings = Mapping[Path, Sequence[Result]]
_STANDARD = "https://github.com/modelica/fmi-standard/tree/v2.0.5/docs"
_SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
_SARIF_LEVELS = {Level.ERROR: "error", Level.DEVIATION: "warning", Level.ADVICE: "note"}
_GITHUB_COMMANDS = {Level.ERROR: "error", Level.DEVIATION: "warning", Level.ADVICE: "notice"}


def count(findings: Findings, outcome: str) -> int:
    """Returns the number of messages of an outcome, such as "error", in all."""
    return sum(len(r.messages) for results in findings.values() for r in results if r.outcome == outcome)


def summary(results: Sequence[Result]) -> str:
    """Returns one line: how many rules passed, and so on."""
    counts = Counter(result.outcome for result in results)
    return ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES if counts[outcome])


def total(findings: Findings) -> str:
    """Returns one line on all FMUs."""
    counts = ", ".join(f"{count(findings, level)} {level}" for level in Level)
    bad = sum(any(r.outcome == "error" for r in results) for results in findings.values())
    return f"{len(findings)} FMUs, {bad} with errors: {counts}"


def unloaded(findings: Findings) -> list[str]:
    """Returns each FMU whose library this machine cannot load, with the reason."""
    both = ((path, result) for path, results in findings.items() for result in results)
    return [f"{path}: {result.not_judged}" for path, result in both if _is_unloaded(result)]


def _is_unloaded(result: Result) -> bool:
    return result.rule.name == "library-loads" and result.not_judged.startswith(CANNOT_LOAD)


def lines(results: Sequence[Result], every: bool = False) -> list[str]:
    """Returns a line for each message (outcome, rule, clause, message), also where the library cannot load.

    every: a line for the other rules too
    """
    return [
        f"{result.outcome}: {result.rule.name} ({result.rule.clause}): {message}"
        for result in results
        for message in result.messages
        or [_reason(result) or result.rule.claim] * (every or _is_unloaded(result))
    ]


def _reason(result: Result) -> str:
    return result.not_judged or result.not_applicable


def text(findings: Findings, every: bool = False) -> str:
    """Returns the text that is printed for people."""
    parts = []
    for path, results in findings.items():
        parts += [f"{path}: {summary(results)}", *(f"  {line}" for line in lines(results, every))]
    return "\n".join([*parts, total(findings)] if len(findings) > 1 else parts) + "\n"


def json_text(findings: Findings) -> str:
    document = {
        "counts": {level.value: count(findings, level) for level in Level},
        "fmus": [
            {"fmu": str(path), "rules": [_rule(r) for r in results]} for path, results in findings.items()
        ],
    }
    return json.dumps(document, indent=2) + "\n"


def _rule(result: Result) -> dict[str, Any]:
    rule = result.rule
    return {
        "rule": rule.name,
        "clause": rule.clause,
        "claim": rule.claim,
        "outcome": result.outcome,
        "messages": list(result.messages),
        "not_applicable": result.not_applicable,
        "not_judged": result.not_judged,
    }


def sarif(findings: Findings) -> str:
    """Returns SARIF 2.1.0, which code scanning of GitHub and others read."""
    broken = [(path, result) for path, results in findings.items() for result in results if result.messages]
    rules = {result.rule.name: result.rule for _, result in broken}
    driver = {
        "name": "l1-depth check",
        "informationUri": _STANDARD,
        "rules": [
            {
                "id": rule.name,
                "shortDescription": {"text": rule.claim},
                "help": {"text": f"FMI 2.0.5, {rule.clause}"},
                "defaultConfiguration": {"level": _SARIF_LEVELS[rule.level]},
            }
            for rule in rules.values()
        ],
    }
    results = [
        {
            "ruleId": result.rule.name,
            "level": _SARIF_LEVELS[result.rule.level],
            "message": {"text": message},
            "locations": [{"physicalLocation": {"artifactLocation": {"uri": path.as_posix()}}}],
        }
        for path, result in broken
        for message in result.messages
    ]
    runs = [{"tool": {"driver": driver}, "results": results}]
    return json.dumps({"$schema": _SARIF_SCHEMA, "version": "2.1.0", "runs": runs}, indent=2) + "\n"


def junit(findings: Findings) -> str:
    """Returns JUnit's XML: a suite for each FMU, a test for each rule, which an error alone fails."""
    root = ElementTree.Element("testsuites", name="l1-depth check")
    for path, results in findings.items():
        outcomes = Counter(result.outcome for result in results)
        skipped = outcomes["not applicable"] + outcomes["not judged"]
        counts = {"tests": len(results), "failures": outcomes["error"], "skipped": skipped, "errors": 0}
        numbers = {name: str(number) for name, number in counts.items()}
        suite = ElementTree.SubElement(root, "testsuite", {"name": str(path), **numbers})
        for result in results:
            case = ElementTree.SubElement(suite, "testcase", name=result.rule.name, classname=path.name)
            content = "\n".join(result.messages)
            if result.outcome == "error":
                ElementTree.SubElement(case, "failure", message=result.messages[0]).text = content
            elif content:
                ElementTree.SubElement(case, "system-out").text = f"{result.outcome}: {content}"
            elif reason := _reason(result):
                ElementTree.SubElement(case, "skipped", message=reason)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def github(findings: Findings) -> str:
    """Returns workflow commands of GitHub: each message is an annotation of its FMU."""
    commands = [
        f"::{_GITHUB_COMMANDS[result.rule.level]} file={_property(str(path))},title={result.rule.name}"
        f"::{_data(message)}\n"
        for path, results in findings.items()
        for result in results
        for message in result.messages
    ]
    return "".join(commands) + total(findings) + "\n"


def _data(content: str) -> str:
    return content.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(content: str) -> str:
    return _data(content).replace(":", "%3A").replace(",", "%2C")


FORMATS: Mapping[str, Callable[[Findings], str]] = {
    "text": text, "json": json_text, "sarif": sarif, "junit": junit, "github": github,
}  # fmt: skip


def explain(name: str, rules: Sequence[Rule]) -> str:
    """Returns what a rule claims, how severe it is, and the sentences of the standard that it checks.

    Raises ValueError for a name that no rule has.
    """
    chosen = next((rule for rule in rules if rule.name == name), None)
    if chosen is None:
        near = difflib.get_close_matches(name, [rule.name for rule in rules], 3, 0.4)
        hint = f"; the nearest: {', '.join(near)}" if near else ""
        raise ValueError(f"no rule {name!r}: expected the name of one{hint}")
    checked = [f"  {sentence.clause}: {sentence.text}" for sentence in sentences_of(name)]
    body = ["sentences of FMI 2.0.5 that it checks:", *checked] if checked else [f"clause: {chosen.clause}"]
    needs = [f"not judged if broken: {', '.join(chosen.needs)}"] if chosen.needs else []
    head = f"{name}: {chosen.level}, judged by {_judged_by(chosen)}"
    return "\n".join([head, chosen.claim, *body, *needs, f"mutants: python -m tests.mutants {name}"]) + "\n"


def _judged_by(rule: Rule) -> str:
    return "calls of the FMU" if rule.stage == "behaviour" else f"the {rule.stage}, without running it"
