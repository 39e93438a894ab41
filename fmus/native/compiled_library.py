"""A C source, with its headers, as a loaded library: shipped beside the source, or compiled once and cached.

A library is named after what it is made from and after its own bytes, `loop-linux64-<recipe>-<digest>.so`.
Bytes that do not agree with their name are never loaded, nor is a cached file that other users can write.
"""

import ctypes
import hashlib
import os
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from fmus.errors import ExportError
from fmus.platforms import TARGETS, host_platform
from fmus.user_cache import reason_for_distrust, write_cached


def load(source: Path, cache: Path, options: Sequence[str] = ()) -> ctypes.CDLL:
    """The library of a C source: the one beside it, else the one in a folder of this user's, else a new one.

    A new one is written to that folder, if this user and no other can write there. options: of the compiler,
    beside those of every library. Raises ExportError if there is no compiler for a new one, OSError if the
    system refuses to load it.
    """
    platform = host_platform()
    content = find(source, source.parent, platform, options=options)
    if content is None:
        content = find(source, cache, platform, only_own=True, options=options)
    if content is None:
        content = compile_source(source, platform, options)
        with suppress(OSError):  # without a private folder, the next process compiles again
            write_cached(cache / file_name(source, platform, content, options), content)
    return _load(content, (source.parent, cache), file_name(source, platform, content, options))


def find(
    source: Path, folder: Path, platform: str, only_own: bool = False, options: Sequence[str] = ()
) -> bytes | None:
    """The undamaged library of a source in a folder, if there is one.

    only_own: a file or folder of another user's, or one that others can write, is left out
    """
    for path in sorted(folder.glob(f"{_stem(source, platform, options)}-*")):
        if only_own and reason_for_distrust(path):
            continue
        with suppress(OSError):
            content = path.read_bytes()
            if path.name == file_name(source, platform, content, options):
                return content
    return None


def compile_source(source: Path, platform: str, options: Sequence[str] = ()) -> bytes:
    """A new library of a source for an FMI platform; ExportError without a compiler."""
    try:
        from fmus.native.toolchain import compile_library
    except ImportError as error:
        raise ExportError(f"no library of {source.name} for {platform}, and no compiler: {error}") from None
    texts = {path.name: path.read_text("utf-8") for path in _files(source)}
    return compile_library(source.stem, texts, [source.name], platform, options)


def file_name(source: Path, platform: str, content: bytes, options: Sequence[str] = ()) -> str:
    """The name of the library that has this content."""
    return f"{_stem(source, platform, options)}-{_digest(content)}.{TARGETS[platform][1]}"


def _stem(source: Path, platform: str, options: Sequence[str]) -> str:
    """What names of all libraries start with that are made from this source in this way."""
    toolchain = Path(__file__).with_name("toolchain.py")  # it holds the flags of the compiler
    recipe = b"".join(path.read_bytes() for path in (*_files(source), toolchain)) + " ".join(options).encode()
    return f"{source.stem}-{platform}-{_digest(recipe)}"


def _files(source: Path) -> list[Path]:
    return [source, *sorted(source.parent.glob("*.h"))]


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:16]


def _load(content: bytes, folders: tuple[Path, Path], name: str) -> ctypes.CDLL:
    """Load a library from a file that only this process knows, with the other temporary files.

    folders: where it may be a file of that name; the second one is the cache.

    It is in the cache where temporary files cannot be executed. Windows neither removes nor replaces a file
    that is loaded: there it is the file that was read.
    """
    if os.name == "nt":
        for folder in folders:
            if (folder / name).is_file():
                return ctypes.CDLL(str(folder / name))
    try:
        return _load_from(None, content)
    except OSError:
        if not folders[1].is_dir() or reason_for_distrust(folders[1] / name):
            raise
        return _load_from(folders[1], content)


def _load_from(parent: Path | None, content: bytes) -> ctypes.CDLL:
    with tempfile.TemporaryDirectory(dir=parent, prefix="l1-depth-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "library"
        path.write_bytes(content)
        return ctypes.CDLL(str(path))
