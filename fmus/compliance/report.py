"""Report of the check: lines for people, and documents for programs."""

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote
from xml.etree import ElementTree

from fmus.compliance.findings import Finding, folded
from fmus.compliance.fmu_file import DESCRIPTION
from fmus.compliance.rule import CANNOT_LOAD, OUTCOMES, Level, Result, Rule, Stage
from fmus.compliance.sentences import levels, sentences_of
from fmus.errors import nearest

Results = Mapping[Path, Sequence[Result]]
_STANDARD = "https://github.com/modelica/fmi-standard/tree/v2.0.5/docs"
_SARIF_SCHEMA = "https://json.schemastore.org/sarif-2.1.0.json"
_SARIF_LEVELS = {Level.ERROR: "error", Level.DEVIATION: "warning", Level.ADVICE: "note"}
_GITHUB_COMMANDS = {Level.ERROR: "error", Level.DEVIATION: "warning", Level.ADVICE: "notice"}
_ACCEPTED = "accepted"  # outcome of a broken rule whose findings are all waived or in the baseline


@dataclass(frozen=True)
class Checked:
    """Results of a check and their findings, those accepted too.

    fail_on: the least level that fails; every: show each rule and each finding
    """

    results: Results
    findings: Sequence[Finding]
    fail_on: Level = Level.ERROR
    every: bool = False

    @cached_property
    def open(self) -> list[Finding]:
        """Findings that are not accepted."""
        return [finding for finding in self.findings if not finding.accepted]

    @cached_property
    def failing(self) -> list[Finding]:
        """Open findings of a level that fails."""
        return [finding for finding in self.open if self.fails(finding.rule.level)]

    def fails(self, level: Level) -> bool:
        """Whether a level is the one that fails, or above it."""
        return [*Level].index(level) <= [*Level].index(self.fail_on)

    def outcome(self, path: Path, result: Result) -> str:
        """Returns one of `OUTCOMES`, or "accepted"."""
        is_open = not result.messages or (path, result.rule.name) in self._broken
        return result.outcome if is_open else _ACCEPTED

    @cached_property
    def _broken(self) -> frozenset[tuple[Path, str]]:
        return frozenset((finding.fmu, finding.rule.name) for finding in self.open)

    def of(self, path: Path) -> list[Finding]:
        """Returns the findings about one FMU."""
        return [finding for finding in self.findings if finding.fmu == path]


def _counts(findings: Sequence[Finding]) -> dict[str, int]:
    """Returns level -> number of rules that these findings break, summed over the FMUs."""
    counts = Counter(level for *_, level in {(f.fmu, f.rule.name, f.rule.level) for f in findings})
    return {level.value: counts[level] for level in Level}


def _amounts(counts: Mapping[str, int]) -> str:
    """Returns numbers of outcomes in words, without those that are 0."""
    plural = str(Level.ERROR), str(Level.DEVIATION)
    amounts = (
        (count, f"{name}s" if name in plural and count > 1 else name) for name, count in counts.items()
    )
    return ", ".join(f"{count} {name}" for count, name in amounts if count)


def summary(checked: Checked, path: Path) -> str:
    """Returns one line: how many rules passed, and so on."""
    counts = Counter(checked.outcome(path, result) for result in checked.results[path])
    return _amounts({name: counts[name] for name in (*OUTCOMES, _ACCEPTED)})


def failure(checked: Checked) -> str:
    """Returns how many rules of the levels that fail are broken; "" without one."""
    return _amounts(_counts(checked.failing))


def total(checked: Checked) -> str:
    """Returns one line on all FMUs."""
    counts = _amounts(_counts(checked.open)) or "no finding"
    bad = len({finding.fmu for finding in checked.open if finding.rule.level is Level.ERROR})
    return f"{len(checked.results)} FMUs, {bad} with errors: {counts}"


def unloaded(results: Results) -> list[str]:
    """Returns each FMU whose library this machine cannot load, with the reason."""
    reasons = ((path, r.not_judged) for path, of_fmu in results.items() for r in of_fmu)
    return list(dict.fromkeys(f"{path}: {why}" for path, why in reasons if why.startswith(CANNOT_LOAD)))


def not_judged(results: Sequence[Result]) -> str:
    """Returns one line: how many rules were not judged and why, the most frequent reason first; or ""."""
    reasons = Counter(result.not_judged for result in results if result.not_judged)
    told = "; ".join(f"{reason} ({count})" for reason, count in reasons.most_common())
    return f"{reasons.total()} not judged: {told}" if told else ""


def lines(checked: Checked, path: Path) -> list[str]:
    """Returns a line for what was not judged, and one for each broken rule (level, rule, clause, message)."""
    results = checked.results[path]
    told = [line] if (line := not_judged(results)) else []
    if not checked.every:
        for short in in_short(checked, path):
            told += [f"{short.level}: {short.title}: {short.text}", *short.calls]
        return told
    others = [result for result in results if not result.messages]
    told += [line for finding in checked.of(path) for line in (_line(finding), *_calls(finding))]
    return told + [f"{r.outcome}: {_title(r.rule)}: {_reason(r) or r.rule.claim}" for r in others]


class InShort(NamedTuple):
    """The findings of one rule about one FMU, or of all rules of a level, in one line.

    line: in modelDescription.xml, 0 if it is about no element; calls: that show it, a line each
    """

    level: Level
    title: str
    text: str
    line: int = 0
    calls: Sequence[str] = ()


def in_short(checked: Checked, path: Path) -> Iterator[InShort]:
    """Yields a line for each broken rule, and one for all rules of a level that does not fail."""
    of_fmu = [finding for finding in folded(checked.open) if finding.fmu == path]
    for level in Level:
        of_level = [finding for finding in of_fmu if finding.rule.level is level]
        if len(of_level) > 1 and not checked.fails(level):
            names = ", ".join(finding.rule.name for finding in of_level)
            yield InShort(level, f"{len(of_level)} rules, see --all", names)
            continue
        for finding in of_level:
            yield InShort(level, _title(finding.rule), finding.text, finding.line, _calls(finding))


def _line(finding: Finding) -> str:
    accepted = f" ({finding.accepted})" if finding.accepted else ""
    return f"{finding.rule.level}: {_title(finding.rule)}: {finding.text}{accepted}"


def _calls(finding: Finding) -> list[str]:
    """Returns the calls that show a finding, or the reason why no calls are shown, indented."""
    reason = [f"(no calls: {finding.shown.reason})"] if finding.shown.reason else []
    return [f"    {line}" for line in finding.shown.calls or reason]


def _title(rule: Rule) -> str:
    return f"{rule.name} ({rule.place})"


def _reason(result: Result) -> str:
    return result.not_judged or result.not_applicable


def text(checked: Checked) -> str:
    """Returns the text that is printed for people."""
    parts = list[str]()
    for path in checked.results:
        parts += [f"{path}: {summary(checked, path)}", *(f"  {line}" for line in lines(checked, path))]
    parts += [total(checked)] if len(checked.results) > 1 else []
    return "\n".join(parts) + "\n"


def json_text(checked: Checked) -> str:
    """Returns all results and findings, for programs."""
    document = {
        "counts": _counts(checked.open),
        "fmus": [
            {
                "fmu": str(path),
                "rules": [_rule(checked, path, result) for result in results],
                "findings": [_finding(finding) for finding in checked.of(path)],
            }
            for path, results in checked.results.items()
        ],
    }
    return json.dumps(document, indent=2) + "\n"


def _rule(checked: Checked, path: Path, result: Result) -> dict[str, Any]:
    rule = result.rule
    of_rule = {"rule": rule.name, "clause": rule.place, "claim": rule.claim, "level": rule.level.value}
    names = ("messages", "not_applicable", "not_judged")
    of_result = {name: getattr(result, name) for name in names}
    return {**of_rule, "outcome": checked.outcome(path, result), **of_result}


def _finding(finding: Finding) -> dict[str, Any]:
    level, names = finding.rule.level.value, ("message", "line", "maker", "accepted")
    of_finding = {name: getattr(finding, name) for name in names}
    return {"rule": finding.rule.name, "level": level, **of_finding, "calls": [*finding.shown.calls]}


def sarif(checked: Checked) -> str:
    """Returns SARIF 2.1.0, which code scanning of GitHub and others read."""
    rules = {finding.rule.name: finding.rule for finding in checked.findings}
    places = {
        name: dict.fromkeys(f.rule.place for f in checked.findings if f.rule.name == name) for name in rules
    }
    driver = {
        "name": "l1-depth check",
        "informationUri": _STANDARD,
        "rules": [
            {
                "id": rule.name,
                "shortDescription": {"text": rule.claim},
                "help": {"text": "; ".join(map(_standard, places[rule.name]))},
                "helpUri": help_uri(rule),
                "defaultConfiguration": {"level": _SARIF_LEVELS[rule.level]},
            }
            for rule in rules.values()
        ],
    }
    runs = [{"tool": {"driver": driver}, "results": [_sarif_result(f) for f in checked.findings]}]
    return json.dumps({"$schema": _SARIF_SCHEMA, "version": "2.1.0", "runs": runs}, indent=2) + "\n"


def _standard(place: str) -> str:
    return place if place.startswith("FMI 3") else f"FMI 2.0.5, {place}"


def _sarif_result(finding: Finding) -> dict[str, Any]:
    location: dict[str, Any] = {"artifactLocation": {"uri": quote(os.fsencode(finding.fmu.as_posix()))}}
    region = {"region": {"startLine": finding.line}} if finding.line else {}
    member = {"logicalLocations": [{"name": DESCRIPTION}]} if finding.line else {}
    accepted = {"suppressions": [{"kind": "external", "justification": finding.accepted}]}
    return {
        "ruleId": finding.rule.name,
        "level": _SARIF_LEVELS[finding.rule.level],
        "message": {"text": finding.text},
        "locations": [{"physicalLocation": location | region, **member}],
        **(accepted if finding.accepted else {}),
    }


def help_uri(rule: Rule) -> str:
    """Returns the address of the rule in the published documentation, or of the text of FMI without one."""
    with suppress(PackageNotFoundError):
        for entry in metadata("l1-depth").get_all("Project-URL") or ():
            label, _, address = entry.partition(", ")
            if label.lower() == "documentation":
                return f"{address.rstrip('/')}/reference/fmi2/#{rule.name}"
    return _STANDARD


def junit(checked: Checked) -> str:
    """Returns JUnit's XML: a suite for each FMU, a test for each rule; only a level that fails fails it."""
    root = ElementTree.Element("testsuites", name="l1-depth check")
    failing = {(finding.fmu, finding.rule.name) for finding in checked.failing}
    for path, results in checked.results.items():
        cases = [_case(checked, path, result, (path, result.rule.name) in failing) for result in results]
        counts = Counter(child.tag for case in cases for child in case)
        numbers = len(cases), counts["failure"], counts["skipped"], 0
        names = ("tests", "failures", "skipped", "errors")
        attributes = {name: str(number) for name, number in zip(names, numbers, strict=True)}
        ElementTree.SubElement(root, "testsuite", {"name": str(path), **attributes}).extend(cases)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _case(checked: Checked, path: Path, result: Result, fails: bool) -> ElementTree.Element:
    case = ElementTree.Element("testcase", name=result.rule.name, classname=path.as_posix())
    of_rule = [finding for finding in checked.of(path) if finding.rule == result.rule]
    texts = [finding.text for finding in of_rule if not finding.accepted]
    content, outcome = "\n".join(texts), checked.outcome(path, result)
    if fails:
        ElementTree.SubElement(case, "failure", message=texts[0]).text = content
    elif outcome == _ACCEPTED:
        ElementTree.SubElement(case, "skipped", message=of_rule[0].accepted)
    elif content:
        ElementTree.SubElement(case, "system-out").text = f"{outcome}: {content}"
    elif reason := _reason(result):
        ElementTree.SubElement(case, "skipped", message=reason)
    return case


def github(checked: Checked) -> str:
    """Returns workflow commands of GitHub: an annotation of the FMU for each line of `in_short`."""
    commands = [_annotation(path, found) for path in checked.results for found in in_short(checked, path)]
    skipped = [
        f"::notice file={_property(str(path))},title=not judged::{_data(line)}\n"
        for path, results in checked.results.items()
        if (line := not_judged(results))
    ]
    return "".join([*commands, *skipped]) + total(checked) + "\n"


def _annotation(path: Path, found: InShort) -> str:
    line = f",line={found.line}" if found.line else ""
    place = f"file={_property(str(path))}{line},title={_property(found.title)}"
    return f"::{_GITHUB_COMMANDS[found.level]} {place}::{_data(found.text)}\n"


def _data(content: str) -> str:
    return content.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(content: str) -> str:
    return _data(content).replace(":", "%3A").replace(",", "%2C")


FORMATS: Mapping[str, Callable[[Checked], str]] = {
    "text": text, "json": json_text, "sarif": sarif, "junit": junit, "github": github,
}  # fmt: skip


def explain(name: str, rules: Sequence[Rule]) -> str:
    """Returns what a rule claims, how severe it is, and the sentences of the standard that it checks.

    Raises ValueError for a name that no rule has.
    """
    chosen = next((rule for rule in rules if rule.name == name), None)
    if chosen is None:
        raise ValueError(f"--explain: no rule {name!r}: {nearest(name, [rule.name for rule in rules])}")
    body = list[str]()
    for fmi, text in ((2, "FMI 2.0.5"), (3, "FMI 3.0.2")):
        checked = [f"  {sentence.clause}: {sentence.text}" for sentence in sentences_of(name, fmi)]
        body += [f"sentences of {text} that it checks:", *checked] if checked else []
    body = body or [f"clause: {chosen.clause}"]
    needs = [f"not judged if broken: {', '.join(chosen.needs)}"] if chosen.needs else []
    by = "calls of the FMU" if chosen.stage is Stage.BEHAVIOUR else f"the {chosen.stage}, without running it"
    head = f"{name}: {chosen.level} ({levels()[name][1]}), judged by {by}"
    return "\n".join([head, chosen.claim, *body, *needs, f"mutants: python -m tests.mutants {name}"]) + "\n"
