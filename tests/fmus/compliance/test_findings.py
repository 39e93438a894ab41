"""Waivers, baseline and folding are filters on one list of findings."""

import re
from dataclasses import replace
from datetime import date
from pathlib import Path

import pytest

from fmus.compliance import findings
from fmus.compliance.examine import examine
from fmus.compliance.findings import IN_BASELINE, Finding, Waiver
from fmus.compliance.rule import all_rules
from fmus.compliance.texts import without_folders
from tests.mutants.slaves import write_slave

RULES = {rule.name: rule for rule in all_rules()}
TODAY = date(2026, 11, 23)
FIRST, SECOND = "archive-layout", "included-files-exist"


def finding(
    message: str = "readme.txt: expected nothing", rule: str = FIRST, fmu: str = "a/plant.fmu"
) -> Finding:
    return Finding(Path(fmu), RULES[rule], message)


def accepted(found: list[Finding]) -> list[str]:
    return [f.accepted for f in found]


def waivers_of(folder: Path, text: str) -> list[Waiver]:
    path = folder / "waivers.toml"
    path.write_text(text, encoding="utf-8")
    return findings.read_waivers(path, RULES)


@pytest.mark.parametrize("pattern", ["plant.fmu", "pl*.fmu", "a/plant.fmu", "./a/plant.fmu", "./a/*", "*"])
def test_a_waiver_names_an_fmu_or_a_pattern_and_gives_its_reason(pattern: str) -> None:
    waiver = Waiver(FIRST, pattern, "the tool writes it")
    others = [finding(rule=SECOND), finding()]
    assert accepted(findings.waived(others, [waiver], TODAY)) == ["", "waived: the tool writes it"]
    assert findings.useless([waiver], others, TODAY) == []


def test_a_waiver_may_name_brackets_and_the_text_as_it_is_shown() -> None:
    found = replace(finding(fmu="x[1].fmu"), maker="PythonFMU")
    waiver = Waiver(FIRST, "x[1].fmu", "r", found.text)
    assert accepted(findings.waived([found], [waiver], TODAY)) == ["waived: r"]


@pytest.mark.parametrize(
    "waiver",
    [Waiver(FIRST, "other*.fmu", "r"), Waiver(FIRST, "*", "r", "notes.txt"), Waiver(SECOND, "*", "r")],
)
def test_a_waiver_of_another_fmu_message_or_rule_matches_nothing_and_is_told(waiver: Waiver) -> None:
    assert accepted(findings.waived([finding()], [waiver], TODAY)) == [""]
    (line,) = findings.useless([waiver], [finding()], TODAY)
    assert "matches no finding: remove it" in line


def test_a_waiver_holds_on_its_last_day_and_no_longer() -> None:
    last, over = (Waiver(FIRST, "*", "r", until=day) for day in (TODAY, date(2026, 11, 22)))
    assert accepted(findings.waived([finding()], [last], TODAY)) == ["waived: r"]
    assert accepted(findings.waived([finding()], [over], TODAY)) == [""]
    assert findings.useless([last], [finding()], TODAY) == []
    (line,) = findings.useless([over], [finding()], TODAY)
    assert line.endswith("expired on 2026-11-22: its findings count again")


def test_waivers_are_read_from_tables(tmp_path: Path) -> None:
    text = f"""
[[waiver]]
rule = "{FIRST}"
fmu = "*.fmu"
message = "readme"
reason = "ours"
until = 2027-01-31
"""
    assert waivers_of(tmp_path, text) == [Waiver(FIRST, "*.fmu", "ours", "readme", date(2027, 1, 31))]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('rule = "archive-layout"\nfmu = "*"', "waiver 1: no reason: expected rule, fmu and reason"),
        ('rule = "archive-layout"\nfmu = "*"\nreason = " "', "waiver 1: no reason"),
        ('rule = "archive-layouts"\nfmu = "*"\nreason = "r"', "nearest is 'archive-layout'"),
        ('rule = "archive-layout"\nfmus = "*"\nreason = "r"', "no key 'fmus': nearest is 'fmu'"),
        ('rule = "archive-layout"\nfmu = "*"\nreason = "r"\nuntil = "2027-01-31"', "without quotes"),
        ('rule = "archive-layout"\nfmu = 1\nreason = "r"', "fmu is 1: expected a text"),
        ("rule", "expected TOML"),
    ],
)
def test_a_wrong_waiver_is_refused_with_what_was_expected(entry: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"waivers\.toml") as error:
        waivers_of(tmp_path, f"[[waiver]]\n{entry}\n")
    assert message in str(error.value)


def test_what_is_no_waiver_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"waivers: expected tables \[\[waiver\]\] alone"):
        waivers_of(tmp_path, "[[waivers]]\nrule = 'x'\n")
    with pytest.raises(ValueError, match=r"waiver: expected tables \[\[waiver\]\] alone"):
        waivers_of(tmp_path, "waiver = ['x']")
    with pytest.raises(ValueError, match="expected TOML"):
        waivers_of(tmp_path, f"waiver = {'[' * 5000}{']' * 5000}")


def baseline_of(found: list[Finding], folder: Path) -> dict[str, int]:
    path = folder / "baseline.json"
    path.write_text(findings.baseline_text(found), encoding="utf-8")
    return findings.read_baseline(path)


def test_a_baseline_holds_in_another_folder_another_order_and_with_other_numbers(tmp_path: Path) -> None:
    before = [finding("/tmp/x1/model.so needs 12 bytes at 0x7f: no"), finding("two", SECOND)]
    moved = finding("/home/y/model.so needs 7.5e3 bytes at 0x8a: no")
    after = [finding("two", SECOND, "/b/plant.fmu"), moved]
    assert findings.baseline_text(before) == findings.baseline_text(before[::-1])
    compared = findings.without_known(after, baseline_of(before, tmp_path))
    assert accepted(compared) == [IN_BASELINE, IN_BASELINE]


def test_what_a_baseline_does_not_hold_is_new(tmp_path: Path) -> None:
    known = baseline_of([finding("x[1]: no"), finding("same")], tmp_path)
    others = [
        finding("x[2]: no"),
        finding("x1: no"),
        finding("same", fmu="other.fmu"),
        finding("same", SECOND),
    ]
    assert accepted(findings.without_known(others, known)) == [""] * 4
    assert accepted(findings.without_known([finding("same")] * 2, known)) == [IN_BASELINE, ""]


def test_findings_of_a_baseline_that_are_gone_are_counted_for_the_fmus_that_were_checked(
    tmp_path: Path,
) -> None:
    known = baseline_of([finding()] * 3 + [finding(fmu="other.fmu")], tmp_path)
    left = [finding(), finding("new")]
    assert findings.no_longer_found(known, left, [Path("b/plant.fmu"), Path("more.fmu")]) == 2


def test_what_is_waived_is_not_in_the_baseline(tmp_path: Path) -> None:
    waived = findings.waived([finding()], [Waiver(FIRST, "*", "r")], TODAY)
    assert baseline_of(waived, tmp_path) == {}
    assert accepted(findings.without_known(waived, baseline_of([finding()], tmp_path))) == ["waived: r"]


@pytest.mark.parametrize(
    "text", ["[]", "{", '{"a": "3"}', '{"a": Infinity}', '{"a": 0}', '{"a": true}', "[" * 10**5]
)
def test_what_is_no_baseline_is_refused(text: str, tmp_path: Path) -> None:
    path = tmp_path / "baseline.json"
    path.write_text(text)
    with pytest.raises(ValueError, match="expected a file of --write-baseline"):
        findings.read_baseline(path)


def test_many_findings_of_one_rule_about_one_fmu_are_one_with_their_count() -> None:
    many = [finding(f"file {i}", SECOND) for i in range(70)]
    one, counted = finding("file 1"), finding("x is 3 (and 77 more like it)", FIRST, fmu="b.fmu")
    alike = finding("y is 3 (and also: y is 4)", FIRST, fmu="b.fmu")
    assert findings.folded([*many, one]) == [replace(many[0], message="file 0 (and 69 more like it)"), one]
    assert findings.folded([counted, alike]) == [replace(counted, message="x is 3 (and 79 more like it)")]


def test_one_finding_is_never_hidden_behind_a_count() -> None:
    one, other = finding("file 1", FIRST), finding("file 2 (of it)", FIRST)
    (both,) = findings.folded([one, other])
    assert both.message == "file 1 (and also: file 2 (of it))"
    assert findings.folded([both]) == [both]


LINES = {"depth": 12, "a[1,2]": 13, "my name": 14, "the": 15}


@pytest.mark.parametrize(
    ("message", "line"),
    [
        ("line 7: attribute 'depth' is not allowed", 7),
        ("depth is 1: expected 2", 12),
        ("fmi2SetReal of depth, which is calculated: expected error", 12),
        ("a[1,2]: expected a number", 13),
        ("2 variables are called 'my name': expected one", 14),
        ("in the state 'step complete' fmi2GetStatus returned error", 0),
        ("sources/line 7: no", 0),
    ],
)
def test_the_line_is_that_of_the_element_that_a_message_names(message: str, line: int) -> None:
    assert findings.line_of(message, LINES) == line


@pytest.mark.parametrize(
    ("messages", "expected"),
    [
        # of one variable the first value counts
        (["x is 3 after a step: expected 2", "x is 4 after the end: expected 2"],
         ["x is 3 after a step: expected 2 (and also: x is 4 after the end: expected 2)"]),
        (["x[1] is 3: expected 2", "x[2] is 3: expected 2", "x2 is 3: expected 2", "x3 is 3: expected 2"],
         ["x[1] is 3: expected 2", "x[2] is 3: expected 2", "x2 is 3: expected 2", "x3 is 3: expected 2"]),
        # numbers and where a run begins do not tell causes apart
        (["from bytes: a step fails", "from bytes, in a run: a step fails",
          "from bytes, after fmi2Reset late in a run: a step fails", "after a reset: a step fails"],
         ["from bytes: a step fails (and 2 more like it)", "after a reset: a step fails"]),
        (["state 1 changes at 0.3 s", "y changes at 0.3 s", "state 2 changes at 1e-3 s"],
         ["state 1 changes at 0.3 s (and also: state 2 changes at 1e-3 s)", "y changes at 0.3 s"]),
    ],
)  # fmt: skip
def test_messages_of_one_cause_are_one_with_their_count(messages: list[str], expected: list[str]) -> None:
    assert list(findings.counted(messages)) == expected


@pytest.mark.parametrize("count", ["", " (and also: x is 5)", " (and 20 more like it)"])
def test_a_finding_of_a_baseline_may_be_counted_otherwise(count: str) -> None:
    known = {findings.key_of(finding("x is 3 (and 2 more like it)")): 1}
    assert accepted(findings.without_known([finding(f"x is 4{count}")], known)) == [IN_BASELINE]


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("/tmp/fmu-check-ab12cd_3/unpacked/binaries/linux64/a.so: no f", "binaries/linux64/a.so: no f"),
        ("at file:///tmp/fmu-check-ab12cd_3/unpacked/resources", "at file:///.../resources"),
        ("at file:/tmp/fmu-check-ab12cd_3/unpacked/resources", "at file:/.../resources"),
        ("at file:///tmp/fmu-check-ab12cd_3/a%20folder/resources", "at file:///.../a%20folder/resources"),
        ("changes '/tmp/a/l1-depth-process-ab12cd_3', expected /", "changes '...', expected /"),
        (r"C:\Temp\fmu-check-ab12cd_3\unpacked\binaries\a.dll", r"binaries\a.dll"),
        ("x is /tmp/fmu-check: expected 1", "x is /tmp/fmu-check: expected 1"),
    ],
)
def test_a_message_names_no_temporary_folder(text: str, shown: str) -> None:
    assert without_folders(text) == shown


@pytest.mark.slow
@pytest.mark.parametrize("mutation", ["a changed working directory", "percent signs are not decoded"])
def test_no_finding_names_a_folder_of_the_check(mutation: str, tmp_path: Path) -> None:
    """The former names a folder as the setting, the latter in its own message."""
    names = ["process-settings-are-restored", "resource-location-is-decoded"]
    messages = [
        m for result in examine(write_slave(tmp_path, mutation), names=names) for m in result.messages
    ]
    assert messages
    assert "..." in messages[0]
    assert not re.search("fmu-check-|l1-depth-process-", " ".join(messages))
