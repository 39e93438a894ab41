"""What the tests of the master share."""

import tempfile
from pathlib import Path

import pytest


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only place where temporary folders can be."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path
