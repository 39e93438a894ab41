"""The cache of rows: the rows that were used last stay, and no others."""

import os
from pathlib import Path

import pytest

from orchestration.study import score_cache
from orchestration.study.score_document import Row


def row(name: str) -> Row:
    return Row(name=name, title=name, league="position", scored=False, fmu={})


def test_rows_whose_last_use_is_longest_ago_are_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(score_cache, "folder", lambda: tmp_path)
    monkeypatch.setattr(score_cache, "MOST_ROWS", 3)
    for age, name in ((300.0, "used again"), (200.0, "forgotten"), (100.0, "recent")):
        score_cache.write(name, row(name), {"nominal": {"time": [0.0]}})
        os.utime(tmp_path / f"{name}.json", (1e9 - age, 1e9 - age))
    read = score_cache.read("used again")
    assert read is not None
    assert (read.row, read.traces) == (row("used again"), {"nominal": {"time": [0.0]}})
    score_cache.write("new", row("new"), {})
    assert {path.stem for path in tmp_path.glob("*.json")} == {"used again", "recent", "new"}
    assert score_cache.read("forgotten") is None
