"""The tests of a copy of the project, collected once and run on request: the other end of `server.py`."""

import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from pathlib import Path

from tests.mutation.server import MEASURED, NOTE, PIPES
from tests.shared_builds import FOREIGN_FMUS

_LIMITS = signal.SIGPROF, signal.SIGALRM  # which end a process whose test takes too long

_PATIENCE_S = 10.0


class BrokenEnvironmentError(Exception):
    """The tests fail without a mutant, or did not run at all."""


@dataclass(frozen=True)
class Measured:
    """What the tests do without a mutant.

    seconds: of CPU time, of each test, with what it shares with others; own: without
    lines: (path in the project, line) -> the tests that execute it
    """

    seconds: dict[str, float]
    own: dict[str, float]
    lines: dict[tuple[str, int], set[str]]


class CollectedTests(AbstractContextManager["CollectedTests"]):
    """The tests of a copy of the project in `folder`, collected once; a context manager."""

    def __init__(self, folder: Path, tests: Sequence[str]) -> None:
        self.folder = folder
        self._temporary, self._built = folder.parent / "run", folder.parent / "built"
        self._machine_code: set[str] = set()
        requests, self._requests = os.pipe()
        self._answers, answers = os.pipe()
        self._process = subprocess.Popen(
            [sys.executable, "-m", "pytest", "-q", "-x", "-n", "0", "-p", "no:cacheprovider",
             "-p", "tests.mutation.server", *tests],
            cwd=folder,
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join((str(folder), str(folder / "tests" / "mutation" / "child"))),
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
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_PATIENCE_S)  # it removes its folder
        self._process.kill()
        self._process.wait()
        shutil.rmtree(self._temporary, ignore_errors=True)

    def measured(self, room: str = "") -> Measured:
        """All tests without a mutant; BrokenEnvironmentError if one fails. Later runs use the FMUs."""
        self._make_folder()
        if self._failure({}, None, str(self.folder / room)):
            raise BrokenEnvironmentError(f"{self._note()} fails without a mutant")
        seconds, owned, lines = dict[str, float](), dict[str, float](), dict[tuple[str, int], set[str]]()
        for test, (own, shared, executed) in json.loads((self._temporary / MEASURED).read_text()).items():
            seconds[test], owned[test] = own + shared, own
            for file, line in executed:
                lines.setdefault((str(Path(file).relative_to(self.folder)), line), set()).add(test)
        self._machine_code = _machine_code(self._temporary)
        shutil.rmtree(self._built, ignore_errors=True)
        shutil.move(self._temporary, self._built)
        _remove_all_but_fmus(self._built)
        return Measured(seconds, owned, lines)

    def first_failure(
        self, seconds: Mapping[str, float], mutant: tuple[Path, str] | None = None, again: bool = False
    ) -> tuple[str, bool]:
        """The first test that fails, "" if none, and whether it is one that does not end.

        seconds: of CPU time that each test takes, in the order in which they run
        mutant: path in the copy of a file, and its content; again: with what the last run has built
        """
        if not again:
            self._make_folder(mutant)
        in_python = mutant and mutant[0].suffix == ".py"
        content = (str(self.folder / mutant[0]), mutant[1]) if mutant and in_python else None
        failure = self._failure(seconds, content, "")
        return (self._note(), -failure in _LIMITS) if failure else ("", False)

    def has_the_same_machine_code(self) -> bool:
        """Whether the programs and libraries of the last run are, byte by byte, those without a mutant."""
        return bool(self._machine_code) and _machine_code(self._temporary) == self._machine_code

    def _make_folder(self, mutant: tuple[Path, str] | None = None) -> None:
        """The folder of temporary files, with the FMUs that a mutant does not change."""
        shutil.rmtree(self._temporary, ignore_errors=True)
        if self._built.exists():
            shutil.copytree(self._built, self._temporary)
            if mutant:
                _remove_fmus_of(self.folder / mutant[0], mutant[0], self._temporary)
        else:
            self._temporary.mkdir()

    def _note(self) -> str:
        note = self._temporary / NOTE
        if not note.is_file():
            raise BrokenEnvironmentError("there are no tests")
        return note.read_text()

    def _failure(self, seconds: Mapping[str, float], mutant: tuple[str, str] | None, measured: str) -> int:
        """The status of the process that ran the tests."""
        request = {"folder": str(self._temporary), "seconds": seconds, "mutant": mutant, "measured": measured}
        (self._temporary / NOTE).unlink(missing_ok=True)
        print(json.dumps(request), file=self._writer, flush=True)
        line = self._reader.readline()
        if not line:
            raise BrokenEnvironmentError(
                f"pytest ended with status {self._process.wait()} between two mutants"
            )
        return int(line)


def _machine_code(folder: Path) -> set[str]:
    """Digests of the compiled programs of the C layer and of the compiled loops."""
    files = [*folder.rglob("* programs/*/session"), *folder.rglob("libraries/*")]
    return {hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def _remove_all_but_fmus(folder: Path) -> None:
    """Leave the FMUs that are built once for all tests, and the user's cache."""
    for path in sorted(folder.rglob("*"), reverse=True):
        if path.is_dir() and not path.is_symlink():
            with suppress(OSError):  # it is not empty
                path.rmdir()
        elif not _stays(path, folder):
            path.unlink()


def _stays(path: Path, folder: Path) -> bool:
    fmu = path if path.suffix == ".fmu" else path.with_suffix("")
    in_cache = path.relative_to(folder).parts[:3] == ("home", "cache", "l1-depth")
    return in_cache or (fmu.suffix == ".fmu" and fmu.with_name(f"{fmu.name}.done").exists())


def _remove_fmus_of(source: Path, path: Path, folder: Path) -> None:
    """Remove the FMUs that may be made from a source: those whose stamp does not exclude it.

    source: in the copy; path: in the project; folder: of the FMUs and of the user's cache
    """
    if path.parts[0] == "orchestration":  # which no FMU is made from
        return
    others = set[str]()
    for stamp in folder.glob("home/**/stamps/*.json"):
        content = json.loads(stamp.read_text())
        if path.parts[0] != "fmus" and not any(
            file == str(source) for file, _ in content["modules"].values()
        ):
            others |= set(content["fmus"])
    for fmu in folder.rglob("*.fmu"):
        if fmu.name not in others and fmu.parent.name != "foreign":
            fmu.unlink()
            fmu.with_name(f"{fmu.name}.done").unlink(missing_ok=True)
