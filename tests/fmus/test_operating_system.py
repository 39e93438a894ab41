"""What operating systems do differently: the ways of another one are taken where it is named."""

import os
import sys
from pathlib import Path

import pytest

from fmus import operating_system


def test_processors_are_those_that_this_process_may_use(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a container, which may have fewer than the machine."""
    monkeypatch.setattr(os, "cpu_count", lambda: 64)
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {3, 5}, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert operating_system.usable_processors() == 2
    monkeypatch.setattr(sys, "platform", "darwin")
    assert operating_system.usable_processors() == 64


@pytest.mark.parametrize("platform", [sys.platform, "darwin"])
def test_a_file_gets_its_size(platform: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", platform)
    with (tmp_path / "file").open("wb") as stream:
        operating_system.allocate(stream.fileno(), 5000)
    assert (tmp_path / "file").stat().st_size == 5000
