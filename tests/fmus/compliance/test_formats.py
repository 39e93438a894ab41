"""What the check writes for programs: SARIF, JUnit, annotations of GitHub; and what it explains."""

import json
import re
import urllib.parse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import pytest

from fmus.compliance.check import main
from fmus.compliance.examine import static_results
from fmus.compliance.findings import Finding, findings_of
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.report import FORMATS, Checked, failure
from fmus.compliance.rule import OUTCOMES, Level, all_rules
from tests.described_fmus import XML, members
from tests.shared_builds import Fmus

from .archives import write

NAME = "DepthReference"


@pytest.fixture(scope="module")
def checked(built: Fmus, tmp_path_factory: pytest.TempPathFactory) -> Checked:
    """Of an FMU with an error and a warning, judged without being run."""
    content = members(built[NAME]) | {"../escape": b"", "readme.txt": b""}
    path = write(content, tmp_path_factory.mktemp("wrong") / "a, b.fmu")
    results = {path: list(static_results(FmuFile(path)))}
    return Checked(results, findings_of(results))


@pytest.fixture
def document(checked: Checked) -> Callable[[str], str]:
    return lambda name: FORMATS[name](checked)


def test_sarif_holds_each_message_with_its_rule_and_file(
    document: Callable[[str], str], checked: Checked
) -> None:
    (run,) = json.loads(document("sarif"))["runs"]
    ((path, results),) = checked.results.items()
    levels = {"error": "error", "deviation": "warning", "advice": "note"}
    broken = [r for r in results if r.messages]
    messages = {(r.rule.name, levels[r.outcome], message) for r in broken for message in r.messages}
    assert {(r["ruleId"], r["level"], r["message"]["text"]) for r in run["results"]} == messages
    assert {rule["id"] for rule in run["tool"]["driver"]["rules"]} == {name for name, *_ in messages}
    location = run["results"][0]["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]
    assert urllib.parse.unquote(location) == path.as_posix()
    assert not {*location} & {*" #ü"}


def test_a_finding_of_a_variable_has_its_line_and_its_rule_has_an_address(
    built: Fmus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = members(built[NAME])
    twice = content[XML].replace(b'name="smooth"', b'name="internal_step"')
    path = write(content | {XML: twice}, tmp_path / "twice.fmu")
    results = {path: list(static_results(FmuFile(path)))}
    monkeypatch.setattr("fmus.compliance.report.metadata", lambda _: Message())
    (run,) = json.loads(FORMATS["sarif"](Checked(results, findings_of(results))))["runs"]
    (result,) = [r for r in run["results"] if r["ruleId"] == "variable-names-are-unique"]
    line = result["locations"][0]["physicalLocation"]["region"]["startLine"]
    assert b'name="internal_step"' in twice.splitlines()[line - 1]
    (rule,) = [r for r in run["tool"]["driver"]["rules"] if r["id"] == "variable-names-are-unique"]
    assert rule["helpUri"] == "https://example.org/docs/reference/fmi2/#variable-names-are-unique"


class Message:
    """Metadata of a package whose documentation is published."""

    def get_all(self, _: str) -> list[str]:
        return ["Source, https://example.org", "Documentation, https://example.org/docs/"]


def test_findings_of_pythonfmu_are_marked_and_accepted_ones_are_suppressed(checked: Checked) -> None:
    found = checked.findings[0]
    marked = [replace(found, maker="PythonFMU"), replace(found, accepted="waived: known")]
    other = Checked(checked.results, marked)
    (run,) = json.loads(FORMATS["sarif"](other))["runs"]
    assert run["results"][0]["message"]["text"].endswith("[of PythonFMU, not of the model]")
    assert run["results"][1]["suppressions"][0]["justification"] == "waived: known"
    assert FORMATS["github"](other).count("::error") == FORMATS["text"](other).count("PythonFMU") == 1


def test_an_accepted_rule_is_skipped_in_junit_and_fails_nothing(checked: Checked) -> None:
    accepted = [replace(found, accepted="waived: known") for found in checked.findings]
    (suite,) = ElementTree.fromstring(FORMATS["junit"](Checked(checked.results, accepted)))
    assert suite.get("failures") == "0"
    (case,) = [case for case in suite if case.get("name") == accepted[0].rule.name]
    assert [(child.tag, child.get("message")) for child in case] == [("skipped", "waived: known")]


def test_junit_tells_what_is_left_where_a_part_is_accepted(checked: Checked) -> None:
    found = next(found for found in checked.findings if found.rule.level == "error")
    others = [replace(found, message="left", maker="PythonFMU"), replace(found, accepted="waived: known")]
    others += [other for other in checked.findings if other is not found]
    (suite,) = ElementTree.fromstring(FORMATS["junit"](Checked(checked.results, others[::-1])))
    (failure,) = suite.iter("failure")
    assert failure.get("message") == failure.text == others[0].text
    assert {case.get("classname") for case in suite} == {found.fmu.as_posix()}


def test_junit_is_a_test_for_each_rule_and_fails_for_errors_alone(
    document: Callable[[str], str], checked: Checked
) -> None:
    (suite,) = ElementTree.fromstring(document("junit"))
    (results,) = checked.results.values()
    assert [case.get("name") for case in suite] == [result.rule.name for result in results]
    failed = {case.get("name") for case in suite if case.find("failure") is not None}
    assert failed == {result.rule.name for result in results if result.outcome == "error"}
    assert suite.get("failures") == str(len(failed))
    skipped = {case.get("name") for case in suite if case.find("skipped") is not None}
    assert skipped == {r.rule.name for r in results if r.outcome in ("not applicable", "not judged")}


def test_annotations_of_github_name_file_and_rule_and_end_with_a_summary(
    document: Callable[[str], str], checked: Checked
) -> None:
    *commands, last = document("github").splitlines()
    for level, rule in (("error", "archive-paths-are-portable"), ("warning", "archive-layout")):
        title = f"title={rule} (2.3 FMU Distribution)::"
        assert any(c.startswith(f"::{level} file=") and title in c for c in commands)
    assert all(c.split(",title=")[0].endswith("/a%2C b.fmu") for c in commands)
    assert last.startswith("1 FMUs, 1 with errors: ")


def test_broken_rules_are_counted_and_each_that_fails_has_a_line(checked: Checked) -> None:
    """What does not fail is one line for its level; --all shows each finding."""
    (path,) = checked.results
    names = "archive-paths-are-portable", "archive-layout", "reinit-is-of-states"
    rules = [rule for rule in all_rules() if rule.name in names]
    assert [rule.level for rule in rules] == ["error", "deviation", "deviation"]
    found = [Finding(path, rule, f"{i} (and 2 more like it)") for rule in rules for i in range(5)]
    for fail_on, lines, failing in (("error", 2, "1 error"), ("deviation", 3, "1 error, 2 deviations")):
        made = replace(checked, findings=found, fail_on=Level(fail_on))
        assert failure(made) == failing
        for form in ("text", "github"):
            shown = FORMATS[form](made)
            assert len(re.findall(r"^ +(?:error|deviation): |^::(?:error|warning) ", shown, re.M)) == lines
            assert shown.count("0 (and 14 more like it)") == (1 if fail_on == "error" else 3)
    assert "--all" not in FORMATS["text"](replace(made, every=True))


def test_every_outcome_has_its_place_in_the_summary(document: Callable[[str], str]) -> None:
    first = document("text").splitlines()[0]
    named = re.findall(r"\d+ ([a-z ]+?)s?(?:,|$)", first.split("a, b.fmu: ")[1])
    assert {*named} <= {*OUTCOMES}
    assert {"passed", "error", "deviation"} <= {*named}


def test_a_format_goes_to_a_file_and_text_is_printed(
    built: Fmus, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found.xml"
    path = str(built[NAME])
    assert main([path, path, "--format", "junit", "--out", str(out), "--only", "archive-layout"]) == 0
    assert ElementTree.parse(out).getroot().tag == "testsuites"
    assert capsys.readouterr().out.startswith(path)


def test_explain_tells_claim_clause_and_sentences(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--explain", "state-restores-after-the-end"]) == 0
    shown = capsys.readouterr().out
    (rule,) = [r for r in all_rules() if r.name == "state-restores-after-the-end"]
    assert rule.claim in shown
    assert "2.1.6: If stopTimeDefined, computing past stopTime returns error." in shown


def test_an_unknown_rule_is_refused_with_the_nearest(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--explain", "variable-step-sizes"]) == 2
    assert "variable-step-size" in capsys.readouterr().err
