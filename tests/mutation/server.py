"""A plugin of pytest: it collects the tests once, and runs some of them in a new process for each mutant.

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
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest

from tests.mutation import measurement

PIPES = "L1_DEPTH_MUTATION_PIPES"  # descriptors: requests are read from the first, answers go to the second
NOTE, MEASURED = "test-that-runs.txt", "measured.json"
_LEAST_S, _TIMES = 30.0, 20.0  # of CPU time; a test that takes longer and so many times as long never ends
_WALL_PER_CPU = 10.0  # where other processes have the processors, or a test sleeps


def pytest_runtestloop(session: pytest.Session) -> bool:
    """Run tests in a new process for each line of JSON, and answer with its number and its status."""
    reading, writing = map(int, os.environ[PIPES].split())
    with os.fdopen(reading) as requests, os.fdopen(writing, "w") as answers:
        print("collected", file=answers, flush=True)
        for line in requests:
            pid = os.fork()
            if not pid:
                _run(session, **json.loads(line))
            os.waitid(os.P_PID, pid, os.WEXITED | os.WNOWAIT)
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(pid, signal.SIGKILL)  # what the tests left behind, while the number is theirs
            print(os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), file=answers, flush=True)
    return True


def _run(
    session: pytest.Session, folder: str, seconds: Mapping[str, float], mutant: Any, measured: str
) -> None:
    """Run tests in a folder for temporary files, until one fails, and end the process.

    seconds: of CPU time that each test takes without a mutant, in the order in which they run; by default all
    mutant: path and content of a source in Python; measured: folder whose lines are noted for each test
    """
    status = 3
    try:
        os.setpgrp()  # and not a session: that would be scheduled apart
        signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background; tests send it
        _move(Path(folder), session.config)
        if mutant:
            _put(*mutant)
        items = [item for item in session.items if not seconds or item.nodeid in seconds]
        order = {name: index for index, name in enumerate(seconds)}
        items.sort(key=lambda item: order.get(item.nodeid, 0))
        measuring = (
            measurement.begin(session.config, measured, Path(folder, "lines.txt")) if measured else None
        )
        _run_until_failure(session, items, Path(folder), seconds)
        if measuring:
            parts = {
                name: (part.seconds, part.shared, sorted(part.lines))
                for name, part in measuring.tests.items()
            }
            Path(folder, MEASURED).write_text(json.dumps(parts))
        status = int(bool(session.testsfailed or not items))
    finally:
        os._exit(status)


def _run_until_failure(
    session: pytest.Session, items: Sequence[pytest.Item], folder: Path, seconds: Mapping[str, float]
) -> None:
    for item, following in zip(items, [*items[1:], None], strict=True):
        (folder / NOTE).write_text(item.nodeid)
        if item.nodeid in seconds:
            limit = max(_LEAST_S, _TIMES * seconds[item.nodeid])
            signal.setitimer(signal.ITIMER_PROF, limit)  # of this process alone: it ends by a signal
            signal.setitimer(signal.ITIMER_REAL, _WALL_PER_CPU * limit)
        item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
        if session.testsfailed:
            break


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
    gc.unfreeze()  # else what was there after the collection of tests is not among the objects
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
                with suppress(ValueError):  # a mutant that uses fewer variables of the function around it
                    function.__code__ = codes[name][lines.index(function.__code__.co_firstlineno)]


def _codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _codes(constant)


if sys.platform == "win32":
    raise ImportError("mutation needs fork")
