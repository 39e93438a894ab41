"""A C source, with its headers, as a loaded library: shipped beside the source, or compiled once and stored.

The name of a library has a digest of its sources and options, `loop-linux64-<recipe>.so`. It is sealed as
entries of the store are.
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

    options: further options of the compiler
    Raises ExportError if there is no compiler for a new one, OSError if the system refuses to load it.
    """
    name = file_name(source, host_platform(), options)
    shipped = source.parent / name
    content = store.unsealed(shipped) or store.get(_KIND, name)
    if content is None:
        content = compile_source(source, host_platform(), options)
        store.put(_KIND, name, content)
    return _load(content, shipped)


def load_copy(original: Path) -> ctypes.CDLL:
    """Loads a copy of a library, whose global variables no other user in this process shares."""
    content = original.read_bytes()
    name = f"{original.stem}-{store.digest(content)[:32]}{original.suffix}"
    # a temporary copy would stay on the disk of Windows after the process
    if os.name == "nt" and store.get(_KIND, name) is None:
        store.put(_KIND, name, content)
    return _load(content, original.with_name(name))


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
    """Returns the name of the library of a source, a platform and options."""
    # toolchain.py has the flags of the compiler
    toolchain = Path(__file__).with_name("toolchain.py")
    recipe = b"".join(path.read_bytes() for path in (*_files(source), toolchain)) + " ".join(options).encode()
    return f"{source.stem}-{platform}-{store.digest(recipe)[:32]}.{TARGETS[platform][1]}"


def _files(source: Path) -> list[Path]:
    return [source, *sorted(source.parent.glob("*.h"))]


def _load(content: bytes, shipped: Path) -> ctypes.CDLL:
    """Loads a library from a new temporary file, or from one in the store if temporary files cannot run."""
    # No other process has the name of the new file. Windows neither removes nor replaces a loaded file:
    # there it is the file that was read.
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
        path = Path(folder) / "our.library"  # Windows adds .dll to a name without a dot
        path.write_bytes(content)
        return ctypes.CDLL(str(path))
