"""The process of a command: its temporary files, a cache that it can write, and interrupts.

The first interrupt ends it with one line, a second one at once; nothing of it is left.
"""

import contextlib
import os
import shutil
import signal
import socket
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import NoReturn

from fmus.fmi.parent_process import end_is_meant, share_temporary_folder

INTERRUPTED = 130  # exit status that shells expect after Ctrl-C
SAME_S = 1.0  # a signal that soon after the first is the same one, passed on by a shell for instance
GRACE_S = 3.0  # for the work that the second signal interrupts, to end without being killed


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Ends what is inside with status 130 at a SIGINT, SIGTERM or SIGHUP.

    Temporary files of this process and of those that it starts are in one folder, which is removed at the
    end. Worker processes end with this one, see `fmus.fmi.process`.
    """
    interrupt = _Interrupt()
    try:
        from fmus import files

        files.command_umask = os.umask(0o077)
        os.umask(files.command_umask)
        os.environ[files.TEMPORARY_VARIABLE] = tempfile.gettempdir()
        folder = interrupt.folder = tempfile.mkdtemp(prefix="l1-depth-")
        tempfile.tempdir = folder
        share_temporary_folder(folder)
        os.environ |= dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder)
        threading.Thread(target=_watch, args=(interrupt.signals, folder), daemon=True).start()
        with _writable_cache(folder):
            yield
    except KeyboardInterrupt:
        _say_interrupted()
        raise SystemExit(INTERRUPTED) from None
    except SystemExit as end:
        if interrupt.received and end.code:
            end.code = INTERRUPTED  # what failed did so because of the interrupt
        raise
    finally:
        interrupt.ended = True
        shutil.rmtree(interrupt.folder, ignore_errors=True)


@contextlib.contextmanager
def _writable_cache(folder: str) -> Iterator[None]:
    """Lets what is inside compile and build where nothing can be kept, and prints a line if it did so.

    folder: of the temporary files of the command
    """
    temporary = Path(folder, "cache")
    # the compiler does not ask for the home of the user's account; Path.expanduser raises without one
    home = os.environ.setdefault("HOME", os.path.expanduser("~"))  # noqa: PTH111
    own = Path(os.environ.get("XDG_CACHE_HOME") or Path(home, ".cache"))
    existing = next(path for path in (own, *own.parents) if os.access(path, os.F_OK))
    if not (own.is_absolute() and existing.is_dir() and os.access(existing, os.W_OK | os.X_OK)):
        os.environ.setdefault("ZIG_GLOBAL_CACHE_DIR", str(temporary / "zig"))
        os.environ.setdefault("MPLCONFIGDIR", str(temporary / "matplotlib"))
        # one that can only be read may hold FMUs
        if not os.access(own / "l1-depth", os.R_OK):
            os.environ["XDG_CACHE_HOME"] = str(temporary)
    yield
    if temporary.exists():
        expected = "expected HOME or XDG_CACHE_HOME to be a folder that can be written"
        print(f"l1-depth: {own} cannot be written: built files are not kept; {expected}", file=sys.stderr)


class _Interrupt:
    """The handler of SIGINT, SIGTERM and SIGHUP: raises KeyboardInterrupt, until the command has ended.

    signals: receives a byte for each, also while the main thread is in an FMU
    folder: of temporary files, removed where the process ends at once
    """

    def __init__(self) -> None:
        self.received = self.ended = False
        self.folder = ""
        self.signals, self._wakeup = socket.socketpair()
        self._wakeup.setblocking(False)
        signal.set_wakeup_fd(self._wakeup.fileno(), warn_on_full_buffer=False)
        for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):  # where the platform has them
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) is not signal.SIG_IGN:  # as by nohup
                signal.signal(number, self)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        of_a_run = signal.getsignal(signal.SIGINT)
        if callable(of_a_run) and of_a_run is not self:  # which is interrupted between two steps
            of_a_run(signal.SIGINT, frame)
            return
        self.received = True
        if self.ended:
            return
        if _is_in_an_import(frame):  # of a library in C++, perhaps, which an exception would abort
            _end_at_once(self.folder)
        raise KeyboardInterrupt


def is_interrupted() -> bool:
    """Whether a signal has interrupted this command: some libraries turn the exception into another one."""
    return any(getattr(signal.getsignal(n), "received", False) for n in signal.valid_signals())


def _watch(signals: socket.socket, folder: str) -> None:
    """Ends the process if a second signal comes and the command does not end soon after it."""
    first = None
    for _ in iter(lambda: signals.recv(1), b""):
        first = first or time.monotonic()
        if time.monotonic() > first + SAME_S:
            break
    else:
        return
    signals.settimeout(GRACE_S)
    with contextlib.suppress(TimeoutError):
        if not signals.recv(1):
            return
    _end_at_once(folder)


def _is_in_an_import(frame: FrameType | None) -> bool:
    while frame is not None and not frame.f_code.co_filename.startswith("<frozen importlib"):
        frame = frame.f_back
    return frame is not None


def _end_at_once(folder: str) -> NoReturn:
    shutil.rmtree(folder, ignore_errors=True)
    _say_interrupted()
    end_is_meant()
    os._exit(INTERRUPTED)


def _say_interrupted() -> None:
    with contextlib.suppress(OSError):  # of a terminal that is gone
        print("l1-depth: interrupted", file=sys.stderr, flush=True)
