"""A native FMU in a process of its own, called through tests/c/session.h; also under sanitizers."""

import shutil
import struct
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, Self

import pytest

from fmus.block import Block
from fmus.fmi.variable_types import TRANSFER_TYPE
from fmus.native import toolchain

OK, WARNING, DISCARD, ERROR = 0, 1, 2, 3
CATEGORIES = {WARNING: "logStatusWarning", DISCARD: "logStatusDiscard", ERROR: "logStatusError"}
LAST_TIME, ENDED = 2, 3  # fmi2LastSuccessfulTime, fmi2Terminated
GUID = "{a-guid-%n-of-#tests#}"
FIRST_WORD = 16 + len(GUID)  # of a serialized state: magic, format and GUID come before
KEPT = 7  # place of the state that `Session.kept` saves
_SANITIZERS = "address,undefined,float-cast-overflow"
_SANITIZED = (
    *("gcc", "-std=c99", "-g", "-O1", "-ffp-contract=off"),
    *(f"-fsanitize={_SANITIZERS}", "-fno-sanitize-recover=all"),
)
_COUNTED = """#include <stdlib.h>
void *counted_calloc(size_t, size_t);
void counted_free(void *);
#define calloc counted_calloc
#define free counted_free
"""


class Null(list):
    """No items: a NULL where an array of so many is announced."""

    def __init__(self, size: int) -> None:
        super().__init__()
        self.size = size

    def __bool__(self) -> bool:
        return self.size > 0


class Message(NamedTuple):
    """What the FMU gives the importer's logger."""

    status: int
    category: str
    name: str
    text: str


class Answer(NamedTuple):
    """Status of a call, what it wrote as text, and its messages."""

    status: int
    values: list[str]
    messages: list[Message]

    @property
    def numbers(self) -> list[float]:
        """What a call that is OK wrote, as numbers."""
        assert self.status == OK, self
        return [float.fromhex(value) for value in self.values]


def compiled(sources: dict[str, str], folder: Path, sanitized: bool = True, fmi: int = 2) -> Path:
    """The program with these sources of an FMU, under gcc's sanitizers; without gcc such a test fails."""
    file, own = f"fmi{fmi}.c", str(Path(__file__).parents[2] / "c" / f"session_fmi{fmi}.c")
    for name, text in sources.items():
        (folder / name).write_text(_COUNTED * (name == file) + text, encoding="utf-8")
    arguments = ["-I", str(toolchain.FMI_HEADERS), "-o", "session", file, own, "-lm"]
    if not sanitized:
        toolchain.zig(["cc", *toolchain.FLAGS, *arguments], folder)
    elif shutil.which("gcc"):
        options = [*_SANITIZED, f"-DFMI{fmi}_OVERRIDE_FUNCTION_PREFIX"]
        subprocess.run([*options, *arguments], cwd=folder, check=True, timeout=120)
    else:
        pytest.fail("gcc is not installed: .ci/run installs it")
    return folder / "session"


class Session:
    """One process with a block's FMU. A sanitizer's report ends it, and the call that led to it fails.

    A call is `session(name, *arguments)`, see session.h: its first argument, the slot of the instance, is 0
    unless `slot` is given. Other methods go on with the instance in slot 0 and take variables by their names.
    """

    def __init__(self, program: Path, block: Block) -> None:
        self.program, self.block = program, block
        self.references = {v.name: v.value_reference for v in (*block.variables, *block.states)}
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 closed with the process
        self._process = subprocess.Popen(
            [program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self._errors, text=True
        )

    def __call__(self, name: object, *arguments: object, slot: int = 0) -> Answer:
        return self._send(name, slot, *arguments)

    # an instance

    def instantiate(self, kind: str = "all") -> Self:
        """Begins an instance for co-simulation of FMI 2.0. kind: callbacks that the importer gives."""
        assert self("instantiate", "it", 1, GUID, kind, True) == (OK, [], [])
        return self

    def begin(self, start: float = 0.0, stop: float | None = None) -> Self:
        """Leads a new instance to initialization mode."""
        self.instantiate()
        assert self("setup", start, stop is not None, stop or 0.0).status == OK
        assert self("enter").status == OK
        return self

    def stepping(self, start: float = 0.0, stop: float | None = None) -> Self:
        """Leads a new instance to step mode."""
        assert self.begin(start, stop)("leave").status == OK
        return self

    def refused(self, name: object, *arguments: object, status: int = ERROR) -> str:
        """Returns the only message of a call, which has this status and writes nothing."""
        answer = self(name, *arguments)
        assert answer.status == status, answer
        assert set(answer.values) <= {"untouched"}, answer
        (message,) = answer.messages
        assert (message.status, message.category) == (status, CATEGORIES[status])
        return message.text

    def step(self, t: float, h: float) -> int:
        """Returns the status of a step."""
        return self("step", t, h).status

    # variables

    def of(self, *names: str) -> list[int]:
        """Returns the value references of variables."""
        return [self.references[name] for name in names]

    def set(self, **values: float) -> int:
        """Returns the status of setting variables of one type."""
        (kind,) = {self._kind(name) for name in values}
        numbers = [float(value) if kind == "R" else int(value) for value in values.values()]
        return self("set", kind, self.of(*values), numbers).status

    def get(self, *names: str) -> list[float]:
        """Returns the values of variables of one type."""
        (kind,) = {self._kind(name) for name in names}
        return self("get", kind, self.of(*names), "+").numbers

    def _kind(self, name: str) -> str:
        variables = (*self.block.variables, *self.block.states)
        return TRANSFER_TYPE[variables[self.references[name]].type][0]

    # saved states

    def saved(self) -> bytes:
        """Returns the instance's state as bytes."""
        assert self("get_state", KEPT).status == OK
        size = int(self("state_size", KEPT, "+").values[0])
        content = self("serialize", KEPT, size, "+").values
        assert self("free_state", KEPT).status == OK
        return bytes(map(int, content))

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Has the instance at the end as it was at the beginning."""
        assert self("get_state", KEPT).status == OK
        yield
        assert self("set_state", KEPT).status == OK
        assert self("free_state", KEPT).status == OK

    # the process

    def live(self) -> int:
        """Returns how many blocks of memory the FMU has."""
        return int(self._send("live").values[0])

    def memory(self, is_given: bool) -> None:
        """Gives the FMU memory from now on, or none."""
        self._send("memory", is_given)

    @property
    def is_alive(self) -> bool:
        return self._process.poll() is None

    def running(self) -> "Session":
        """Returns this process, or another one if it has ended."""
        return self if self.is_alive else Session(self.program, self.block)

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

    def _send(self, *words: object) -> Answer:
        assert self._process.stdin
        assert self._process.stdout
        line = " ".join((str(words[0]), *map(_encoded, words[1:])))
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
    if isinstance(argument, (list, tuple, bytes)):
        return " ".join((str(len(argument)), *map(_encoded, argument)))
    if isinstance(argument, float):
        return argument.hex()
    if isinstance(argument, str):
        return "=" + argument
    return "-" if argument is None else format(argument, "d")


def with_checksum(content: bytes) -> bytes:
    """With the checksum that belongs to the content (FNV-1a)."""
    digest = 14695981039346656037
    for byte in content:
        digest = (digest ^ byte) * 1099511628211 % 2**64
    return content + struct.pack("<Q", digest)
