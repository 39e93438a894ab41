"""A compiled C source is shipped or cached, and only bytes that are as they were written are ever loaded."""

import ctypes
import sys
import tempfile
from pathlib import Path

import pytest

from fmus import store
from fmus.errors import ExportError
from fmus.native import compiled_library, toolchain
from fmus.native.compiled_library import file_name, load
from fmus.platforms import host_platform

SOURCE = """
__attribute__((visibility("default"))) int number(void) { return 42; }
"""


@pytest.fixture
def source(tmp_path: Path) -> Path:
    path = tmp_path / "package" / "answer.c"
    path.parent.mkdir()
    path.write_text(SOURCE)
    return path


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return store.folder("libraries")


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*arguments: object) -> bytes:
        raise ExportError("zig cc failed")

    monkeypatch.setattr(toolchain, "compile_library", fails)


def ship(source: Path) -> Path:
    """Put the library beside the source, as in a wheel."""
    platform = host_platform()
    path = source.parent / file_name(source, platform)
    path.write_bytes(store.sealed(compiled_library.compile_source(source, platform)))
    return path


def number(library: ctypes.CDLL) -> int:
    return library.number()


def test_the_library_beside_its_source_is_loaded_without_a_compiler_and_without_a_cache(
    source: Path, cache: Path, request: pytest.FixtureRequest
) -> None:
    ship(source)
    request.getfixturevalue("no_compiler")
    assert number(load(source)) == 42
    assert not cache.exists()


def test_a_library_is_compiled_once(source: Path, cache: Path, request: pytest.FixtureRequest) -> None:
    load(source)
    (path,) = cache.iterdir()
    request.getfixturevalue("no_compiler")
    assert number(load(source)) == 42
    assert [*cache.iterdir()] == [path]
    assert cache.stat().st_mode & 0o077 == 0


def test_a_changed_source_is_compiled_again(source: Path, cache: Path) -> None:
    load(source)
    source.write_text(SOURCE.replace("42", "43"))
    assert number(load(source)) == 43


@pytest.mark.parametrize("shipped", [True, False])
def test_a_damaged_library_is_never_loaded(source: Path, cache: Path, shipped: bool) -> None:
    """A truncated one would be a SIGBUS at its first call. The next process has a good one again."""
    if shipped:
        path = ship(source)
    else:
        load(source)
        (path,) = cache.iterdir()
    content = path.read_bytes()
    path.write_bytes(content[:-1])
    assert number(load(source)) == 42
    assert (cache / path.name).read_bytes() == content


# A library of another answer, named as if it were made from the source: only its owner and mode tell.


@pytest.fixture
def planted(source: Path, cache: Path, tmp_path: Path) -> Path:
    other = tmp_path / "other.c"
    other.write_text(SOURCE.replace("42", "666"))
    content = compiled_library.compile_source(other, host_platform())
    cache.mkdir(mode=0o700, parents=True)
    path = cache / file_name(source, host_platform())
    path.write_bytes(store.sealed(content))
    path.chmod(0o600)
    return path


def test_a_user_is_believed(source: Path, cache: Path, planted: Path) -> None:
    """What the next tests plant would be loaded if others could not have written it."""
    assert number(load(source)) == 666


@pytest.mark.parametrize("what", ["folder", "file"])
def test_what_others_can_write_is_not_loaded(source: Path, cache: Path, planted: Path, what: str) -> None:
    """A folder is not used either, and keeps its files."""
    place = cache if what == "folder" else planted
    place.chmod(place.stat().st_mode | 0o002)
    assert compiled_library.is_compiled(source) is False
    assert number(load(source)) == 42
    assert [*cache.iterdir()] == [planted]


def test_where_nothing_can_be_cached_each_process_compiles(source: Path, cache: Path) -> None:
    """A file stands where the folder would be."""
    cache.parent.parent.mkdir()
    cache.parent.touch()
    assert number(load(source)) == 42


def test_nothing_is_left_among_the_temporary_files(
    source: Path, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ship(source)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    assert number(load(source)) == 42
    assert [*temporary.iterdir()] == []


def test_without_library_and_compiler_the_error_names_both(
    source: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "fmus.native.toolchain", None)
    with pytest.raises(ExportError, match=r"no library of answer.c for .*, and no compiler: "):
        load(source)
