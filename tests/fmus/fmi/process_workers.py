"""Workers of test_process.py, in a module that a new process can import."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from fmus.fmi.process import Parent


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


def leave_a_child(parent: Parent) -> None:
    """Send the number of a process that would outlive this one."""
    child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    parent.send(child.pid)
    time.sleep(600)


def flood_errors(parent: Parent) -> None:
    """Send how much the folder of temporary files holds after much was written to standard error."""
    for _ in range(2000):
        os.write(2, b"x" * 65536)
    os.write(2, b"\nthe last line\n")
    parent.send(sum(path.stat().st_size for path in Path(tempfile.gettempdir()).rglob("*")))


def import_where_it_is(parent: Parent) -> None:
    """Enter the folder that is sent, import a module that nothing has imported yet, send its file."""
    os.chdir(parent.receive())
    import wave

    parent.send(wave.__file__)


class Trap:
    """What writes a file when it is unpickled."""

    def __init__(self, path: str) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str, str]]:
        return open, (self.path, "w")


def send_a_trap(parent: Parent) -> None:
    parent.send(Trap(parent.receive()))
    time.sleep(600)


def flood_messages(parent: Parent) -> None:
    while True:
        parent.send_json("x" * 1000)


def fork(parent: Parent) -> None:
    """Send each message back; at "fork" a child does so first, at "die" a child lives on."""
    while True:
        message = parent.receive()
        child = os.fork() if message in ("fork", "die") else 0
        if message == "die":
            time.sleep(0 if child else 600)
            os.kill(os.getpid(), signal.SIGKILL)
        if child:
            os.waitpid(child, 0)
        parent.send(message)


def answer_twice(parent: Parent) -> None:
    while True:
        message = parent.receive()
        parent.send(message)
        parent.send(message)
