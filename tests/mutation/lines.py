"""Which lines of a folder this process executes, and those that it starts, the first time of each."""

import os
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import FrameType
from typing import Any

FOLDER, FILE = "L1_DEPTH_MUTATION_FOLDER", "L1_DEPTH_MUTATION_LINES"
"""In the environment of the processes that tests start: what is traced, and where the lines are noted."""

Line = tuple[str, int]


def trace(folder: str, note: Callable[[Line], None]) -> None:
    """Call `note` with file and number of each line that is executed in a file of a folder from now on."""

    def executed(frame: FrameType, event: str, argument: Any) -> Any:
        note((frame.f_code.co_filename, frame.f_lineno))
        return executed

    def called(frame: FrameType, event: str, argument: Any) -> Any:
        return executed if frame.f_code.co_filename.startswith(folder) else None

    threading.settrace(called)
    sys.settrace(called)


def trace_this_process() -> None:
    """Note the lines in the file that the environment names, if it names one."""
    if FILE not in os.environ:
        return
    file, known = os.environ[FILE], set[Line]()

    def note(line: Line) -> None:
        if line not in known:
            known.add(line)
            with suppress(OSError), open(file, "a") as stream:  # noqa: PTH123 a test may close what stays open
                stream.write(f"{line[0]}:{line[1]}\n")

    trace(os.environ[FOLDER], note)


def noted(file: Path) -> set[Line]:
    """The lines that a file has, which is removed."""
    text = file.read_text() if file.exists() else ""
    file.unlink(missing_ok=True)
    parts = (line.rpartition(":") for line in text.splitlines())
    return {(name, int(number)) for name, _, number in parts if number.isdigit()}
