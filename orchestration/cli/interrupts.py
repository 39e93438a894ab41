"""Interrupts of a command: the first ends it with one line, a second one at once; nothing of it is left."""

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
from types import FrameType

INTERRUPTED = 130  # exit status that shells expect after Ctrl-C
_AGAIN_S = 1.0  # a signal that soon after the first is the same one, passed on by a shell for instance
_GRACE_S = 3.0  # for what the second signal interrupts to end by itself


class _Interrupt:
    """The handler of SIGINT, SIGTERM and SIGHUP: raises KeyboardInterrupt, until the command has ended."""

    def __init__(self) -> None:
        self.received = self.ended = False
        for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):  # where the platform has them
            number = getattr(signal, name, None)
            if (
                number is not None and signal.getsignal(number) is not signal.SIG_IGN
            ):  # by nohup, for instance
                signal.signal(number, self)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        of_a_run = signal.getsignal(signal.SIGINT)
        if callable(of_a_run) and of_a_run is not self:  # which is interrupted between two steps
            of_a_run(signal.SIGINT, frame)
            return
        self.received = True
        if not self.ended:
            raise KeyboardInterrupt


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """SIGINT, SIGTERM and SIGHUP end what is inside with status 130.

    Temporary files of this process and of those that it starts are in one folder, which is removed at the
    end. Worker processes end with this one, see `fmus.process`.
    """
    interrupt = _Interrupt()
    try:
        with _temporary_folder() as folder, _ended_by_a_second_signal(folder):
            try:
                yield
            finally:
                interrupt.ended = True
    except KeyboardInterrupt:
        _say_interrupted()
        raise SystemExit(INTERRUPTED) from None
    except SystemExit as end:
        if interrupt.received and end.code:
            end.code = INTERRUPTED  # what failed did so because of the interrupt
        raise


@contextlib.contextmanager
def _temporary_folder() -> Iterator[str]:
    folder = tempfile.mkdtemp(prefix="l1-depth-")
    os.environ |= dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder)
    tempfile.tempdir = folder
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _ended_by_a_second_signal(folder: str) -> Iterator[None]:
    """The process ends seconds after a second signal, also while the main thread hangs in an FMU."""
    signals, wakeup = socket.socketpair()
    wakeup.setblocking(False)
    signal.set_wakeup_fd(wakeup.fileno(), warn_on_full_buffer=False)
    threading.Thread(target=_watch, args=(signals, folder), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(-1)
        wakeup.close()


def _watch(signals: socket.socket, folder: str) -> None:
    """End the process if a second signal comes and the command does not end soon after it."""
    first = None
    while signals.recv(1):
        first = first or time.monotonic()
        if time.monotonic() > first + _AGAIN_S:
            break
    else:
        return
    signals.settimeout(_GRACE_S)
    with contextlib.suppress(TimeoutError):
        if not signals.recv(1):
            return
    shutil.rmtree(folder, ignore_errors=True)
    _say_interrupted()
    os._exit(INTERRUPTED)


def _say_interrupted() -> None:
    with contextlib.suppress(OSError):  # of a terminal that is gone
        print("l1-depth: interrupted", file=sys.stderr, flush=True)
