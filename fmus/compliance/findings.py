"""Findings of a check as one list, and its filters: waivers, a baseline, counting and folding."""

import json
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from datetime import date
from fnmatch import fnmatchcase
from pathlib import Path

from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import Level, Result, Rule, Shown, Stage
from fmus.compliance.sentences import rule_table
from fmus.errors import nearest

NOTHING_SHOWN = Shown()
IN_BASELINE = "in the baseline"
_PYTHONFMU = "pythonfmu/__init__.py"
_LINE = re.compile(r"(?:^|\()line (\d+)[:)]")  # FMPy puts it into parentheses
# the name in a message: in apostrophes, at its begin or after "of", without the punctuation that follows
_NAMED = re.compile(r"'([^']+)'|(?:^|\bof )([^\s:']+?)(?=[:,]?(?:\s|$))")
_FOLDERS = re.compile(r"(?<![\w.])(?:[A-Za-z]:)?(?:[/\\][^/\\\s:'\"]+)+[/\\]")  # of an absolute path
_NUMBER = re.compile(r"(?<![\w\[#.])[+-]?(?:0x[0-9a-f]+|\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)(?![\w\]])")
_MORE = re.compile(r" \(and (?:(\d+) more like it\)|also: (.*?)\)?$)")  # of `_with_others`
_START = re.compile(r", (?:[\w ]+ )?in a run")  # in words of `differential.starts`
_TYPES = {str: "a text", date: "a date, such as 2027-01-31 without quotes"}


def counted(messages: Iterable[str]) -> Iterator[str]:
    """Yields the first message of each cause with the other one, or with the number of others.

    Messages of one cause are about the same variable, or differ in numbers or in where their run begins.
    """
    causes: dict[str, list[str]] = {}
    for message in messages:
        cause = _NUMBER.sub("#", _START.sub("", message).split(" is ", 1)[0])
        causes.setdefault(cause, []).append(message)
    return map(_with_others, causes.values())


def _with_others(messages: Sequence[str]) -> str:
    """Returns the first message with the second one; with the number of others where they are more."""
    first, *others = messages
    if len(others) == 1:
        return f"{first} (and also: {others[0]})"
    return f"{first} (and {len(others)} more like it)" if others else first


@dataclass(frozen=True)
class Finding:
    """One message of a rule about one FMU.

    shown: calls that show it, if they are known
    line: in modelDescription.xml, 0 if it is about no element; maker: the library whose finding it is, if it
    is not the model's; accepted: why it does not count, if so
    """

    fmu: Path
    rule: Rule
    message: str
    line: int = 0
    maker: str = ""
    accepted: str = ""
    shown: Shown = NOTHING_SHOWN

    @property
    def text(self) -> str:
        """Message, with the maker where it is not of the model."""
        return f"{self.message} [of {self.maker}, not of the model]" if self.maker else self.message


def findings_of(results: Mapping[Path, Sequence[Result]]) -> list[Finding]:
    """Returns the findings about each FMU, errors first."""
    severity = list(Level)
    findings = list[Finding]()
    for path, of_fmu in results.items():
        broken = [result for result in of_fmu if result.messages]
        fmu = FmuFile(path) if broken else None
        lines = _lines(fmu) if fmu else {}
        of_maker = rule_table()["pythonfmu"] if fmu and any(n.endswith(_PYTHONFMU) for n in fmu.names) else ()
        for result in sorted(broken, key=lambda result: severity.index(result.rule.level)):
            maker = "PythonFMU" if result.rule.name in of_maker else ""
            in_archive = result.rule.stage in (Stage.FILE, Stage.LIBRARY)
            for message in result.messages:
                line = 0 if in_archive else line_of(message, lines)
                shown = result.shown.get(message, NOTHING_SHOWN)
                findings.append(Finding(path, result.rule, message, line, maker, shown=shown))
    return findings


def _lines(fmu: FmuFile) -> dict[str, int]:
    """Returns name -> line of the element that has it; a variable comes before a type or unit."""
    named = [*fmu.root.iter(), *fmu.root.iterfind("ModelVariables/*")]
    return {element.get("name"): element.sourceline for element in named if element.get("name")}


def line_of(message: str, lines: Mapping[str, int]) -> int:
    """Returns the line that a message states, or the line of the first element that it names, or 0."""
    if stated := _LINE.search(message):
        return int(stated[1])
    names = (quoted or plain for quoted, plain in _NAMED.findall(message))
    return next((lines[name] for name in names if name in lines), 0)


@dataclass(frozen=True)
class Waiver:
    """Findings that somebody accepts, with the reason.

    fmu: file name or path of an FMU, or a pattern such as "plant*.fmu"; message: a part of the message;
    until: the last day on which it holds
    """

    rule: str
    fmu: str
    reason: str
    message: str = ""
    until: date | None = None

    def waives(self, finding: Finding, today: date) -> bool:
        """Whether the finding does not count today."""
        pattern = self.fmu.removeprefix("./")
        names = finding.fmu.name, finding.fmu.as_posix()
        is_fmu = pattern in names or any(fnmatchcase(name, pattern) for name in names)
        is_rule = self.rule == finding.rule.name and self.message in finding.text
        return is_fmu and is_rule and not self.is_expired(today)

    def is_expired(self, today: date) -> bool:
        """Whether the last day is over."""
        return self.until is not None and today > self.until


def read_waivers(path: Path, rules: Iterable[str]) -> list[Waiver]:
    """Returns the waivers of a TOML file, [[waiver]] each. Raises ValueError, OSError if there is no file."""
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        # also raised for text that is not UTF-8
        raise ValueError(f"{path}: {error}: expected TOML") from None
    known, entries = list(rules), content.pop("waiver", [])
    if content or not (isinstance(entries, list) and all(isinstance(entry, dict) for entry in entries)):
        raise ValueError(f"{path}: {', '.join(content) or 'waiver'}: expected tables [[waiver]] alone")
    return [_waiver(entry, f"{path}, waiver {number}", known) for number, entry in enumerate(entries, 1)]


def _waiver(entry: Mapping[str, object], where: str, rules: Sequence[str]) -> Waiver:
    keys = {field.name: field for field in fields(Waiver)}
    for key, value in entry.items():
        if key not in keys:
            raise ValueError(f"{where}: no key {key!r}: {nearest(key, keys)}")
        kind = date if key == "until" else str
        if type(value) is not kind:
            raise ValueError(f"{where}: {key} is {value!r}: expected {_TYPES[kind]}")
    for key, field in keys.items():
        if field.default is MISSING and not str(entry.get(key, "")).strip():
            raise ValueError(f"{where}: no {key}: expected rule, fmu and reason")
    if entry["rule"] not in rules:
        raise ValueError(f"{where}: no rule {entry['rule']!r}: {nearest(str(entry['rule']), rules)}")
    return Waiver(**entry)  # type: ignore[arg-type]


def waived(findings: Sequence[Finding], waivers: Sequence[Waiver], today: date) -> list[Finding]:
    """Returns the findings, those accepted that a waiver waives."""
    reasons = (next((w.reason for w in waivers if w.waives(f, today)), "") for f in findings)
    return [
        replace(f, accepted=f"waived: {reason}") if reason else f
        for f, reason in zip(findings, reasons, strict=True)
    ]


def useless(waivers: Sequence[Waiver], findings: Sequence[Finding], today: date) -> list[str]:
    """Returns a line for each waiver that is expired, or that matches no finding."""
    told = []
    for waiver in waivers:
        of = f"the waiver of {waiver.rule} for {waiver.fmu}"
        if waiver.is_expired(today):
            told.append(f"{of} expired on {waiver.until}: its findings count again")
        elif not any(waiver.waives(finding, today) for finding in findings):
            told.append(f"{of} matches no finding: remove it, or correct its fmu or message")
    return told


def key_of(finding: Finding) -> str:
    """Returns file name, rule and message of a finding, without folders, numbers and count, which vary from
    run to run and from machine to machine.
    """
    message = _NUMBER.sub("#", _FOLDERS.sub("", _MORE.sub("", finding.message)))
    return f"{finding.fmu.name}: {finding.rule.name}: {message}"


def baseline_text(findings: Iterable[Finding]) -> str:
    """Returns the JSON of a baseline: key -> count, of the findings that are not accepted."""
    counts = Counter(key_of(finding) for finding in findings if not finding.accepted)
    return json.dumps(counts, indent=2, sort_keys=True, ensure_ascii=False) + "\n"


def read_baseline(path: Path) -> dict[str, int]:
    """Returns how often each finding of a baseline occurs. Raises ValueError, OSError if there is no file."""
    try:
        counts = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: {error}: expected a file of --write-baseline") from None
    if not isinstance(counts, dict) or any(type(count) is not int or count < 1 for count in counts.values()):
        raise ValueError(f"{path}: expected a file of --write-baseline, which counts findings")
    return counts


def without_known(findings: Iterable[Finding], baseline: Mapping[str, int]) -> list[Finding]:
    """Returns the findings, those accepted that the baseline holds, as often as it does."""
    left, compared = Counter(baseline), list[Finding]()
    for finding in findings:
        key = key_of(finding)
        is_known = not finding.accepted and left[key] > 0
        left[key] -= is_known
        compared.append(replace(finding, accepted=IN_BASELINE) if is_known else finding)
    return compared


def no_longer_found(baseline: Mapping[str, int], findings: Iterable[Finding], fmus: Iterable[Path]) -> int:
    """Returns how many findings of a baseline, about the FMUs that were checked, are no longer there."""
    gone = Counter(baseline) - Counter(map(key_of, findings))
    places = tuple(f"{fmu.name}: " for fmu in fmus)
    return sum(count for key, count in gone.items() if key.startswith(places))


def folded(findings: Iterable[Finding]) -> list[Finding]:
    """Returns the first finding of each rule about each FMU, with the other one or the number of others."""
    groups: dict[tuple[Path, str, str], list[Finding]] = {}
    for finding in findings:
        groups.setdefault((finding.fmu, finding.rule.name, finding.accepted), []).append(finding)
    return [
        replace(group[0], message=_with_others([text for one in group for text in _unfolded(one.message)]))
        for group in groups.values()
    ]


def _unfolded(message: str) -> list[str]:
    """Returns the messages that `_with_others` made one; "" for those that were counted."""
    more = _MORE.search(message)
    others = [] if more is None else [more[2]] if more[2] else [""] * int(more[1])
    return [_MORE.sub("", message), *others]
