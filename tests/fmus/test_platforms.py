"""What is asked of the machine."""

import os

import pytest

from fmus.platforms import usable_processors


def test_processors_are_those_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container, which may have fewer than the machine."""
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3, 5}, raising=False)
    assert usable_processors() == 2
    monkeypatch.delattr(os, "sched_getaffinity")  # as on macOS and Windows
    assert usable_processors() == 64
