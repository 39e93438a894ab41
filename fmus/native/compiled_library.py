"""A C source, with its headers, as a loaded library: shipped beside the source, or compiled once and stored.

A library is named after what it is made from, `loop-linux64-<recipe>.so`, and sealed as entries of the store.
"""

import ctypes
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from fmus import store
from fmus.errors import ExportError
from fmus.platforms import TARGETS, host_platform

_KIND = "libraries"


def load(source: Path, options: Sequence[str] = ()) -> ctypes.CDLL:
    """Loads the library of a C source: the one beside it, else the one in the store, else a new one.

    options: of the compiler, beside those of every library
    Raises ExportError if there is no compiler for a new one, OSError if the system refuses to load it.
    """
    name = file_name(source, host_platform(), options)
    shipped = source.parent / name
    content = store.unsealed(shipped) or store.get(_KIND, name)
    if content is None:
        content = compile_source(source, host_platform(), options)
        store.put(_KIND, name, content)
    return _load(content, shipped)


def is_compiled(source: Path, options: Sequence[str] = ()) -> bool:
    """Whether the library of a source is in the store."""
    return store.get(_KIND, file_name(source, host_platform(), options)) is not None


def compile_source(source: Path, platform: str, options: Sequence[str] = ()) -> bytes:
    """Returns a new library of a source for an FMI platform; ExportError without a compiler."""
    try:
        from fmus.native.toolchain import compile_library
    except ImportError as error:
        raise ExportError(f"no library of {source.name} for {platform}, and no compiler: {error}") from None
    texts = {path.name: path.read_text("utf-8") for path in _files(source)}
    return compile_library(source.stem, texts, [source.name], platform, options)


def file_name(source: Path, platform: str, options: Sequence[str] = ()) -> str:
    """Returns the name of the library that is made from a source in this way."""
    toolchain = Path(__file__).with_name("toolchain.py")  # it holds the flags of the compiler
    recipe = b"".join(path.read_bytes() for path in (*_files(source), toolchain)) + " ".join(options).encode()
    return f"{source.stem}-{platform}-{store.digest(recipe)[:32]}.{TARGETS[platform][1]}"


def _files(source: Path) -> list[Path]:
    return [source, *sorted(source.parent.glob("*.h"))]


def _load(content: bytes, shipped: Path) -> ctypes.CDLL:
    """Loads a library from a file that only this process knows, with the other temporary files.

    It is in the store where temporary files cannot be executed. Windows neither removes nor replaces a file
    that is loaded: there it is the file that was read.
    """
    kept = store.folder(_KIND) / shipped.name
    if os.name == "nt":
        for path in (shipped, kept):
            if store.unsealed(path) == content:
                return ctypes.CDLL(str(path))
    try:
        return _load_from(None, content)
    except OSError:
        if not kept.parent.is_dir() or store.reason_for_distrust(kept):
            raise
        return _load_from(kept.parent, content)


def _load_from(parent: Path | None, content: bytes) -> ctypes.CDLL:
    with tempfile.TemporaryDirectory(dir=parent, prefix="l1-depth-", ignore_cleanup_errors=True) as folder:
        path = Path(folder) / "library"
        path.write_bytes(content)
        return ctypes.CDLL(str(path))
