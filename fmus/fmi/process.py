"""A function of a module in another process: how it starts, exchanges messages and ends.

It is for FMUs, which may hang or crash: they can damage their own process alone. A message carries the number
of its request. If an FMU forks and the child returns from the call, the child ends before it answers in place
of the process, and the process is ended with this reason.
"""

import contextlib
import gc
import json
import os
import pickle
import signal
import struct
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from pathlib import Path
from queue import Empty, Queue
from typing import IO, Any, BinaryIO, cast

from fmus.operating_system import kill_group

# for a process whose messages have ended
_TO_END_S = 10.0
# before a message: its length, and the number of the request that it belongs to
_HEADER = struct.Struct("<QQ")
# A child that an FMU forked makes this file in the folder of the process: on the pipe it could break a
# message.
_FORKED = "forked"
CHILD_RETURNED = " and the child returned from the call; expected a child that calls _exit or exec"
# bytes that are kept of the standard error of a process
_MOST_OF_ERRORS = 1 << 16
# Bytes of a message, and waiting messages, of an untrusted process: it must not fill the memory of this one.
_MOST_OF_MESSAGE = 1 << 26
_MOST_MESSAGES = 2


class ProcessEndedError(Exception):
    """The process ended; the message names its exit status or signal, and the reason if it is known.

    status: as `subprocess.Popen.returncode`
    last_error_line: the last line on its standard error
    """

    def __init__(self, status: int, last_error_line: str, reason: str = "") -> None:
        super().__init__(ending(status) + reason)
        self.status, self.last_error_line = status, last_error_line


class Parent:
    """The process that started this one; this one ends as soon as the parent ends or closes the pipe."""

    def __init__(self, incoming: BinaryIO, outgoing: BinaryIO) -> None:
        self._outgoing, self._number = outgoing, 0
        self._pid, self._forked = os.getpid(), Path(tempfile.gettempdir(), _FORKED)
        self._messages: Queue[tuple[int, bytes]] = Queue()
        threading.Thread(target=self._read, args=(incoming,), daemon=True).start()

    def _read(self, incoming: BinaryIO) -> None:
        with contextlib.suppress(EOFError):
            while True:
                self._messages.put(_read_message(incoming))
        # also the processes that FMUs started
        kill_group(self._pid)
        os._exit(1)

    def receive(self) -> Any:
        """Returns the next message; raises the errors of unpickling."""
        self._number, content = self._messages.get()
        return pickle.loads(content)

    def send(self, message: object, pickled: Callable[[object], bytes] = pickle.dumps) -> None:
        """Sends an answer to the message received last; `pickled` turns it into bytes."""
        if os.getpid() != self._pid:
            with contextlib.suppress(OSError):
                self._forked.touch()
            os._exit(1)
        _write_message(self._outgoing, self._number, pickled(message))

    def send_json(self, message: object) -> None:
        """Sends a message to a parent that does not trust this process."""
        self.send(message, lambda content: json.dumps(content).encode())


Worker = Callable[[Parent], None]


class WorkerProcess:
    """A function of a module, called with its `Parent` in a new interpreter.

    It imports from the same folders as this process, and its output is dropped. Its temporary files go to
    `folder`, a new one inside the given folder; `close` removes it. An interrupt at the terminal does not
    reach it: the interrupted process decides. The processes that it starts end with it.

    trusted: whether its messages are pickles; messages of an untrusted process are JSON and limited
    request: number of the last request
    """

    request = 0

    def __init__(self, worker: Worker, folder: Path | None = None, trusted: bool = True) -> None:
        self._temporary = tempfile.TemporaryDirectory(
            dir=folder, prefix="l1-depth-process-", ignore_cleanup_errors=True
        )
        self.folder = Path(self._temporary.name)
        # SimpleQueue.get may wait for ever after a signal
        self._messages: Queue[tuple[int, bytes] | None] = Queue()
        self._trusted, self._errors, self._group_ended = trusted, b"", False
        self._process = _started(worker, self.folder)
        incoming, errors = cast(IO[bytes], self._process.stdout), cast(IO[bytes], self._process.stderr)
        self._outgoing = cast(IO[bytes], self._process.stdin)
        threading.Thread(target=self._read, args=(incoming,), daemon=True).start()
        self._error_reader = threading.Thread(target=self._read_errors, args=(errors,), daemon=True)
        self._error_reader.start()
        # A child that an FMU forked keeps the pipe open: its end is not the end of the process.
        threading.Thread(target=self._end_group, daemon=True).start()

    @property
    def pid(self) -> int:
        return self._process.pid

    def send(self, message: object, request: int | None = None) -> None:
        """Sends a message; to a process that has ended nothing is sent, `receive` raises.

        request: the one that the message belongs to, by default a new one
        """
        self.request += request is None
        number, content = self.request if request is None else request, pickle.dumps(message)
        # ValueError: the pipe was closed meanwhile
        with contextlib.suppress(OSError, ValueError):
            _write_message(self._outgoing, number, content)

    def receive(self, timeout: float | None = None, request: int | None = None) -> Any:
        """Returns the next answer to a request, by default the last one; answers to others are passed over.

        Raises TimeoutError after `timeout` seconds, ProcessEndedError at the end and if an FMU forked the
        process and its child went on. With an untrusted process, also ValueError for an answer to another
        request and for one that is no JSON.
        """
        expected = self.request if request is None else request
        while True:
            try:
                message = self._messages.get(timeout=timeout)
            except Empty:
                raise TimeoutError(f"no message within {timeout:g} s") from None
            if message is None or (self.folder / _FORKED).exists():
                # for the next call
                self._messages.put(None)
                raise self._ended()
            number, content = message
            if number == expected:
                return pickle.loads(content) if self._trusted else json.loads(content)
            if not self._trusted:
                raise ValueError(f"an answer to request {number}: expected one to request {expected}")

    def kill(self) -> None:
        """Ends the process and those that it started at once, also from another thread."""
        self._process.kill()
        if not self._group_ended:
            # the number of the group may be used again once the process is waited for
            self._group_ended = True
            kill_group(self._process.pid)
        self._process.wait()

    def close(self) -> None:
        """Ends the process at once, also from another thread, and removes its folder."""
        self.kill()
        # a message may be left that was not sent
        with contextlib.suppress(OSError):
            self._outgoing.close()
        self._temporary.cleanup()

    def _read(self, incoming: IO[bytes]) -> None:
        """Queues the messages; None is the end. An untrusted process that sends too much has ended."""
        most = None if self._trusted else _MOST_OF_MESSAGE
        with incoming:
            # a message may be cut off
            with contextlib.suppress(Exception):
                while self._trusted or self._messages.qsize() < _MOST_MESSAGES:
                    self._messages.put(_read_message(incoming, most))
            if not self._trusted:
                # A closed pipe would end the process in another way.
                self.kill()
        self._messages.put(None)

    def _read_errors(self, errors: IO[bytes]) -> None:
        with errors, contextlib.suppress(OSError, ValueError):
            while content := os.read(errors.fileno(), _MOST_OF_ERRORS):
                self._errors = (self._errors + content)[-_MOST_OF_ERRORS:]

    def _end_group(self) -> None:
        self._process.wait()
        self.kill()

    def _ended(self) -> ProcessEndedError:
        is_forked = (self.folder / _FORKED).exists()
        if is_forked:
            self.kill()
        reason = f", since an FMU forked it{CHILD_RETURNED}" if is_forked else ""
        return ProcessEndedError(self._exit_status(), self._last_error_line(), reason)

    def _exit_status(self) -> int:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(_TO_END_S)
        self.kill()
        return self._process.wait()

    def _last_error_line(self) -> str:
        self._error_reader.join(_TO_END_S)
        lines = self._errors.decode("utf-8", "replace").strip().splitlines()
        return lines[-1] if lines else ""


def _write_message(stream: BinaryIO | IO[bytes], number: int, content: bytes) -> None:
    stream.write(_HEADER.pack(len(content), number) + content)
    stream.flush()


def _read_message(stream: BinaryIO | IO[bytes], most: int | None = None) -> tuple[int, bytes]:
    """Returns the number of the next message and its content.

    Raises EOFError at the end of the stream, ValueError for a message of more than `most` bytes.
    """
    length, number = _HEADER.unpack(_read_bytes(stream, _HEADER.size))
    if most is not None and length > most:
        raise ValueError(f"a message of {length} bytes: expected at most {most}")
    return number, _read_bytes(stream, length)


def _read_bytes(stream: BinaryIO | IO[bytes], count: int) -> bytes:
    content = stream.read(count)
    if len(content) < count:
        raise EOFError
    return content


def _started(worker: Worker, folder: Path) -> subprocess.Popen[bytes]:
    """Starts the process."""
    # It must not import from a folder that it enters: paths are absolute, and -P adds none.
    paths = [str(Path(path).absolute()) if Path(path).is_dir() else path for path in sys.path]
    call = f"from {__name__} import serve; from {worker.__module__} import {worker.__name__} as worker"
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    return subprocess.Popen(
        [
            sys.executable,
            "-P",
            "-c",
            f"import gc, sys; gc.disable(); sys.path[:] = {paths!r}; {call}; serve(worker)",
        ],
        env={**os.environ, **temporary},
        start_new_session=True,
        # in place of a session, on Windows
        creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def serve(worker: Worker) -> None:
    """Runs a worker in this process, whose standard input and output are for messages."""
    # off for the imports: to look for garbage among what stays takes a tenth of their time
    gc.enable()
    outgoing, incoming = _private_stream(sys.stdout.fileno(), "wb"), _private_stream(sys.stdin.fileno(), "rb")
    worker(Parent(incoming, outgoing))


def _private_stream(descriptor: int, mode: str) -> BinaryIO:
    """Returns a standard stream for the caller alone: output and input of an FMU use the null device."""
    stream = os.fdopen(os.dup(descriptor), mode)
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, descriptor)
    os.close(null)
    return cast(BinaryIO, stream)


def ending(status: int) -> str:
    """Returns the return code of a process in words: "SIGSEGV", "exit status 1"."""
    if status >= 0:
        # on Windows, it may be a code of the system, such as 0xc0000005
        return f"exit status {status if status < 256 else hex(status)}"
    try:
        return signal.Signals(-status).name
    # a real-time signal has no name
    except ValueError:
        return f"signal {-status}"
