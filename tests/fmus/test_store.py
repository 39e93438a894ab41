"""Entries of the store are whole, and used only if no other user can have written them; locks."""

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from fmus import store
from fmus.fmi.description import describe
from fmus.generate import builder
from fmus.generate.cache import BuildCache, BuildRequest
from fmus.registry import FOLDER_VARIABLE, fmu_folder, fmu_path
from fmus.store import reason_for_distrust
from orchestration.errors import FmuLoadError
from tests.described_fmus import described
from tests.other_user import give_to_another_user

OWN_GROUP_WRITES = 0o002
"""The umask of distributions that give each user a group of its own."""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "l1-depth" / "rows" / "row.json"
    store.write(path, b"an entry")
    return path


@pytest.fixture
def shared_umask() -> Iterator[None]:
    before = os.umask(OWN_GROUP_WRITES)
    yield
    os.umask(before)


@pytest.mark.usefixtures("shared_umask")
def test_what_a_umask_of_002_writes_is_trusted(tmp_path: Path) -> None:
    path = tmp_path / "l1-depth" / "rows" / "row.json"
    store.write(path, b"an entry")
    assert reason_for_distrust(path) == ""
    assert {folder.stat().st_mode & 0o777 for folder in (path.parent, path.parent.parent)} == {0o700}


@pytest.mark.parametrize("mode", [0o020, 0o002])
@pytest.mark.parametrize("part", ["file", "folder"])
def test_a_file_that_others_can_write_or_replace_is_not_trusted(path: Path, part: str, mode: int) -> None:
    part_of_path = path if part == "file" else path.parent
    part_of_path.chmod(part_of_path.stat().st_mode | mode)
    assert reason_for_distrust(path).startswith(f"{part_of_path} can be written by other users")


@pytest.mark.parametrize("part", ["file", "folder"])
def test_what_belongs_to_another_user_is_not_trusted(
    path: Path, part: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    give_to_another_user(path if part == "file" else path.parent, monkeypatch)
    assert "belongs to another user" in reason_for_distrust(path)


def test_what_belongs_to_root_is_trusted(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An image of a container may hold FMUs that root built; root can replace this program too."""
    monkeypatch.setattr(os, "geteuid", lambda: path.stat().st_uid + 1)
    monkeypatch.setattr("fmus.operating_system._ROOT", path.stat().st_uid)
    assert reason_for_distrust(path) == ""


def test_a_link_is_not_trusted(path: Path, tmp_path: Path) -> None:
    path.symlink_to(path.rename(tmp_path / "elsewhere"))
    assert reason_for_distrust(path).startswith(f"{path} is a link")


def test_nothing_is_written_to_a_folder_of_others(path: Path) -> None:
    path.parent.chmod(0o777)
    with pytest.raises(PermissionError, match=r"can be written by other users.*: remove it, or set"):
        store.write(path.with_name("another.json"), b"another")
    assert [*path.parent.iterdir()] == [path]


def test_an_fmu_of_the_cache_that_others_can_write_is_refused_until_it_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "fmus"))
    path = fmu_path("ExamplePlant")
    path.parent.mkdir(parents=True, mode=0o700)
    described(path).chmod(0o600)
    describe(path)
    path.chmod(0o666)
    with pytest.raises(FmuLoadError, match=r"ExamplePlant.fmu can be written by other users.*: remove it"):
        describe(path)
    path.unlink()
    described(path).chmod(0o600)
    describe(path)


def test_an_fmu_that_is_no_part_of_the_cache_may_be_anybodys(tmp_path: Path) -> None:
    described(tmp_path / "Plant.fmu").chmod(0o666)
    describe(tmp_path / "Plant.fmu")


@pytest.mark.usefixtures("shared_umask")
def test_an_fmu_that_is_built_under_a_umask_of_002_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(FOLDER_VARIABLE, str(tmp_path / "fmus"))
    describe(builder.build_block("ExamplePlant", fmu_folder()))


def test_a_stamp_that_others_can_write_stamps_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    order = BuildRequest("ExamplePlant", tmp_path / "built")
    stamps = BuildCache(begun=float("inf"))
    sources = stamps.sources(order)
    assert sources
    order.folder.mkdir()
    (order.folder / "ExamplePlant.fmu").write_bytes(b"an FMU")
    stamps.write(sources, {"ExamplePlant.fmu": b"an FMU"})
    assert BuildCache().current(order)
    (stamp,) = (tmp_path / "l1-depth" / "builds").iterdir()
    stamp.chmod(0o666)
    assert BuildCache().current(order) is None


KEY = "an entry"


@pytest.fixture
def entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file of an entry."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    store.put("libraries", KEY, b"an entry")
    return store.folder("libraries") / KEY


@pytest.mark.parametrize(
    "change", [lambda data: data[:-1], lambda data: data + b" ", lambda data: b"b" + data[1:]]
)
def test_an_entry_is_as_it_was_written_or_not_there(entry: Path, change: Callable[[bytes], bytes]) -> None:
    assert store.get("libraries", KEY) == b"an entry"
    entry.write_bytes(change(entry.read_bytes()))
    assert store.get("libraries", KEY) is None


def test_entries_used_longest_ago_are_removed(entry: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(store.MOST, "libraries", 2)
    store.put("libraries", "older", b"")
    for age, path in ((100.0, entry), (50.0, entry.with_name("older"))):
        os.utime(path, (1e9 - age, 1e9 - age))
    assert store.get("libraries", KEY)  # which uses it
    store.put("libraries", "new", b"")
    assert {path.name for path in entry.parent.iterdir()} == {KEY, "new"}


def test_a_copy_with_the_time_of_its_original_changed_when_it_was_made(tmp_path: Path) -> None:
    (tmp_path / "copy.py").write_text("")
    os.utime(tmp_path / "copy.py", (1e9, 1e9))
    (_, _, changed), *_ = store.digests(tmp_path)
    assert changed > 1e9 + 1.0


WRITER = """
import sys
from fmus import store
for i in range(300):
    store.put("libraries", "key", sys.argv[1].encode())
"""


@pytest.mark.slow
@pytest.mark.usefixtures("entry")
def test_processes_that_write_one_entry_leave_a_whole_one() -> None:
    contents = ["first" * 10_000, "other" * 20_000]
    store.put("libraries", "key", contents[0].encode())
    writers = [subprocess.Popen([sys.executable, "-c", WRITER, content]) for content in contents]
    while any(writer.poll() is None for writer in writers):
        found = store.get("libraries", "key")
        assert found is not None
        assert found.decode() in contents
    assert [writer.returncode for writer in writers] == [0, 0]


def test_a_lock_is_held_once_and_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "folder" / "lock"
    for _ in range(2):
        with store.locked(path), pytest.raises(BlockingIOError), store.locked(path):
            pass
        assert not path.exists()


def test_a_lock_that_was_removed_before_it_was_held_is_taken_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else two processes hold locks of two files."""
    path, lock = tmp_path / "lock", fcntl.flock

    def after_it_was_removed(descriptor: int, operation: int) -> None:
        monkeypatch.setattr(fcntl, "flock", lock)
        path.unlink()
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", after_it_was_removed)
    with store.locked(path), pytest.raises(BlockingIOError), store.locked(path):
        pass
