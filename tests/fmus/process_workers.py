"""Workers of test_process.py, in a module that a new process can import."""

import os
import signal
import sys
import tempfile
import time

from fmus.process import Parent


def answer(parent: Parent) -> None:
    """What standard input holds, the message, and where temporary files go."""
    while True:
        message = parent.receive()
        print("noise", flush=True)
        os.write(1, b"noise")
        parent.send((sys.stdin.read(), message, tempfile.gettempdir()))


def sleep(parent: Parent) -> None:
    time.sleep(600)


def die(parent: Parent) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fail(parent: Parent) -> None:
    raise ValueError("no data")
