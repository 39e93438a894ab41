"""The process that reads libraries with LIEF: whatever it does is told, and ends."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from fmus.compliance.examine import examine
from fmus.compliance.library_reader import Reading, close_reader
from fmus.compliance.rule import Result
from fmus.errors import MissingExtraError
from fmus.platforms import host_platform, library_name
from tests.described_fmus import XML, members
from tests.mutants.slaves import write_slave

from .archives import write

NAME = "Behaviour"
HERE, ELSEWHERE = library_name(NAME, host_platform()), f"binaries/elsewhere/{NAME}.so"
IMPORT_FAILS = "raise ImportError('libstdc++.so.6: cannot open shared object file')"
CRASHES = """
class logging:
    disable = staticmethod(lambda: None)
def parse(content):
    import os, sys
    print("terminate called", file=sys.stderr, flush=True)
    os.abort()
"""
HANGS = """
class logging:
    disable = staticmethod(lambda: None)
def parse(content):
    import time
    time.sleep(1000)
"""


@pytest.fixture
def lief_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[str], Path]]:
    """Replaces LIEF by a module with a text; returns the folder to import it from."""

    def replace(text: str) -> Path:
        folder = tmp_path / "replaced"
        (folder / "lief").mkdir(parents=True)
        (folder / "lief" / "__init__.py").write_text(text)
        monkeypatch.syspath_prepend(folder)
        monkeypatch.delitem(sys.modules, "lief", raising=False)
        return folder

    close_reader()
    yield replace
    close_reader()


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """An FMU that has no library for this platform: none of its code runs."""
    content = members(write_slave(tmp_path))
    content[ELSEWHERE] = content.pop(HERE)
    return write(content, tmp_path / "elsewhere.fmu")


def readers() -> list[psutil.Process]:
    """The processes of LIEF that this one started."""
    alive = [child for child in psutil.Process().children() if child.status() != psutil.STATUS_ZOMBIE]
    return [child for child in alive if "library_reader" in " ".join(child.cmdline())]


def libraries_results(results: list[Result]) -> dict[str, Result]:
    """Those of the rules that read libraries."""
    of_libraries = {r.rule.name: r for r in results if r.rule.stage == "library" and not r.not_applicable}
    assert "library-exports" in of_libraries
    return {name: r for name, r in of_libraries.items() if name != "runs-on-this-platform"}


def check_failure(results: list[Result], message: str) -> None:
    """One rule has the finding, each other one refers to it."""
    of_libraries = libraries_results(results)
    broken = of_libraries.pop("library-format")
    assert (broken.outcome, broken.messages) == ("error", (message,))
    assert {result.not_judged for result in of_libraries.values()} == {"library-format is broken"}


@pytest.mark.parametrize(
    "command", [["-m", "fmus.compliance"], ["-c", "from orchestration.cli import main; main()", "check"]]
)
def test_a_lief_that_cannot_be_imported_ends_the_check_with_its_text(
    lief_is: Callable[[str], Path], elsewhere: Path, command: list[str]
) -> None:
    paths = os.pathsep.join([str(lief_is(IMPORT_FAILS)), *filter(None, sys.path)])
    done = subprocess.run(
        [sys.executable, *command, str(elsewhere)],
        env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=False, timeout=120,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, "")
    assert "does not start: exit status 1: ImportError: libstdc++.so.6: cannot open" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("text", "reason"),
    [(CRASHES, "SIGABRT: terminate called"), (HANGS, "no message within 0.5 s")],
    ids=["crash", "hang"],
)
def test_a_library_that_lief_crashes_or_hangs_on_is_one_error(
    lief_is: Callable[[str], Path], elsewhere: Path, text: str, reason: str
) -> None:
    lief_is(text)
    check_failure(examine(elsewhere, timeout=0.5), f"LIEF cannot read {ELSEWHERE}: {reason}")
    assert not readers()


def test_of_several_libraries_the_one_that_lief_fails_on_is_named(
    lief_is: Callable[[str], Path], elsewhere: Path, tmp_path: Path
) -> None:
    lief_is(CRASHES.replace("import os, sys", "import os, sys\n    if content == b'empty': return None"))
    content = members(elsewhere)
    first = write({XML: content[XML], f"binaries/a/{NAME}.so": b"empty"} | content, tmp_path / "two.fmu")
    check_failure(examine(first), f"LIEF cannot read {ELSEWHERE}: SIGABRT: terminate called")


def test_the_behaviour_is_judged_although_lief_cannot_read_the_library(
    lief_is: Callable[[str], Path], tmp_path: Path
) -> None:
    lief_is(CRASHES)
    results = {result.rule.name: result for result in examine(write_slave(tmp_path))}
    assert {name for name, result in results.items() if result.outcome == "error"} == {"library-format"}
    assert results["steps-and-terminates"].outcome == "passed"


def test_a_killed_process_of_lief_is_followed_by_another(elsewhere: Path) -> None:
    close_reader()
    expected = libraries_results(examine(elsewhere))
    (process,) = readers()
    process.kill()
    with pytest.raises(MissingExtraError, match="SIGKILL"):
        examine(elsewhere)
    assert libraries_results(examine(elsewhere)) == expected


def test_libraries_that_nobody_asked_for_are_not_those_of_the_next_fmu(elsewhere: Path) -> None:
    expected = libraries_results(examine(elsewhere))
    Reading([("binaries/linux64/none.so", b"no library")], timeout=30.0)
    assert libraries_results(examine(elsewhere)) == expected
