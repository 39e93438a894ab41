"""A process of its own: how it starts, and how it ended."""

import os
import signal
from pathlib import Path

import pytest

from fmus.process import ending, start


def test_an_interrupt_at_the_terminal_is_not_for_it(tmp_path: Path) -> None:
    """That goes to a session."""
    process = start(signal.pause, tmp_path)
    try:
        assert os.getsid(process.pid) != os.getsid(0)
    finally:
        process.kill()
        process.communicate()


@pytest.mark.parametrize(
    ("status", "words"),
    [
        (0, "exit status 0"),
        (-11, "SIGSEGV"),
        (-37, "signal 37"),  # a real-time one has no name
        (0xC0000005, "exit status 0xc0000005"),  # an access violation on Windows
    ],
)
def test_an_ending_has_words(status: int, words: str) -> None:
    assert ending(status) == words
