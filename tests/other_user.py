"""Files that belong to another user."""

import os
from pathlib import Path

import pytest

_ANOTHER = 12345  # a number that no user of a machine for tests has


def give_to_another_user(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Changes the owner of a file as root; for others, this process becomes another user."""
    if os.geteuid() == 0:
        os.chown(path, _ANOTHER, -1)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: _ANOTHER)
