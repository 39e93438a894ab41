"""What each test costs and which lines it executes, with the fixtures and files that it shares."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage
from typing import Any

import pytest

import tests.shared_builds
from tests.mutation.lines import FILE, FOLDER, Line, noted, trace, trace_this_process


@dataclass
class Part:
    """CPU time [s] of a part of a test, its child processes included, and the lines that it executes.

    shared: CPU time of what is made once for several tests
    """

    seconds: float = 0.0
    shared: float = 0.0
    lines: set[Line] = field(default_factory=set)

    def add_shared(self, other: "Part") -> None:
        self.shared += other.seconds + other.shared
        self.lines |= other.lines


class Measurement:
    """A plugin of pytest. What is made once for several tests counts for each that uses it."""

    def __init__(self, folder: str, notes: Path) -> None:
        self.tests: dict[str, Part] = {}
        self._shared: dict[object, Part] = {}
        self._current, self._notes = Part(), notes
        os.environ |= {FOLDER: folder, FILE: str(notes)}
        os.register_at_fork(after_in_child=trace_this_process)
        trace(folder, self._note)

    def _note(self, line: Line) -> None:
        self._current.lines.add(line)

    @contextmanager
    def _measured(self) -> Iterator[Part]:
        """What happens in the context; it is no part of what is around it."""
        outer, self._current = self._current, Part()
        outer.lines |= noted(self._notes)
        start = _cpu()
        try:
            yield self._current
        finally:
            duration = _cpu() - start
            self._current.seconds += duration
            self._current.lines |= noted(self._notes)
            outer.seconds -= duration
            self._current = outer

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Iterator[object]:
        if fixturedef.scope == "function":
            return (yield)
        with self._measured() as part:
            result = yield
        self._shared[fixturedef.argname] = part
        return result

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: Any) -> Iterator[object]:
        with self._measured() as part:
            result = yield
        for name in item.fixturenames:
            part.add_shared(self._shared.get(name, Part()))
        self.tests[item.nodeid] = part
        return result

    def built_once(self, path: Path, build: Callable[[Path], Any]) -> Path:
        with self._measured() as part:
            result = _BUILT_ONCE(path, build)
        self._current.add_shared(self._shared.setdefault(path, part))
        return result


_BUILT_ONCE = tests.shared_builds.built_once
_measurements: list[Measurement] = []


def _built_once(path: Path, build: Callable[[Path], Any]) -> Path:
    return _measurements[0].built_once(path, build) if _measurements else _BUILT_ONCE(path, build)


tests.shared_builds.built_once = _built_once  # before a test imports it


def begin(config: pytest.Config, folder: str, notes: Path) -> Measurement:
    """Measure the tests that run from now on."""
    with suppress(OSError):
        notes.unlink()
    _measurements.append(Measurement(folder, notes))
    config.pluginmanager.register(_measurements[0])
    return _measurements[0]


def _cpu() -> float:
    """CPU time [s] of this process and of its children that have ended."""
    usages = map(getrusage, (RUSAGE_SELF, RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)
