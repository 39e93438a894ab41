"""Python in a process of its own, for FMUs that may hang or crash: how it starts, and how it ended."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import IO, BinaryIO


def start(
    function: Callable[[], None], folder: Path, stdout: int | None = None, stderr: IO[bytes] | None = None
) -> subprocess.Popen[bytes]:
    """Call a function of a module there.

    It imports from where this process does, and reads what this one writes to its standard input. Temporary
    files go to `folder`. An interrupt at the terminal is for this process alone: who is interrupted decides
    what becomes of the other.
    """
    paths = [str(path) for path in sys.path]
    call = f"from {function.__module__} import {function.__name__} as run; run()"
    temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(folder))
    group = getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0)  # what a session is elsewhere, on Windows
    return subprocess.Popen(
        [sys.executable, "-c", f"import sys; sys.path[:] = {paths!r}; {call}"],
        env={**os.environ, **temporary},
        start_new_session=True,
        creationflags=group,
        stdin=subprocess.PIPE,
        stdout=stdout,
        stderr=stderr,
    )


def ending(status: int) -> str:
    """The return code of a process in words: "SIGSEGV", "exit status 1"."""
    if status >= 0:
        return f"exit status {status if status < 256 else hex(status)}"  # of Windows, where it is a code
    try:
        return signal.Signals(-status).name
    except ValueError:  # of a real-time signal
        return f"signal {-status}"


def private_stream(descriptor: int, mode: str) -> BinaryIO:
    """A standard stream for the caller alone: what an FMU prints or reads goes elsewhere."""
    stream = os.fdopen(os.dup(descriptor), mode)
    null = os.open(os.devnull, os.O_RDWR)
    os.dup2(null, descriptor)
    os.close(null)
    return stream  # type: ignore[return-value]
