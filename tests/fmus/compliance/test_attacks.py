"""An FMU that attacks the check does not change its verdict, and leaves nothing behind.

What no process can prevent that runs foreign code as the same user: docs/reference/compliance.md.
"""

import json
import os
import subprocess
import sys
import time
import zipfile
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from fmus.compliance.check import main
from fmus.compliance.examine import examine
from fmus.compliance.fmu_file import FmuFile
from fmus.compliance.rule import messages_of
from fmus.errors import HostError
from tests.described_fmus import XML, members
from tests.mutants.mutant import broken_rules as static_rules
from tests.mutants.slaves import write_slave
from tests.shared_builds import Fmus

from .archives import GLOBALS, STEP, broken_rules, patched, write

NAME = "DepthReference"
HEADERS = "#include <fcntl.h>\n#include <stdio.h>\n#include <stdlib.h>\n#include <unistd.h>\n"
REFUSE = 'return refuse(instance, fmi2Error, "limited");'


def attacker(code: str, folder: Path) -> Path:
    """An FMU that does this in every step."""
    return patched({GLOBALS: HEADERS + GLOBALS, STEP: f"{STEP}\n    {code}"}, folder)


def test_python_modules_inside_an_fmu_are_not_imported(tmp_path: Path) -> None:
    """Whatever the check, or what it uses, imports while it runs: also where the search path is relative."""
    marker = tmp_path / "imported"
    code = f"open({str(marker)!r}, 'a').write(__file__)\n".encode()
    names = {*sys.stdlib_module_names, "numpy", "fmpy", "elftools", "lxml", "sitecustomize", "usercustomize"}
    modules = {f"{folder}{name}.py": code for folder in ("", "resources/") for name in names}
    path = write(members(write_slave(tmp_path)) | modules, tmp_path / "modules.fmu")
    command = f"from fmus.compliance.check import main; exit(main([{str(path)!r}, '--format', 'json']))"
    done = subprocess.run([sys.executable, "-c", command], capture_output=True, check=False, timeout=120)
    assert not marker.exists()
    verdict = json.loads(done.stdout)
    assert (verdict["counts"]["error"], done.returncode) == (0, 0)
    assert verdict["counts"]["deviation"] > 0  # of archive-layout


@pytest.mark.slow
def test_answers_that_an_fmu_writes_itself_are_findings_and_what_it_prints_is_dropped(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    answer = r"\x09\0\0\0\0\0\0\0\x63\0\0\0\0\0\0\0[[],null]"  # to request 99
    code = (
        f'static const char forged[] = "{answer}";\n'
        '    puts("0 error"), fflush(stdout);\n'
        "    for (int d = 3; d < 64; d++)\n"
        "        if (write(d, forged, sizeof forged - 1) < 0) continue;"
    )
    verdict = tmp_path / "verdict.json"
    options = ["--only", "steps-and-terminates", "--format", "json", "--out", str(verdict)]
    assert main([str(attacker(code, tmp_path)), *options]) == 1
    assert "0 error" not in capfd.readouterr().out
    (fmu,) = json.loads(verdict.read_text(encoding="utf-8"))["fmus"]
    ((message,),) = [rule["messages"] for rule in fmu["rules"] if rule["rule"] == "steps-and-terminates"]
    is_ended = message.startswith("the FMU ended the process")
    assert is_ended or "an answer to request 99: expected one" in message


@pytest.mark.slow
def test_an_end_of_the_process_without_an_error_is_a_finding(tmp_path: Path) -> None:
    broken = broken_rules(attacker("exit(0);", tmp_path))
    (message,) = broken["steps-and-terminates"]
    assert message.startswith("co-simulation: the FMU ended the process with exit status 0, in fmi2DoStep(")


@pytest.mark.slow
def test_a_process_that_an_fmu_leaves_ends_with_the_check(tmp_path: Path) -> None:
    numbers = tmp_path / "numbers"
    code = (
        "static pid_t child;\n"
        "    if (child) return fmi2OK;\n"
        "    child = fork();\n"
        "    if (!child) sleep(600), _exit(0);\n"
        f'    FILE *file = fopen("{numbers}", "a");\n'
        '    fprintf(file, "%d\\n", (int)child), fclose(file);'
    )
    broken_rules(attacker(code, tmp_path))
    children = {int(line) for line in numbers.read_text().split()}
    assert children
    deadline = time.monotonic() + 10.0  # a process that is killed ends when the machine comes to it
    while any(map(_runs, children)) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not any(map(_runs, children))


def _runs(number: int) -> bool:
    with suppress(psutil.NoSuchProcess):
        return psutil.Process(number).status() != psutil.STATUS_ZOMBIE
    return False


@pytest.mark.slow
def test_a_copy_of_the_process_that_returns_as_well_is_a_finding(tmp_path: Path) -> None:
    once = "static int copied;\n    if (!copied++ && fork()) sleep(1);"  # the copy returns first
    (message,) = broken_rules(attacker(once, tmp_path), timeout=5)["steps-and-terminates"]
    assert message == (
        "co-simulation: the FMU ended the process with SIGKILL, since an FMU forked it and the child "
        "returned from the call; expected a child that calls _exit or exec"
    )


@pytest.mark.slow
def test_memory_and_the_size_of_files_are_limited(tmp_path: Path) -> None:
    memory = (
        "static void *volatile block;\n"
        f"    for (int i = 0; i < 64; i++) if (!(block = malloc(1 << 28))) {REFUSE}"
    )
    big_file = (
        f'const int file = open("{tmp_path}/big", O_CREAT | O_WRONLY, 0600);\n'
        f"    if (lseek(file, 2L << 30, SEEK_SET) > 0 && write(file, forged, 1) != 1) {REFUSE}"
    )
    step = "co-simulation: in the state 'step complete': fmi2DoStep"
    for code in (memory, f'static const char forged[] = "x";\n    {big_file}'):
        messages = broken_rules(attacker(code, tmp_path))["steps-and-terminates"]
        assert messages == (f"{step} returned error: expected ok; limited",)
    assert (tmp_path / "big").stat().st_size == 0


def test_a_message_moves_no_cursor_and_is_one_line(built: Fmus, tmp_path: Path) -> None:
    content = members(built[NAME])
    xml = content[XML].decode()
    forged = xml.replace('name="internal_step"', 'name="&#155;2K&#10;out.fmu: 72 passed"', 1)
    broken = static_rules(write(content | {XML: forged.encode()}, tmp_path / "forged.fmu"))
    text = " ".join(message for messages in broken.values() for message in messages)
    assert r"\x9b2K" in text
    assert "out.fmu: 72 passed" in text
    assert text.isprintable()


def test_findings_are_as_many_as_somebody_may_read(built: Fmus, tmp_path: Path) -> None:
    stray = {f"stray{i}": b"" for i in range(300)}
    broken = static_rules(write(members(built[NAME]) | stray, tmp_path / "stray.fmu"))
    assert len(broken["archive-layout"]) == 101
    assert broken["archive-layout"][-1] == "200 more of this kind"
    assert messages_of(map(str, range(101)))[-1] == "100"  # a number would hide one message alone


def test_a_library_outside_the_archive_is_not_loaded(built: Fmus, tmp_path: Path) -> None:
    content = members(built[NAME])
    library = next(path for path in content if path.endswith((".so", ".dll", ".dylib")))
    outside = f"../../{tmp_path.name}/outside"
    path = library.replace(NAME, outside)
    xml = content[XML].decode().replace(f'modelIdentifier="{NAME}"', f'modelIdentifier="{outside}"')
    fmu = write(content | {path: b"", XML: xml.encode()}, tmp_path / "outside.fmu")
    assert FmuFile(fmu).host_library == ""
    assert "model-identifier" in broken_rules(fmu)


@pytest.mark.parametrize(
    ("part", "count", "words"),
    [
        (b"><a", 100_000, "not well-formed"),
        pytest.param(b" ", 100_000_000, "expected at most 200 times as many", marks=pytest.mark.slow),
    ],
)
def test_an_enormous_description_is_a_finding(
    built: Fmus, tmp_path: Path, part: bytes, count: int, words: str
) -> None:
    path = write(members(built[NAME]) | {XML: b"<a" + part * count + b"/>"}, tmp_path / "enormous.fmu")
    (message,) = broken_rules(path)["description-is-readable"]
    assert words in message


@pytest.mark.slow
def test_more_members_than_any_tool_writes_are_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "many.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for i in range(100_001):
            archive.writestr(zipfile.ZipInfo(f"resources/{i}"), b"")
    assert broken_rules(path)["archive-is-zip"] == ("100001 files: expected at most 100000",)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limits of this kind")
@pytest.mark.parametrize("command", ["l1-depth check", "python -m fmus.compliance"])
def test_a_full_disk_is_an_error_of_the_host_with_its_own_status_and_no_finding(
    built: Fmus, tmp_path: Path, command: str
) -> None:
    """A limit on the size of files stands for the disk."""
    module, function, arguments = {
        "l1-depth check": ("orchestration.cli.commands", "run_command", ["check", str(built[NAME])]),
        "python -m fmus.compliance": ("fmus.compliance.check", "main", [str(built[NAME])]),
    }[command]
    code = (
        f"import resource, sys; from {module} import {function}\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        f"sys.exit({function}({arguments!r}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=120,
        env={**os.environ, "TMPDIR": str(tmp_path), "PYTHONDONTWRITEBYTECODE": "1"},  # which would be cut off
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.count("\n") == 1
    assert "expected disk space" in done.stderr
    assert not list(tmp_path.iterdir())


def test_no_folder_for_temporary_files_is_an_error_of_the_host(
    built: Fmus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "nowhere"))
    with pytest.raises(HostError, match="expected a folder for temporary files"):
        examine(built[NAME])
