"""What the check tells: JSON, exit status, odd paths."""

import errno
import io
import json
import os
import re
import subprocess
import sys
import time
import zipfile
from collections.abc import Collection
from pathlib import Path
from typing import Any

import pytest

from fmus.compliance.check import NO_VERDICT, NOT_JUDGED, _progress, main
from fmus.compliance.examine import examine
from fmus.compliance.probe import refusal
from fmus.compliance.rule import OUTCOMES, Result, all_rules, of_version, repeated
from fmus.compliance.script import Message
from tests.described_fmus import members
from tests.mutants.base import BASE, XML, changed, written
from tests.mutants.mutant import broken_rules
from tests.mutants.slaves import write_slave

from .archives import write

_RESULTS: dict[object, list[Result]] = {}  # by extension, members, and what is asked


@pytest.fixture(autouse=True)
def _examined_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Examines equal FMUs once: these tests differ in what the command does with the results."""

    def examined(path: Path, timeout: float, names: Collection[str] | None, seed: int) -> list[Result]:
        content = members(path) if zipfile.is_zipfile(path) else path.read_bytes()
        key = path.suffix, repr(content), timeout, None if names is None else frozenset(names)
        if key not in _RESULTS:
            _RESULTS[key] = examine(path, timeout, names, seed)
        return _RESULTS[key]

    monkeypatch.setattr("fmus.compliance.examine.examine", examined)


@pytest.fixture
def legal(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The members of an FMU that breaks no rule."""
    return members(write_slave(tmp_path_factory.mktemp("legal")))


@pytest.fixture
def deviating(legal: dict[str, bytes], tmp_path: Path) -> Path:
    """An FMU with a deviation and no error."""
    return write(legal | {"readme.txt": b""}, tmp_path / "deviating.fmu")


@pytest.fixture
def wrong(legal: dict[str, bytes], tmp_path: Path) -> Path:
    """An FMU with an error."""
    return write(legal | {"../escape": b""}, tmp_path / "wrong.fmu")


def assert_complete(document: dict[str, Any], path: Path, name: str, outcome: str) -> None:
    """The document names every rule of one FMU, and one of them has the outcome with its messages."""
    (fmu,) = document["fmus"]
    assert fmu["fmu"] == str(path)
    judged = of_version(all_rules(), 2)
    assert [rule["rule"] for rule in fmu["rules"]] == [rule.name for rule in judged]
    # of a rule of both interfaces the result names the clause of the one that the FMU has
    assert all(found["clause"] in rule.clause for found, rule in zip(fmu["rules"], judged, strict=True))
    rules_with_messages = {rule["rule"]: rule for rule in fmu["rules"] if rule["messages"]}
    assert rules_with_messages[name]["outcome"] == outcome
    assert {rule["outcome"] for rule in fmu["rules"]} <= set(OUTCOMES)
    assert all(isinstance(message, str) for rule in fmu["rules"] for message in rule["messages"])


@pytest.mark.slow
def test_json_in_a_file_names_each_rule_with_clause_outcome_and_messages(
    deviating: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "found.json"
    assert main([str(deviating), "--format", "json", "--out", str(file)]) == 0
    document = json.loads(file.read_text(encoding="utf-8"))
    assert document["counts"] == {"error": 0, "deviation": 1, "advice": 0}
    assert_complete(document, deviating, "archive-layout", "deviation")
    assert "archive-layout" in capsys.readouterr().out


def test_json_on_standard_output_is_all_that_is_there(wrong: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main([str(wrong), "--format", "json"]) == 1
    document = json.loads(capfd.readouterr().out)
    assert document["counts"]["error"] >= 1
    assert_complete(document, wrong, "archive-paths-are-portable", "error")


def test_a_file_that_is_not_there_gives_exit_status_2_and_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(tmp_path / "none.fmu")]) == 2
    assert "none.fmu" in capsys.readouterr().err


WAIVER = """
[[waiver]]
rule = "{}"
fmu = "*.fmu"
reason = "a test"
{}
"""
LATER = "until = 2999-12-31"
WAIVERS = {
    "layout": ("archive-layout", LATER),
    "expired": ("archive-layout", "until = 2020-01-31"),
    "paths": ("archive-paths-are-portable", ""),
    "exports": ("library-exports", ""),
    "unknown": ("archive-layouts", ""),
}


@pytest.fixture
def unjudged(legal: dict[str, bytes], tmp_path: Path) -> Path:
    """An FMU whose library lacks a function, so that no behaviour is judged."""
    (library,) = (name for name in legal if name.startswith("binaries/"))
    lacking = legal[library].replace(b"\0fmi2DoStep\0", b"\0fmi2NoStep\0")
    return write(legal | {library: lacking}, tmp_path / "unjudged.fmu")


@pytest.mark.parametrize(
    ("fmus", "options", "status"),
    [
        ("deviating", "", 0),
        ("deviating", "--fail-on deviation", 1),
        ("deviating", "--fail-on advice", 1),
        ("deviating", "--fail-on deviation --waivers layout.toml", 0),
        ("deviating", "--fail-on deviation --waivers expired.toml", 1),
        ("wrong", "", 1),
        ("deviating wrong", "", 1),
        ("wrong", "--waivers paths.toml", 0),
        ("wrong", "--only archive-layout", 0),
        ("wrong", "--only archive-layout,archive-paths-are-portable", 1),
        ("deviating wrong", "--fail-on deviation --waivers layout.toml", 1),
        ("deviating", "--strict", 0),
        ("unjudged", "--waivers exports.toml", 0),
        ("unjudged", "--waivers exports.toml --strict", NOT_JUDGED),
        ("unjudged wrong", "--waivers exports.toml --strict", 1),
        ("", "", 2),
        ("none", "", 2),
        ("deviating", "--only archive-layouts", 2),
        ("deviating", "--waivers none.toml", 2),
        ("deviating", "--waivers unknown.toml", 2),
        ("deviating", "--baseline none.json", 2),
        ("deviating", "--write-baseline", 2),
        ("deviating", "--timeout 0", 2),
        ("deviating", "--format yaml", 2),
        ("deviating", "--fail-on warning", 2),
        ("deviating", "--colour", 2),
        ("text", "--only refusals-are-logged", 1),
        ("text", "--only archive-extension", 0),
        ("empty", "--only refusals-are-logged", 1),
        ("unreadable", "--only refusals-are-logged", 1),
        ("unjudged", "--only refusals-are-logged", 0),
        ("deviating", "--only ,", 2),
        ("deviating", "--format json --out deviating.fmu", 2),
        ("deviating", "--format json --out .", 2),
        ("deviating", "--baseline deviating.fmu --write-baseline", 2),
        ("deviating", "--waivers layout.toml --baseline layout.toml --write-baseline", 2),
        ("deviating", "--baseline one --write-baseline --out one", 2),
        ("deviating", "--baseline known.json --out known.json", 2),
        ("deviating sub/deviating", "--baseline one --write-baseline", 2),
    ],
)
@pytest.mark.usefixtures("wrong", "unjudged")
def test_the_exit_status_tells_what_is_left(
    deviating: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fmus: str, options: str, status: int
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, waived in WAIVERS.items():
        Path(f"{name}.toml").write_text(WAIVER.format(*waived))
    Path("text.fmu").write_text("no archive")
    write({"readme.txt": b"no description"}, Path("empty.fmu"))
    write({"modelDescription.xml": b"no XML"}, Path("unreadable.fmu"))
    Path("known.json").write_text("{}")
    Path("sub").mkdir()
    Path("sub/deviating.fmu").write_bytes(deviating.read_bytes())
    files = {path: path.read_bytes() for path in tmp_path.glob("*.*")}
    assert main([*(f"{name}.fmu" for name in fmus.split()), *options.split()]) == status
    assert {path: path.read_bytes() for path in files} == files


def test_only_findings_that_the_baseline_lacks_fail(
    deviating: Path, wrong: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(tmp_path / "baseline.json")
    assert main([str(wrong), "--baseline", file, "--write-baseline"]) == 0
    assert "baseline.json: written, with 2 findings" in capsys.readouterr().err
    assert main([str(wrong), "--baseline", file, "--fail-on", "advice"]) == 0
    assert "2 accepted" in capsys.readouterr().out
    assert main([str(deviating), "--baseline", file, "--fail-on", "deviation"]) == 1


def test_a_baseline_that_holds_more_than_is_found_is_told(
    deviating: Path, wrong: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = str(tmp_path / "baseline.json")
    main([str(wrong), "--baseline", file, "--write-baseline", "--only", "archive-paths-are-portable"])
    wrong.write_bytes(deviating.read_bytes())
    assert main([str(wrong), "--baseline", file]) == 0
    assert "1 findings are no longer found: --write-baseline leaves them out" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--out", "--baseline"])
def test_a_file_that_cannot_be_written_hides_no_finding_and_what_was_there_stays(
    wrong: Path, tmp_path: Path, option: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    file = tmp_path / "there"
    file.write_text("as it was")

    def full(path: Path, _: Path) -> None:
        raise OSError(errno.ENOSPC, "no space", str(path))

    monkeypatch.setattr(Path, "replace", full)
    options = [option, str(file), *(["--write-baseline"] if option == "--baseline" else [])]
    assert main([str(wrong), "--only", "archive-paths-are-portable", *options]) == NO_VERDICT
    shown = capsys.readouterr()
    assert "archive-paths-are-portable" in shown.out
    assert "no space" in shown.err
    assert file.read_text() == "as it was"
    assert {path.name for path in tmp_path.iterdir()} == {"there", wrong.name}


def test_what_a_console_cannot_show_is_escaped(wrong: Path, tmp_path: Path) -> None:
    named = wrong.rename(tmp_path / "größe \u6df1.fmu")
    command = [sys.executable, "-m", "fmus.compliance", str(named), "--only", "archive-paths-are-portable"]
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(command, check=False, capture_output=True, text=True, env=environment)
    assert done.returncode == 1
    assert r"gr\xf6\xdfe \u6df1.fmu" in done.stdout


def test_what_was_not_judged_is_one_line(unjudged: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main([str(unjudged)])
    lines = capsys.readouterr().out.splitlines()
    (reasons,) = [line for line in lines if " not judged: " in line]
    assert re.fullmatch(r"  (\d+) not judged: library-exports is broken \(\1\)", reasons)


def test_errors_come_first_and_a_waiver_without_effect_is_told(
    wrong: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "useless.toml"
    file.write_text(WAIVER.format("schema", LATER))
    assert main([str(wrong), "--waivers", str(file)]) == 1
    shown = capsys.readouterr()
    assert re.findall(r"^  (\w+): ", shown.out, re.MULTILINE) == ["error", "deviation"]
    assert "the waiver of schema for *.fmu matches no finding" in shown.err
    assert "1 error: expected none" in shown.err


def test_all_shows_the_rules_that_hold_and_those_that_do_not_apply(
    deviating: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(deviating), "--all"]) == 0
    shown = capsys.readouterr().out
    assert [rule.name for rule in of_version(all_rules(), 2) if rule.name not in shown] == []


@pytest.mark.slow
def test_an_fmu_in_a_folder_of_any_name_breaks_no_rule(
    legal: dict[str, bytes], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = '-größe_深さ a b#c+d%20e [a](b){c} it\'s "quoted" %s %d'
    folder = tmp_path / name
    folder.mkdir()
    path = write(legal, folder / f"{name}.fmu")
    file = folder / f"{name}.json"
    assert main([str(path), "--format", "json", "--out", str(file)]) == 0
    assert json.loads(file.read_text(encoding="utf-8"))["fmus"][0]["fmu"] == str(path)
    assert " error" not in capsys.readouterr().out.removeprefix(str(path))


def test_names_and_expectations_in_messages_are_not_empty(tmp_path: Path) -> None:
    items = re.findall("<Item .*/>(?=</Enumeration>)", BASE[XML].decode())
    changes = ('name="flag"', 'name=""'), ('<Boolean start="false"/>', "<Boolean/>"), (items[0], "")
    broken = broken_rules(written(changed(*changes), tmp_path))
    assert {"variable-names-are-legal", "start-is-given"} <= set(broken)
    assert broken["start-is-given"][0].startswith("<variable 16 without a name> (output, ")
    assert [m for messages in broken.values() for m in messages if m.endswith((":", " of", "expected"))] == []
    assert repeated(["a", "a", None, None]) == {"a": 2}
    assert str(refusal([Message(3, " ", None, None)])).endswith("it logged nothing")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the environment is read on Linux")
def test_a_setting_that_was_empty_is_expected_to_stay(tmp_path: Path) -> None:
    path = write_slave(tmp_path, "a changed environment variable", slave="Oscillator")
    (result,) = examine(path, names=["process-settings-are-restored"])
    (message,) = result.messages
    assert message.endswith("changes the environment: TZ=UTC+5, expected no change")


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(("quiet", "expected"), [(False, True), (True, False)])
def test_a_check_shows_on_a_terminal_what_it_does(
    monkeypatch: pytest.MonkeyPatch, quiet: bool, expected: bool
) -> None:
    terminal = _Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    with _progress(quiet, 2) as show:
        show("check 1 of 2: [a].fmu")
        time.sleep(0.3)
    assert ("check 1 of 2: [a].fmu" in terminal.getvalue()) is expected


@pytest.mark.parametrize(("quiet", "count", "lines"), [(False, 2, 1), (True, 2, 0), (False, 1, 0)])
def test_a_check_of_several_fmus_writes_to_a_log_what_it_does(
    capsys: pytest.CaptureFixture[str], quiet: bool, count: int, lines: int
) -> None:
    with _progress(quiet, count) as show:
        show("check 1 of 2: [a].fmu")
    assert capsys.readouterr().err == "check 1 of 2: [a].fmu\n" * lines
