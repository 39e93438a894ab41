"""A plugin of pytest: it collects the tests once, and runs them in a new process for each mutant.

So a mutant costs the tests that notice it, and not the imports and the collection of all. A mutant of Python
is put into the functions that are imported already: mutants are within functions. The file has it too, for
what reads the file: other processes, and what is compiled. Each run has temporary folders of its own.
"""

import gc
import json
import os
import signal
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

PIPES = "L1_DEPTH_MUTATION_PIPES"  # descriptors: requests are read from the first, answers go to the second
NOTE, TIMES = "test-that-runs.txt", "times.json"


def pytest_runtestloop(session: pytest.Session) -> bool:
    """Run tests in a new process for each line of JSON, and answer with its number and its status."""
    reading, writing = map(int, os.environ[PIPES].split())
    with os.fdopen(reading) as requests, os.fdopen(writing, "w") as answers:
        print("collected", file=answers, flush=True)
        for line in requests:
            pid = os.fork()
            if not pid:
                _run(session, **json.loads(line))
            print(pid, file=answers, flush=True)
            os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)  # what the tests left behind, while the number is theirs
            print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), file=answers, flush=True)
    return True


def _run(
    session: pytest.Session, folder: str, only: str, first: Sequence[str], files: Sequence[str], mutant: Any
) -> None:
    """Run the tests in a folder for temporary files, until one fails, and end the process.

    only: the test to run; first: those to run before the others; files: with tests, in their order
    mutant: path and content of a source in Python
    """
    status = 3
    try:
        os.setpgrp()  # and not a session: that would be scheduled apart
        signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background; tests send it
        _move(Path(folder), session.config)
        if mutant:
            _put(*mutant)
        items = [item for item in session.items if only in ("", item.nodeid)]
        order = {name: index for index, name in enumerate(files)}
        items.sort(key=lambda item: (item.nodeid not in first, order.get(_file(item), len(order))))
        times: dict[str, float] = defaultdict(float)
        for item, following in zip(items, [*items[1:], None], strict=True):
            Path(folder, NOTE).write_text(item.nodeid)
            start = time.monotonic()
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            times[_file(item)] += time.monotonic() - start
            if session.testsfailed:
                break
        Path(folder, TIMES).write_text(json.dumps(times))
        status = int(bool(session.testsfailed or not items))
    finally:
        os._exit(status)


def _file(item: pytest.Item) -> str:
    return item.nodeid.partition("::")[0]


def _move(folder: Path, config: Any) -> None:
    """Let all that is temporary, and the user's own files, be in a folder; what is there is built already."""
    before = os.environ["HOME"]
    for name, value in os.environ.items():
        if value.startswith(before):
            os.environ[name] = f"{folder}/home{value.removeprefix(before)}"
    os.environ["TMPDIR"] = str(folder)
    tempfile.tempdir = None  # then it is looked up anew
    for name in ("home", "pytest"):
        (folder / name).mkdir(exist_ok=True)
    config._tmp_path_factory._basetemp = folder / "pytest"  # the public setting would empty it


def _put(path: str, content: str) -> None:
    """Give the functions of a file that is imported the code of other content."""
    functions: Mapping[str, list[FunctionType]] = defaultdict(list)
    for candidate in gc.get_objects():
        if isinstance(candidate, FunctionType) and candidate.__code__.co_filename == path:
            functions[candidate.__code__.co_qualname].append(candidate)
    codes: dict[str, list[CodeType]] = defaultdict(list)
    for code in _codes(compile(content, path, "exec")):
        codes[code.co_qualname].append(code)
    for name, own in functions.items():
        lines = sorted({function.__code__.co_firstlineno for function in own})
        if len(lines) == len(codes[name]):  # several of one name: a property and its setter
            for function in own:
                function.__code__ = codes[name][lines.index(function.__code__.co_firstlineno)]


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


if sys.platform == "win32":
    raise ImportError("mutation needs fork")
