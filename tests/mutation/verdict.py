"""What becomes of a mutant when the tests run: killed, and by which test, or survived.

A mutant is killed if a test fails, is in error or ends the process with it, twice, and passes without it
right after; or if the tests take longer than the limit. So a test that a busy machine disturbs kills no
mutant, nor does an environment in which a test fails anyway: there the measurement ends. `pytest` loads this
file as a plugin, which notes the test that runs.
"""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from tests.shared_builds import FOREIGN_FMUS

SURVIVED, TIME_LIMIT, KILLED_BY = "survived", "time limit", "killed by "
_FAILED_FIRST = ("--failed-first",)  # the tests that noticed the mutants before
_NOT_REMEMBERED = ("-p", "no:cacheprovider")
_ATTEMPTS = 3
_note = Path("test-that-runs.txt").absolute()  # where pytest starts: tests may go to other folders


class BrokenEnvironmentError(Exception):
    """The tests fail without a mutant, or did not run at all."""


def first_failure(
    folder: Path, tests: Sequence[str], limit: float | None = None, options: Sequence[str] = _FAILED_FIRST
) -> str:
    """The first test that fails in a copy of the project, or the file that cannot be collected; "" if none.

    limit: s that the tests may take; TimeoutError afterwards
    """
    note = folder / _note.name
    note.unlink(missing_ok=True)
    process = subprocess.Popen(
        [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", __name__, *options, *tests],
        cwd=folder,
        env={
            **os.environ,
            "PYTHONPATH": str(folder),
            "PYTHONDONTWRITEBYTECODE": "1",
            FOREIGN_FMUS: str(folder.parent / "foreign FMUs"),  # no mutant is in them
        },
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        if not process.wait(limit):
            return ""
    except subprocess.TimeoutExpired:
        raise TimeoutError from None
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
    if not note.is_file():
        raise BrokenEnvironmentError(f"pytest ends with status {process.returncode} before the first test")
    return note.read_text()


def verdict(folder: Path, path: Path, mutated: str, tests: Sequence[str], limit: float) -> str:
    """SURVIVED, TIME_LIMIT, or KILLED_BY and the test.

    path: of the file in the copy of the project, which has the mutated content until this returns
    Raises BrokenEnvironmentError if the test that fails does so without the mutant too.
    """
    content = (folder / path).read_text()
    (folder / path).write_text(mutated)
    try:
        test = _failing_twice(folder, tests, limit)
    except TimeoutError:
        return TIME_LIMIT
    finally:
        (folder / path).write_text(content)
    if not test:
        return SURVIVED
    try:
        is_broken = first_failure(folder, [test], limit, _NOT_REMEMBERED)
    except TimeoutError:
        is_broken = test
    if is_broken:
        raise BrokenEnvironmentError(f"{test} fails without a mutant")
    return KILLED_BY + test


def _failing_twice(folder: Path, tests: Sequence[str], limit: float) -> str:
    """The first test that fails, and again alone; "" if none."""
    test = ""
    for _ in range(_ATTEMPTS):
        test = first_failure(folder, tests, limit)
        if not test or first_failure(folder, [test], limit, _NOT_REMEMBERED):
            return test
    raise BrokenEnvironmentError(f"{test} fails now and then")


def pytest_runtest_logstart(nodeid: str) -> None:
    """Note the test: with -x the last one that runs is the first that fails."""
    _note.write_text(nodeid)


def pytest_collectreport(report: pytest.CollectReport) -> None:
    """Note a file that cannot be collected."""
    if report.failed:
        _note.write_text(report.nodeid)
