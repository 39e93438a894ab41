"""A function of a module in another process: how it starts, exchanges messages and ends.

For FMUs, which may hang or crash: what they do to their process, they do to nothing else.
"""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from queue import Empty, Queue
from typing import IO, Any, BinaryIO, cast

_TO_END_S = 10.0  # for a process whose messages have ended


class ProcessEndedError(Exception):
    """The process ended; the message names its exit status or signal.

    status: as of `subprocess.Popen.returncode`; last_error_line: of what it wrote to standard error
    """

    def __init__(self, status: int, last_error_line: str) -> None:
        super().__init__(ending(status))
        self.status, self.last_error_line = status, last_error_line


class Parent:
    """The process that started this one; this one ends at once when that one does, or closes its end."""

    def __init__(self, incoming: BinaryIO, outgoing: BinaryIO) -> None:
        self._outgoing = outgoing
        self._messages: Queue[bytes] = Queue()
        threading.Thread(target=self._read, args=(incoming,), daemon=True).start()

    def _read(self, incoming: BinaryIO) -> None:
        with contextlib.suppress(EOFError):
            while True:
                self._messages.put(pickle.load(incoming))
        os._exit(1)

    def receive(self) -> Any:
        """The next message; raises what unpickling it raises."""
        return pickle.loads(self._messages.get())

    def send(self, message: object, pickled: Callable[[object], bytes] = pickle.dumps) -> None:
        """Send a message, which `pickled` turns into bytes."""
        pickle.dump(pickled(message), self._outgoing)
        self._outgoing.flush()


Worker = Callable[[Parent], None]


class WorkerProcess:
    """A function of a module, called with its `Parent` in a new interpreter.

    It imports from where this process does, and what it prints is dropped. Its temporary files go to
    `folder`, a new one inside the folder that is given; `close` removes it. An interrupt at the terminal does
    not reach it: the process that is interrupted decides.
    """

    def __init__(self, worker: Worker, folder: Path | None = None) -> None:
        self._temporary = tempfile.TemporaryDirectory(
            dir=folder, prefix="l1-depth-process-", ignore_cleanup_errors=True
        )
        self.folder = Path(self._temporary.name)
        self._messages: Queue[bytes | None] = Queue()  # SimpleQueue.get may wait for ever after a signal
        with self._errors.open("wb") as errors:
            self._process = _started(worker, self.folder, errors)
        incoming = cast(IO[bytes], self._process.stdout)
        self._outgoing = cast(IO[bytes], self._process.stdin)
        threading.Thread(target=self._read, args=(incoming,), daemon=True).start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def send(self, message: object) -> None:
        """Send a message; to a process that has ended nothing is sent, `receive` raises."""
        content = pickle.dumps(message)
        with contextlib.suppress(OSError, ValueError):  # ValueError: it was closed meanwhile
            pickle.dump(content, self._outgoing)
            self._outgoing.flush()

    def receive(self, timeout: float | None = None) -> Any:
        """The next message. Raises TimeoutError after `timeout` seconds, ProcessEndedError at the end."""
        try:
            message = self._messages.get(timeout=timeout)
        except Empty:
            raise TimeoutError(f"no message within {timeout:g} s") from None
        if message is None:
            self._messages.put(None)  # for whoever asks again
            raise ProcessEndedError(self._exit_status(), self._last_error_line())
        return pickle.loads(message)

    def kill(self) -> None:
        """End the process at once, also from another thread."""
        self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """End the process at once, also from another thread, and remove its folder."""
        self.kill()
        with contextlib.suppress(OSError):  # of a message that was not sent
            self._outgoing.close()
        self._temporary.cleanup()

    @property
    def _errors(self) -> Path:
        return self.folder / "stderr"

    def _read(self, incoming: IO[bytes]) -> None:
        """Queue the messages; None is the end."""
        with incoming, contextlib.suppress(Exception):  # of a message that was cut off
            while True:
                self._messages.put(pickle.load(incoming))
        self._messages.put(None)

    def _exit_status(self) -> int:
        try:
            return self._process.wait(_TO_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()

    def _last_error_line(self) -> str:
        with contextlib.suppress(OSError):
            lines = self._errors.read_text(encoding="utf-8", errors="replace").strip().splitlines()
            return lines[-1] if lines else ""
        return ""


def _started(worker: Worker, folder: Path, errors: IO[bytes]) -> subprocess.Popen[bytes]:
    paths = [str(path) for path in sys.path]
    call = f"from {__name__} import serve; from {worker.__module__} import {worker.__name__} as worker"
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    return subprocess.Popen(
        [sys.executable, "-c", f"import sys; sys.path[:] = {paths!r}; {call}; serve(worker)"],
        env={**os.environ, **temporary},
        start_new_session=True,
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),  # a session, on Windows
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
    )


def serve(worker: Worker) -> None:
    """Run a worker in this process, whose standard input and output are for messages."""
    outgoing, incoming = _private_stream(sys.stdout.fileno(), "wb"), _private_stream(sys.stdin.fileno(), "rb")
    worker(Parent(incoming, outgoing))


def _private_stream(descriptor: int, mode: str) -> BinaryIO:
    """A standard stream for the caller alone: what an FMU prints or reads goes to the null device."""
    stream = os.fdopen(os.dup(descriptor), mode)
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, descriptor)
    os.close(null)
    return cast(BinaryIO, stream)


def ending(status: int) -> str:
    """The return code of a process in words: "SIGSEGV", "exit status 1"."""
    if status >= 0:
        return f"exit status {status if status < 256 else hex(status)}"  # of Windows, where it is a code
    try:
        return signal.Signals(-status).name
    except ValueError:  # of a real-time signal
        return f"signal {-status}"
