"""A native FMU, also under sanitizers, in a process of its own, called through tests/c/session.h."""

import shutil
import struct
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import pytest

from fmus.native import toolchain

from .native_block import EVERYTHING
from .native_model import ERROR, OK, Null

_PROGRAMS = Path(__file__).parents[2] / "c"
_SANITIZERS = ("address", "undefined", "float-cast-overflow")
_FLAGS = (
    "-std=c99",
    "-g",
    "-O1",
    f"-fsanitize={','.join(_SANITIZERS)}",
    "-fno-sanitize-recover=all",
    "-ffp-contract=off",
)
GUID = "{a-guid-%n-of-#tests#}"
REFERENCES = {v.name: v.value_reference for v in EVERYTHING.variables}
_COUNTED = """#include <stdlib.h>
void *counted_calloc(size_t, size_t);
void counted_free(void *);
#define calloc counted_calloc
#define free counted_free
"""


class Message(NamedTuple):
    status: int
    category: str
    name: str
    text: str


class Answer(NamedTuple):
    status: int
    values: list[str]
    messages: list[Message]


def compiled(sources: dict[str, str], folder: Path, sanitized: bool = True, fmi: int = 2) -> Path:
    """The program with these sources of an FMU, under gcc's sanitizers; without gcc such a test fails."""
    file, own = f"fmi{fmi}.c", str(_PROGRAMS / f"session_fmi{fmi}.c")
    if sanitized and not shutil.which("gcc"):
        pytest.fail("gcc is not installed: .ci/run installs it")
    for name, text in sources.items():
        (folder / name).write_text(_COUNTED * (name == file) + text, encoding="utf-8")
    headers = str(toolchain.FMI_HEADERS)
    program = folder / "session"
    if not sanitized:
        toolchain.zig(["cc", *toolchain.FLAGS, "-I", headers, "-o", "session", file, own, "-lm"], folder)
        return program
    command = [
        "gcc",
        *_FLAGS,
        f"-DFMI{fmi}_OVERRIDE_FUNCTION_PREFIX",
        "-I",
        headers,
        "-o",
        str(program),
        str(folder / file),
        own,
        "-lm",
    ]
    subprocess.run(command, check=True, timeout=120)
    return program


class Session:
    """One process. A sanitizer's report ends it, and the call that led to it fails."""

    def __init__(self, program: Path) -> None:
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 closed with the process
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, text=True
        )

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def __call__(self, name: object, *arguments: object) -> Answer:
        """Send one command, see session.h."""
        assert self._process.stdin
        assert self._process.stdout
        line = " ".join((str(name), *map(_encoded, arguments)))
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            pass
        messages = []
        for reply in self._process.stdout:
            if reply.startswith("="):
                status, *values = reply[1:].split()
                return Answer(int(status), values, [_message(message) for message in messages])
            messages.append(reply)
        self._process.wait(timeout=60)
        raise AssertionError(f"ended by {line[:200]!r}: {self._said()}")

    def kill(self) -> None:
        self._process.kill()
        self._process.wait(timeout=60)

    def close(self) -> None:
        """End the process; memory that it has lost is reported by then."""
        assert self._process.stdin
        if self.is_alive:
            self._process.stdin.close()
            status = self._process.wait(timeout=60)
            assert status == 0, self._said()

    def _said(self) -> str:
        self._errors.seek(0)
        return f"exit status {self._process.returncode}: {self._errors.read()[:3000]}"


def _message(line: str) -> Message:
    head, category, name, text = line.rstrip("\n").split("\t")
    _, status, environment, is_safe = head.split()
    assert environment == "0", "the logger got another environment"
    assert is_safe == "1", f"not safe as a format: {text}"
    return Message(int(status), category, name, text)


def _encoded(argument: object) -> str:
    if isinstance(argument, Null):
        return f"!{argument.size}"
    if isinstance(argument, (list, tuple)):
        return " ".join((str(len(argument)), *map(_encoded, argument)))
    if isinstance(argument, float):
        return argument.hex()
    if isinstance(argument, str):
        return "=" + argument
    return "-" if argument is None else format(argument, "d")


def begin(session: Session, start: float = 0.0, stop: float | None = None) -> Session:
    assert session("instantiate", 0, "it", 1, GUID, "all", True).status == OK
    assert session("setup", 0, start, stop is not None, stop or 0.0).status == OK
    assert session("enter", 0).status == OK
    return session


def stepping(session: Session, start: float = 0.0, stop: float | None = None) -> Session:
    assert begin(session, start, stop)("leave", 0).status == OK
    return session


def told(answer: Answer) -> str:
    (message,) = answer.messages
    return message.text


def refused(answer: Answer, status: int = ERROR) -> str:
    """Returns the message of a call that has this status."""
    assert answer.status == status
    return told(answer)


def saved(session: Session) -> list[int]:
    """The instance's state as bytes."""
    session("get_state", 0, 5)
    size = int(session("state_size", 0, 5, "+").values[0])
    content = [int(v) for v in session("serialize", 0, 5, size, "+").values]
    session("free_state", 0, 5)
    return content


def with_checksum(content: bytes) -> bytes:
    """With the checksum that belongs to the content (FNV-1a)."""
    digest = 14695981039346656037
    for byte in content:
        digest = (digest ^ byte) * 1099511628211 % 2**64
    return content + struct.pack("<Q", digest)


def write(session: Session, **values: float) -> int:
    """Set Reals of `native_block.EVERYTHING`; the status."""
    references = [REFERENCES[name] for name in values]
    return session("set", 0, "R", references, [float(value) for value in values.values()]).status


def read(session: Session, *names: str) -> list[float]:
    answer = session("get", 0, "R", [REFERENCES[name] for name in names], "+")
    assert answer.status == OK
    return [float.fromhex(value) for value in answer.values]


def step(session: Session, t: float, h: float) -> int:
    return session("step", 0, t, h).status


def internal_steps(session: Session) -> int:
    return int(float.fromhex(session("get", 0, "I", [REFERENCES["steps"]], "+").values[0]))
