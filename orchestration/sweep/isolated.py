"""Samples in a process of their own: ask for one and get an outcome, whatever its FMUs do to the process."""

import contextlib
import pickle
import subprocess
import threading
from pathlib import Path
from queue import Empty, SimpleQueue
from tempfile import TemporaryDirectory
from typing import IO, Any, cast

import cloudpickle

from fmus.process import ending, start
from orchestration.errors import SweepError
from orchestration.sweep import child
from orchestration.sweep.job import Job, Outcome, Settings

_ATTEMPTS = 2  # a process that dies once may have been killed by somebody, one that dies again by its sample
_START_S = 300.0  # to import, load and compile, on a machine that is busy


class ClosedError(SweepError):
    """Somebody else shall run the sample."""


class IsolatedSamples:
    """Runs samples one after another in a process, which is replaced when it dies or takes too long.

    job: its FMUs are unpacked; folder: for what they would leave behind when they crash, its owner removes it
    """

    def __init__(self, job: Job, folder: Path) -> None:
        self._timeout = job.timeout
        self._folder = folder
        self._job = cloudpickle.dumps(job)
        self._process: _Process | None = None
        self._lock = threading.Lock()
        self._closed = False

    def run(self, settings: Settings) -> Outcome:
        """One sample. SweepError if no process can be started, ClosedError if it was closed meanwhile."""
        reason = ""
        for _ in range(_ATTEMPTS):
            process = self._running()
            try:
                process.wait_until_ready()
                return process.ask(settings, self._timeout)
            except _DiedError as died:
                reason = str(died)
                self._replace()
            except Empty:
                self._replace()
                return Outcome({}, error=f"it took longer than the timeout of {self._timeout:g} s")
        return Outcome({}, error=f"the worker process died: {reason}")

    def close(self) -> None:
        """At once, also from another thread while a sample runs."""
        with self._lock:
            self._closed = True
        self._replace()

    def _running(self) -> "_Process":
        with self._lock:
            if self._closed:
                raise ClosedError("closed while a sample was running")
            if self._process is None:
                self._process = _Process(self._job, self._folder)
            return self._process

    def _replace(self) -> None:
        """The next sample gets another process."""
        with self._lock:
            if self._process is not None:
                self._process.end()
            self._process = None


class _DiedError(Exception):
    """The process ended without an answer; the message says how."""


class _Process:
    """One process, its temporary files in a folder that goes with it."""

    def __init__(self, job: bytes, folder: Path) -> None:
        self._temporary = TemporaryDirectory(dir=folder, prefix="run-", ignore_cleanup_errors=True)
        self._answers: SimpleQueue[Any] = SimpleQueue()
        self._ready = False
        self._errors = Path(self._temporary.name) / "stderr"
        with self._errors.open("wb") as errors:
            popen = start(child.main, Path(self._temporary.name), stdout=subprocess.PIPE, stderr=errors)
        self._popen, self._questions = popen, cast(IO[bytes], popen.stdin)
        threading.Thread(target=self._read, args=(cast(IO[bytes], popen.stdout),), daemon=True).start()
        self._send(job)

    def wait_until_ready(self) -> None:
        """Until the FMUs are loaded."""
        if self._ready:
            return
        try:
            self._answer(_START_S)
        except Empty:
            raise SweepError(f"the process that runs samples was not ready after {_START_S:g} s") from None
        except _DiedError as died:
            if self._popen.returncode > 0:  # not of a crash: Python could not do what it was told
                raise SweepError(
                    f"the process that runs samples cannot start: {self._last_words()}"
                ) from died
            raise
        self._ready = True

    def ask(self, settings: Settings, timeout: float | None) -> Outcome:
        """An outcome; _DiedError, or Empty after `timeout` seconds."""
        self._send(pickle.dumps(settings))
        return self._answer(timeout)

    def end(self) -> None:
        """Kill it and remove what it leaves."""
        self._popen.kill()
        self._popen.wait()
        with contextlib.suppress(OSError):  # of what could not be sent any more
            self._questions.close()
        self._temporary.cleanup()

    def _send(self, content: bytes) -> None:
        with contextlib.suppress(OSError):  # of a process that is dead: the answer will say so
            self._questions.write(content)
            self._questions.flush()

    def _answer(self, timeout: float | None) -> Any:
        answer = self._answers.get(timeout=timeout)
        if answer is None:
            raise _DiedError(self._death())
        return answer

    def _read(self, answers: IO[bytes]) -> None:
        """Pass answers on; None is the end."""
        with answers:
            while True:
                try:
                    self._answers.put(pickle.load(answers))
                except Exception:  # the end, or what was cut off by it
                    self._answers.put(None)
                    return

    def _death(self) -> str:
        return ending(self._popen.wait())

    def _last_words(self) -> str:
        lines = self._errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1] if lines else self._death()
