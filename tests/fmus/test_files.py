"""A file is written completely or not at all; an archive follows from its content."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from fmus import files
from fmus.files import open_atomically, write_archive, write_json_atomically, write_text_atomically


def broken_chunks() -> Iterator[bytes]:
    yield b"new"
    raise OSError("disk full")


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_text_atomically(path, "old")
    with pytest.raises(OSError, match="disk full"), open_atomically(path) as stream:
        stream.writelines(broken_chunks())
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json_atomically(path, {"value": float("nan")})
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_written_file_replaces_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "text"
    write_text_atomically(path, "old")
    write_text_atomically(path, "depth \u00b5\n")
    assert path.read_bytes() == b"depth \xc2\xb5\n"


@pytest.mark.parametrize(("mask", "mode"), [(0o022, 0o644), (0o027, 0o640), (0o002, 0o664)])
def test_a_file_has_the_permissions_that_the_umask_gives(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mask: int, mode: int
) -> None:
    monkeypatch.setattr(files, "command_umask", None)  # which a command in this process would have kept
    before = os.umask(mask)
    try:
        write_text_atomically(tmp_path / "text", "depth")
    finally:
        os.umask(before)
    assert (tmp_path / "text").stat().st_mode & 0o777 == mode


def test_equal_members_are_equal_archives_in_any_order(tmp_path: Path) -> None:
    members = {"b.txt": b"second", "a/c.txt": b"first"}
    one = write_archive(tmp_path / "one.zip", members)
    other = write_archive(tmp_path / "other.zip", dict(reversed(members.items())))
    assert one.read_bytes() == other.read_bytes()
