"""What operating systems do differently: the ways of another one are taken where it is named."""

import os
import sys
import threading
from contextlib import ExitStack
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


def test_readers_share_a_lock_and_wait_for_a_writer_who_waits_for_none(tmp_path: Path) -> None:
    lock, path = operating_system.lock, tmp_path / "lock"
    path.touch()
    with ExitStack() as opened:
        writer, other_writer, reader, other_reader = (
            opened.enter_context(path.open("r+b")) for _ in range(4)
        )
        lock(writer.fileno(), shared=False)
        with pytest.raises(BlockingIOError):
            lock(other_writer.fileno(), shared=False)
        waiting = threading.Thread(target=lock, args=(reader.fileno(), True), daemon=True)
        waiting.start()
        waiting.join(0.1)
        assert waiting.is_alive()
        writer.close()
        waiting.join()
        lock(other_reader.fileno(), shared=True)
        with pytest.raises(BlockingIOError):
            lock(other_writer.fileno(), shared=False)
