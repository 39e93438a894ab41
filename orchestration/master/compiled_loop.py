"""The communication loop compiled: `loop.c`, once a machine, kept in the user's cache."""

import atexit
import ctypes
import hashlib
import shutil
import tempfile
import warnings
from collections.abc import Callable
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from fmus.errors import ExportError
from fmus.export.toolchain import COMPILER, FLAGS, compile_library
from fmus.files import write_bytes_atomically
from fmus.platforms import host_platform, library_name
from orchestration.master.loop import Entries, Wiring, plain

_SOURCE = "loop.c"


def compiled(w: Wiring) -> Entries:
    """The functions of the loop for one wiring; if it cannot be compiled those in Python, and a warning."""
    try:
        library = _library()
    except (ExportError, OSError) as error:
        warnings.warn(f"the communication loop runs in Python, which is slower: {error}", stacklevel=2)
        return plain(w)
    memory = np.array(_members(w), np.int64)
    pointer = ctypes.c_void_p(memory.ctypes.data)
    pointer.memory = memory, w  # type: ignore[attr-defined]  # they must live as long as the functions
    return Entries(*(partial(getattr(library, name), pointer) for name in _SIGNATURES))


_INDEX, _TIME = ctypes.c_int64, ctypes.c_double
# in the order of `Entries`: the type of the result, and of the arguments after the wiring
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "loop_run": (_INDEX, (_INDEX, _INDEX)),
    "loop_arrive": (ctypes.c_int, (_INDEX,)),
    "loop_exchange": (ctypes.c_int, (_INDEX, _TIME, ctypes.c_int)),
    "loop_step": (ctypes.c_int, (_INDEX, _TIME, _TIME)),
    "loop_read_outputs": (ctypes.c_int, (_INDEX,)),
}


def _members(w: Wiring) -> list[int]:
    """`Wiring` of loop.c: counts, then every member in its order, an array as its address."""
    counts = [len(w.points), len(w.instance), len(w.links.source), len(w.signal_places), len(w.record)]
    return [*counts, *_flat(w)]


def _flat(value: Any) -> list[int]:
    if isinstance(value, tuple):
        return [leaf for member in value for leaf in _flat(member)]
    if isinstance(value, np.ndarray):
        if not value.flags.c_contiguous:
            raise ValueError("an array of the wiring is not contiguous")
        return [value.ctypes.data]
    return [value]


@cache
def _library() -> ctypes.CDLL:
    """Loaded; compiled before if neither this source nor its compiler was seen on this machine."""
    source = (resources.files("orchestration.master") / _SOURCE).read_text(encoding="utf-8")
    platform = host_platform()
    key = hashlib.sha256(repr((source, COMPILER, FLAGS, platform)).encode()).hexdigest()[:16]
    name = Path(library_name(f"loop-{key}", platform)).name
    library = _kept(name, lambda: compile_library("loop", {_SOURCE: source}, [_SOURCE], platform))
    for function, (result, arguments) in _SIGNATURES.items():
        entry = getattr(library, function)
        entry.restype, entry.argtypes = result, (ctypes.c_void_p, *arguments)
    return library


def _kept(name: str, build: Callable[[], bytes]) -> ctypes.CDLL:
    """The library of that name in the user's cache, or one for this process if that cannot be used."""
    path = user_cache_path("l1-depth") / name
    try:
        if not path.is_file():
            write_bytes_atomically(path, build())
        return ctypes.CDLL(str(path))
    except OSError:
        folder = tempfile.mkdtemp(prefix="l1-depth-loop-")
        atexit.register(shutil.rmtree, folder, ignore_errors=True)
        own = Path(folder) / name
        own.write_bytes(build())
        return ctypes.CDLL(str(own))
