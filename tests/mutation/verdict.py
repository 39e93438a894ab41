"""What becomes of a mutant when the tests run: killed, and by which test, or survived.

A mutant is killed if a test fails, is in error or ends the process with it, twice, and passes without it
right after; or if the tests take longer than the limit. So a test that a busy machine disturbs kills no
mutant, nor does an environment in which a test fails anyway: there the measurement ends.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from pathlib import Path
from typing import Any

from tests.mutation.server import NOTE, PIPES, TIMES
from tests.shared_builds import FOREIGN_FMUS

SURVIVED, TIME_LIMIT, KILLED_BY = "survived", "time limit", "killed by "
_ATTEMPTS = 3


class BrokenEnvironmentError(Exception):
    """The tests fail without a mutant, or did not run at all."""


class CollectedTests(AbstractContextManager["CollectedTests"]):
    """The tests of a copy of the project, collected once (`server.py`); a context manager.

    files: that have tests, in the order in which they run
    """

    def __init__(self, folder: Path, tests: Sequence[str]) -> None:
        self._folder, self.files = folder, list[str]()
        self._killers: dict[Path, Counter[str]] = {}
        requests, self._requests = os.pipe()
        self._answers, answers = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider",
             "-p", "tests.mutation.server", *tests],
            cwd=folder,
            env={
                **os.environ,
                "PYTHONPATH": str(folder),
                "PYTHONDONTWRITEBYTECODE": "1",
                FOREIGN_FMUS: str(folder.parent / "foreign FMUs"),  # no mutant is in them
                PIPES: f"{requests} {answers}",
            },
            pass_fds=(requests, answers),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(requests)
        os.close(answers)
        self._reader, self._writer = os.fdopen(self._answers), os.fdopen(self._requests, "w")
        if not self._reader.readline():
            raise BrokenEnvironmentError(
                f"pytest ends with status {self._process.wait()} before the first test"
            )

    def __exit__(self, *error: object) -> None:
        with suppress(BrokenPipeError):
            self._writer.close()
        self._reader.close()
        self._process.kill()
        self._process.wait()

    def first_failure(
        self, limit: float | None = None, only: str = "", mutant: tuple[Path, str] | None = None
    ) -> str:
        """The first test that fails; "" if none.

        limit: s that the tests may take; TimeoutError afterwards
        only: the test to run; mutant: path in the copy of a file, and its content
        """
        first = [test for test, _ in self._killers.get(mutant[0], Counter()).most_common()] if mutant else []
        is_python = mutant and mutant[0].suffix == ".py"
        request: dict[str, Any] = {
            "only": only,
            "first": first,
            "files": self.files,
            "mutant": (str(self._folder / mutant[0]), mutant[1]) if mutant and is_python else None,
        }
        folder = Path(tempfile.mkdtemp(prefix="mutant-"))
        try:
            status = self._status({**request, "folder": str(folder)}, limit)
            if not status:
                if not self.files:
                    times = json.loads((folder / TIMES).read_text())
                    self.files = sorted(times, key=times.__getitem__)
                return ""
            return (folder / NOTE).read_text()
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def note_kill(self, path: Path, test: str) -> None:
        """Remember which test noticed a mutant of a file: it runs first for the next."""
        self._killers.setdefault(path, Counter())[test] += 1

    def _status(self, request: dict[str, Any], limit: float | None) -> int:
        print(json.dumps(request), file=self._writer, flush=True)
        pid, is_late = int(self._reader.readline()), threading.Event()

        def end() -> None:
            is_late.set()
            os.killpg(pid, signal.SIGKILL)

        timer = threading.Timer(limit or threading.TIMEOUT_MAX, end)
        timer.start()
        try:
            status = int(self._reader.readline())
        finally:
            timer.cancel()
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(pid, signal.SIGKILL)  # what the tests left behind
        if is_late.is_set():
            raise TimeoutError
        return status


def verdict(folder: Path, path: Path, mutated: str, tests: CollectedTests, limit: float) -> str:
    """SURVIVED, TIME_LIMIT, or KILLED_BY and the test.

    path: of the file in the copy of the project, which has the mutated content until this returns
    Raises BrokenEnvironmentError if the test that fails does so without the mutant too.
    """
    content = (folder / path).read_text()
    (folder / path).write_text(mutated)
    try:
        test = _failing_twice(tests, (path, mutated), limit)
    except TimeoutError:
        return TIME_LIMIT
    finally:
        (folder / path).write_text(content)
    if not test:
        return SURVIVED
    try:
        is_broken = tests.first_failure(limit, test)
    except TimeoutError:
        is_broken = test
    if is_broken:
        raise BrokenEnvironmentError(f"{test} fails without a mutant")
    tests.note_kill(path, test)
    return KILLED_BY + test


def _failing_twice(tests: CollectedTests, mutant: tuple[Path, str], limit: float) -> str:
    """The first test that fails, and again alone; "" if none."""
    test = ""
    for _ in range(_ATTEMPTS):
        test = tests.first_failure(limit, mutant=mutant)
        if not test or tests.first_failure(limit, test, mutant):
            return test
    raise BrokenEnvironmentError(f"{test} fails now and then")
