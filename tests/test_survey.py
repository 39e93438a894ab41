"""Tests of docs/explanation/survey/: the script checks listed FMUs of clones and compares findings."""

import json
import re
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from fmus.native.toolchain import compile_library
from fmus.platforms import host_platform, library_name
from tests.mutants.base import XML, written
from tests.mutants.mutant import broken_rules

sys.path.insert(0, str(Path(__file__).parent.parent / "docs" / "explanation" / "survey"))
import survey  # pyright: ignore[reportMissingImports]

sys.path.pop(0)

FOLDER = Path(str(survey.__file__)).parent
FINDING = {"repository": "r", "revision": "0" * 40, "path": "a.fmu", "tool": "T", "year": "2020"}


def test_the_list_has_many_tools_and_at_most_ten_fmus_of_each() -> None:
    fmus = list(survey.listed())
    tools = Counter(fmu["tool"] for fmu in fmus)
    assert (len(fmus), len(tools), max(tools.values())) == (155, 27, 10)
    assert len({survey.identity(fmu) for fmu in fmus}) == len(fmus)
    assert all(len(fmu["revision"]) == 40 for fmu in fmus)


def test_the_page_agrees_with_the_results_that_it_shows() -> None:
    page = FOLDER.with_suffix(".md").read_text(encoding="utf-8")
    results = json.loads((FOLDER / "results.json").read_text(encoding="utf-8"))
    assert re.findall(r"^<!-- survey: (.*) -->$", page, re.M) == list(results)
    tools, errors, deviations = (results[name][1:] for name in ("tools", "errors", "deviations"))
    assert {row[0]: int(row[3]) for row in tools} == Counter(fmu["tool"] for fmu in survey.listed())
    judged, clean = (sum(int(row[column]) for row in tools) for column in (4, 5))
    assert f"takes steps | {judged} |" in page
    assert f"| no error | {clean} |" in page
    means = [round(sum(int(row[2]) for row in rows) / len(rows)) for rows in (errors, deviations)]
    assert f"break {len(errors)} rules whose level is error, each on {means[0]} FMUs on average" in page
    assert f"and {len(deviations)} whose level is deviation, each on {means[1]}." in page


FAULTS = dict(re.findall(r"/\* (\d+): ([a-z-]+)", (FOLDER / "reproductions.c").read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    "number", ["0", *(pytest.param(number, marks=pytest.mark.slow) for number in sorted(FAULTS, key=int))]
)
def test_a_reproduction_breaks_the_rule_that_it_names_and_no_other(number: str, tmp_path: Path) -> None:
    """With 0 it breaks no rule. The survey found each of these rules broken."""
    assert [*map(int, sorted(FAULTS, key=int))] == [*range(1, 11)]
    code = (FOLDER / "reproductions.c").read_text(encoding="utf-8")
    texts = {"reproductions.c": f"#define REPRODUCTION {number}\n{code}"}
    library = compile_library("reproductions", texts, ["reproductions.c"], host_platform())
    members = {
        XML: (FOLDER / "reproductions.xml").read_bytes(),
        library_name("reproductions", host_platform()): library,
    }
    expected = {FAULTS[number]} if number in FAULTS else set[str]()
    assert broken_rules(written(members, tmp_path), is_static=False).keys() == expected
    results = (FOLDER / "results.json").read_text(encoding="utf-8")
    assert all(f'"`{rule}`"' in results for rule in expected)


def test_a_listed_fmu_is_checked_once_and_one_that_no_clone_holds_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def git(*arguments: str) -> str:
        command = ["git", "-C", str(tmp_path / "clones" / "one"), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()

    (tmp_path / "clones" / "one").mkdir(parents=True)
    (tmp_path / "clones" / "one" / "a.fmu").write_text("no archive")
    git("init", "-q")
    git("add", ".")
    git("-c", "user.name=a", "-c", "user.email=a@b", "commit", "-qm", "an FMU")
    listed = [FINDING | {"revision": git("rev-parse", "HEAD")}, FINDING]
    monkeypatch.setattr(survey, "listed", lambda: iter(listed))
    findings = tmp_path / "findings.json"
    for _ in range(2):
        survey.check(findings, [tmp_path / "clones"], None)
    checked, unchecked = sorted(map(json.loads, findings.read_text().splitlines()), key=len, reverse=True)
    assert checked["rules"]["archive-is-zip"]["outcome"] == "error"
    assert unchecked["unchecked"] == "no clone holds it"


def test_a_comparison_tells_other_messages_but_for_their_numbers(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def written(name: str, **rules: str) -> Path:
        broken = {rule: {"outcome": "error", "why": [message]} for rule, message in rules.items()}
        (tmp_path / name).write_text(json.dumps(FINDING | {"rules": broken}) + "\n")
        return tmp_path / name

    before = written("before.json", first="y is 0.25: expected 1e-3", second="a crash")
    after = written("after.json", first="y is 17: expected 2", third="a hang")
    assert survey.compare(before, after) == 2
    printed = capsys.readouterr().out
    assert [rule in printed for rule in ("first", "second", "third")] == [False, True, True]
    survey.tables(after)
    assert "| error | `third` | 1 | 1 | T 2020 (1) |" in capsys.readouterr().out


def test_findings_that_a_rule_makes_alone_agree_with_those_of_the_full_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    written({}, tmp_path)
    assert survey.agree([tmp_path]) == 0
    of_full_run = {"schema": {"outcome": "error", "why": ["no description"]}}
    monkeypatch.setattr(survey, "judged", lambda _, *options: {} if options else of_full_run)
    assert survey.agree([tmp_path]) == 1
    assert "Base.fmu schema\n  - {'outcome': 'error'" in capsys.readouterr().out
