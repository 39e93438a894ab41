"""The communication loop compiled: `loop.c`, by whoever built the wheel, else at its first use."""

import ctypes
import threading
import warnings
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import ExportError
from fmus.native import compiled_library
from fmus.user_cache import cache_folder
from orchestration.run.loop import python_loop
from orchestration.run.loop_data import LoopFunctions, Wiring

_SOURCE = "loop.c"
_loading = threading.Lock()


def compiled_loop(wiring: Wiring) -> LoopFunctions:
    """The functions of the loop for one wiring; if it cannot be compiled those in Python, and a warning."""
    try:
        functions = library()
    except (ExportError, OSError) as error:
        warnings.warn(f"the communication loop runs in Python, which is slower: {error}", stacklevel=2)
        return python_loop(wiring)
    memory = np.array(_members(wiring), np.int64)
    pointer = ctypes.c_void_p(memory.ctypes.data)
    pointer.memory = memory, wiring  # type: ignore[attr-defined]  # they must live as long as the functions
    return LoopFunctions(*(partial(getattr(functions, name), pointer) for name in _SIGNATURES))


_INDEX, _TIME = ctypes.c_int64, ctypes.c_double
# in the order of `LoopFunctions`: the type of the result, and of the arguments after the wiring
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "loop_run": (_INDEX, (_INDEX, _INDEX)),
    "loop_exchange_and_record": (ctypes.c_int, (_INDEX,)),
    "loop_exchange": (ctypes.c_int, (_INDEX, _TIME, ctypes.c_int)),
    "loop_step": (ctypes.c_int, (_INDEX, _TIME, _TIME)),
    "loop_read_outputs": (ctypes.c_int, (_INDEX,)),
    "loop_save": (ctypes.c_int, (ctypes.c_void_p,)),
    "loop_restore": (ctypes.c_int, (ctypes.c_void_p,)),
    "loop_help": (None, ()),
}


def _members(wiring: Wiring) -> list[int]:
    """`Wiring` of loop.c: counts, then every member in its order, an array as its address."""
    sources = wiring.connections.source
    counted = (
        wiring.points,
        wiring.instances,
        sources,
        wiring.signal_index,
        wiring.record_index,
        wiring.memory,
    )
    return [*map(len, counted), *_flat(wiring)]


def _flat(value: Any) -> list[int]:
    if isinstance(value, tuple):
        return [leaf for member in value for leaf in _flat(member)]
    return [value.ctypes.data if isinstance(value, np.ndarray) else value]


def library() -> ctypes.CDLL:
    """The compiled loop: of the wheel, else compiled once for this user. Else ExportError or OSError."""
    with _loading:  # two threads would load it twice, each with a floating-point mode of its own to restore
        loaded = _library_or_error()
    if isinstance(loaded, Exception):
        raise loaded
    return loaded


@cache
def _library_or_error() -> ctypes.CDLL | Exception:
    """The error too is asked for once: a compiler that is not there takes its time to say so."""
    source = Path(__file__).parent / _SOURCE
    try:
        loaded = compiled_library.load(source, cache_folder("libraries"))
    except (ExportError, OSError) as error:
        return error
    for function, (result, arguments) in _SIGNATURES.items():
        entry = getattr(loaded, function)
        entry.restype, entry.argtypes = result, (ctypes.c_void_p, *arguments)
    return loaded
