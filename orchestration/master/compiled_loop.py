"""The communication loop compiled: `c/loop.c`, once a machine, kept in the user's cache."""

import ctypes
import hashlib
import os
import tempfile
from functools import cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_cache_path

from fmus.toolchain import COMPILER, FLAGS, compile_library, host_platform
from orchestration.master.loop import Entries, Wiring

_SOURCE = "loop.c"


def compiled(w: Wiring) -> Entries:
    """The functions of the loop for one wiring. Raises ExportError if the loop cannot be compiled."""
    library = _library()
    memory = np.array(_members(w), np.int64)
    pointer = ctypes.c_void_p(memory.ctypes.data)
    pointer.memory = memory  # type: ignore[attr-defined]  # it must live as long as the functions
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
    source = (resources.files("orchestration") / "c" / _SOURCE).read_text(encoding="utf-8")
    platform = host_platform()
    key = repr((source, COMPILER, FLAGS, platform))
    path = user_cache_path("l1-depth") / f"loop-{hashlib.sha256(key.encode()).hexdigest()[:16]}"
    if not path.is_file():
        _keep(compile_library("loop", {_SOURCE: source}, [_SOURCE], platform), path)
    library = ctypes.CDLL(str(path))
    for name, (result, arguments) in _SIGNATURES.items():
        function = getattr(library, name)
        function.restype, function.argtypes = result, (ctypes.c_void_p, *arguments)
    return library


def _keep(content: bytes, path: Path) -> None:
    """Written whole, so that another process never loads half of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent)
    with os.fdopen(handle, "wb") as stream:
        stream.write(content)
    Path(temporary).replace(path)
