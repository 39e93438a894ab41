"""A file is written completely or not at all; an archive follows from its content."""

from collections.abc import Iterator
from pathlib import Path

import pytest

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


def test_a_written_file_replaces_the_old_one_and_others_may_read_it(tmp_path: Path) -> None:
    path = tmp_path / "new folder" / "text"
    write_text_atomically(path, "old")
    write_text_atomically(path, "depth \u00b5\n")
    assert path.read_bytes() == b"depth \xc2\xb5\n"
    assert path.stat().st_mode & 0o777 == 0o644


def test_equal_members_are_equal_archives_in_any_order(tmp_path: Path) -> None:
    members = {"b.txt": b"second", "a/c.txt": b"first"}
    one = write_archive(tmp_path / "one.zip", members)
    other = write_archive(tmp_path / "other.zip", dict(reversed(members.items())))
    assert one.read_bytes() == other.read_bytes()
