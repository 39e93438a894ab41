"""The library of an FMI 3.0 co-simulation FMU behind the functions of FMI 2.0, in C: `fmi3_calls.c`.

So the loop, saved states and errors are the same for both standards.
"""

import ctypes
import os
import threading
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import ExportError, FmuLoadError
from fmus.fmi.binding import Library, declare, signatures
from fmus.fmi.callbacks import Callbacks, log_message
from fmus.fmi.fmi3_description import TYPES
from fmus.fmi.model_description import Element
from fmus.native import compiled_library

_SOURCE = "fmi3_calls.c"
# in the order of `Functions` of the source
_FUNCTIONS = (
    "FreeInstance",
    "EnterInitializationMode",
    "ExitInitializationMode",
    "Terminate",
    "Reset",
    "GetFMUState",
    "SetFMUState",
    "FreeFMUState",
    "SerializedFMUStateSize",
    "SerializeFMUState",
    "DeserializeFMUState",
    "DoStep",
    *(f"{verb}{name}" for name in TYPES for verb in ("Get", "Set")),
)
_INSTANTIATE = "fmi3InstantiateCoSimulation"
_POINTER, _SIZE, _FLAG = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_bool
_Log = ctypes.CFUNCTYPE(None, _POINTER, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
_log = _Log(
    lambda environment, status, category, text: log_message(environment, None, status, category, text)
)
_loading = threading.Lock()


class Fmi3Library(Library):
    """A loaded library of FMI 3.0; functions of FMI 2.0 for its instances are attributes.

    elements: of the model description, for variables
    Raises FmuLoadError if the functions of FMI 2.0 cannot be compiled, else what `Library` raises.
    """

    instantiates = _INSTANTIATE

    def __init__(self, path: Path, elements: Sequence[Element] = ()) -> None:
        with _loading:
            calls = _calls()
        if isinstance(calls, Exception):
            raise FmuLoadError(f"FMI 3.0 takes a library of {_SOURCE}, which a wheel has: {calls}") from calls
        self._calls, self._functions = calls, ctypes.CDLL(str(path.resolve()))
        names = (_INSTANTIATE, *(f"fmi3{name}" for name in _FUNCTIONS))
        if missing := [name for name in names if not hasattr(self._functions, name)]:
            self.unload()
            raise AttributeError(f"{path.name} lacks {', '.join(missing)}: expected them in FMI 3.0")
        functions = (getattr(self._functions, name) for name in names[1:])
        addresses = [ctypes.cast(function, _POINTER).value or 0 for function in functions]
        self._addresses, self._elements = np.array(addresses, np.int64), np.array(elements, np.int64)
        self._instantiate = self._functions.fmi3InstantiateCoSimulation
        self._instantiate.restype = _POINTER
        self._instantiate.argtypes = [*[ctypes.c_char_p] * 3, *[_FLAG] * 4, _POINTER, _SIZE, *[_POINTER] * 3]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._calls, name)

    def instantiate(
        self, interface: int, name: str, guid: str, resources: Path, callbacks: Callbacks, logging_on: bool
    ) -> int | None:
        environment = callbacks.structure.componentEnvironment
        folder = f"{resources}{os.sep}".encode() if resources.is_dir() else None  # 2.3.1
        flags = (False, logging_on, False, False)  # visible, logging, event mode, early return
        instance = self._instantiate(
            name.encode(), guid.encode(), folder, *flags, None, 0, environment, _log, None
        )
        arrays = self._addresses.ctypes.data, self._elements.ctypes.data, len(self._elements)
        return instance and self._calls.fmi3_behind(instance, *arrays, _log, environment)

    def function_called(self, handle: ctypes.c_void_p | None, function: str) -> str:
        refused: bytes | None = self._calls.fmi3_refused(handle) if handle else None
        return refused.decode() if refused else _name_of(function)


def _name_of(function: str) -> str:
    """Returns the function of FMI 3.0 for one of FMI 2.0."""
    for old, new in (("fmi2", "fmi3"), ("Real", "Float64"), ("Integer", "Int32"), ("FMUstate", "FMUState")):
        function = function.replace(old, new)
    return function


@cache
def _calls() -> ctypes.CDLL | Exception:
    """Returns the library of the source, or the error, looked for once: finding no compiler takes time."""
    try:
        calls = compiled_library.load(Path(__file__).with_name(_SOURCE))
    except (ExportError, OSError) as error:
        return error
    declare(calls, signatures())
    calls.fmi3_behind.restype, calls.fmi3_refused.restype = _POINTER, ctypes.c_char_p
    calls.fmi3_behind.argtypes = [_POINTER, _POINTER, _POINTER, _SIZE, _POINTER, _POINTER]
    calls.fmi3_refused.argtypes = [_POINTER]
    return calls
