"""What becomes of a mutant when the tests run: killed, and by which test, or survived.

A mutant is killed if a test fails, is in error or ends the process with it, twice, and passes without it
before and after all mutants; or if the tests take longer than the limit. So a test that a busy machine
disturbs kills no mutant, nor does an environment in which a test fails anyway: there the measurement ends.
"""

import json
import os
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
        self,
        limit: float | None = None,
        only: str = "",
        mutant: tuple[Path, str] | None = None,
        folder: Path | None = None,
    ) -> str:
        """The first test that fails; "" if none.

        limit: s that the tests may take; TimeoutError afterwards
        only: the test to run; mutant: path in the copy of a file, and its content
        folder: for what the tests build; by default one that is removed afterwards
        """
        if folder is None:
            with tempfile.TemporaryDirectory(prefix="mutant-", ignore_cleanup_errors=True) as name:
                return self.first_failure(limit, only, mutant, Path(name))
        first = [test for test, _ in self._killers.get(mutant[0], Counter()).most_common()] if mutant else []
        is_python = mutant and mutant[0].suffix == ".py"
        request: dict[str, Any] = {
            "folder": str(folder),
            "only": only,
            "first": first,
            "files": self.files,
            "mutant": (str(self._folder / mutant[0]), mutant[1]) if mutant and is_python else None,
        }
        if self._status(request, limit):
            if not (folder / NOTE).is_file():
                raise BrokenEnvironmentError(f"no test {only}" if only else "no tests")
            return (folder / NOTE).read_text()
        if not self.files:
            times = json.loads((folder / TIMES).read_text())
            self.files = sorted(times, key=times.__getitem__)
        return ""

    def note_kill(self, path: Path, test: str) -> None:
        """Remember which test noticed a mutant of a file: it runs first for the next."""
        self._killers.setdefault(path, Counter())[test] += 1

    def _status(self, request: dict[str, Any], limit: float | None) -> int:
        print(json.dumps(request), file=self._writer, flush=True)
        pid, is_late = self._answer(), threading.Event()

        def end() -> None:
            is_late.set()
            with suppress(ProcessLookupError):  # it has ended meanwhile
                os.killpg(pid, signal.SIGKILL)

        timer = threading.Timer(limit or threading.TIMEOUT_MAX, end)
        timer.start()
        try:
            status = self._answer()
        finally:
            timer.cancel()
        if is_late.is_set():
            raise TimeoutError
        return status

    def _answer(self) -> int:
        line = self._reader.readline()
        if not line:
            raise BrokenEnvironmentError(
                f"pytest ended with status {self._process.wait()} between two mutants"
            )
        return int(line)


def verdict(folder: Path, path: Path, mutated: str, tests: CollectedTests, limit: float) -> str:
    """SURVIVED, TIME_LIMIT, or KILLED_BY and the test, which `check_killers` has yet to try without a mutant.

    path: of the file in the copy of the project, which has the mutated content until this returns
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
    tests.note_kill(path, test)
    return KILLED_BY + test


def check_killers(verdicts: dict[str, str], room: str, tests: CollectedTests, limit: float) -> None:
    """Run each test that killed a mutant of a folder without any; of one that fails the kills are dropped.

    Raises BrokenEnvironmentError if there is one.
    """
    own = {mutant: verdict for mutant, verdict in verdicts.items() if mutant.startswith(room)}
    with tempfile.TemporaryDirectory(prefix="mutant-", ignore_cleanup_errors=True) as folder:
        for test in sorted({verdict for verdict in own.values() if verdict.startswith(KILLED_BY)}):
            name = test.removeprefix(KILLED_BY)
            if tests.first_failure(limit, name, folder=Path(folder)):
                for mutant in [mutant for mutant, verdict in own.items() if verdict == test]:
                    del verdicts[mutant]
                raise BrokenEnvironmentError(f"{name} fails without a mutant")


def _failing_twice(tests: CollectedTests, mutant: tuple[Path, str], limit: float) -> str:
    """The first test that fails, and again alone; "" if none."""
    test = ""
    for _ in range(_ATTEMPTS):
        with tempfile.TemporaryDirectory(prefix="mutant-", ignore_cleanup_errors=True) as folder:
            test = tests.first_failure(limit, mutant=mutant, folder=Path(folder))
            if not test or tests.first_failure(limit, test, mutant, Path(folder)):
                return test
    raise BrokenEnvironmentError(f"{test} fails now and then")
