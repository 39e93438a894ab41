"""The library of an FMI 3.0 FMU behind the functions of FMI 2.0, in C: `fmi3_calls.c`.

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
from fmus.fmi.binding import (
    CO_SIMULATION,
    EARLY_RETURN,
    EVENT_MODE,
    MODEL_EXCHANGE,
    Library,
    declare,
    signatures,
)
from fmus.fmi.callbacks import Callbacks, log_message
from fmus.fmi.fmi3_description import TYPES
from fmus.fmi.model_description import Element
from fmus.native import compiled_library

_SOURCE = "fmi3_calls.c"
_OF_INTERFACE = {
    CO_SIMULATION: "DoStep EnterStepMode",
    MODEL_EXCHANGE: "EnterContinuousTimeMode SetTime CompletedIntegratorStep "
    "GetContinuousStates SetContinuousStates GetContinuousStateDerivatives GetEventIndicators "
    "GetNominalsOfContinuousStates GetNumberOfContinuousStates GetNumberOfEventIndicators",
}
_DERIVATIVES = "GetDirectionalDerivative GetAdjointDerivative"
_UNUSED = {  # functions that runs do without
    CO_SIMULATION: f"SetDebugLogging EnterEventMode UpdateDiscreteStates EnterStepMode {_DERIVATIVES}",
    MODEL_EXCHANGE: f"SetDebugLogging GetNumberOfContinuousStates GetNumberOfEventIndicators {_DERIVATIVES}",
}
_COMMON = (
    "FreeInstance EnterInitializationMode ExitInitializationMode Terminate Reset GetFMUState SetFMUState"
    " FreeFMUState SerializedFMUStateSize SerializeFMUState DeserializeFMUState SetDebugLogging"
    f" EnterEventMode UpdateDiscreteStates {_DERIVATIVES}"
)
# in the order of `Functions` of the source
_FUNCTIONS = (
    *_COMMON.split(),
    *(name for names in _OF_INTERFACE.values() for name in names.split()),
    *(f"{verb}{name}" for name in TYPES for verb in ("Get", "Set")),
)
_INSTANTIATE = {CO_SIMULATION: "fmi3InstantiateCoSimulation", MODEL_EXCHANGE: "fmi3InstantiateModelExchange"}
_POINTER, _SIZE, _FLAG = ctypes.c_void_p, ctypes.c_size_t, ctypes.c_bool
# types of the arguments of an instantiation before and after those that both interfaces have
_FOR_ONE_INTERFACE: dict[int, tuple[list[Any], list[Any]]] = {
    CO_SIMULATION: ([_FLAG, _FLAG, _POINTER, _SIZE], [_POINTER]),
    MODEL_EXCHANGE: ([], []),
}
# `Element` of the source
_ELEMENT = np.dtype([(name, "f8" if name == "start" else "i8") for name in Element._fields])
_Log = ctypes.CFUNCTYPE(None, _POINTER, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p)
_log = _Log(
    lambda environment, status, category, text: log_message(environment, None, status, category, text)
)
_loading = threading.Lock()


class Fmi3Library(Library):
    """A loaded library of FMI 3.0; functions of FMI 2.0 for its instances are attributes.

    interface: fmi2Type, whose functions it must have
    elements: of the model description, for variables
    is_examined: whether a check calls it, which uses more functions than a run
    fmi: version of the standard
    Raises FmuLoadError if the functions of FMI 2.0 cannot be compiled, and the errors of `Library`.
    """

    fmi = 3

    def __init__(
        self,
        path: Path,
        interface: int = CO_SIMULATION,
        elements: Sequence[Element] = (),
        is_examined: bool = False,
    ) -> None:
        with _loading:
            calls = _calls()
        if isinstance(calls, Exception):
            raise FmuLoadError(f"FMI 3.0 needs a library of {_SOURCE}, which a wheel has: {calls}") from calls
        self._calls, self._functions = calls, ctypes.CDLL(str(path.resolve()))
        self.instantiates, self._interface = _INSTANTIATE[interface], interface
        others = _OF_INTERFACE[MODEL_EXCHANGE if interface == CO_SIMULATION else CO_SIMULATION].split()
        others += [] if is_examined else _UNUSED[interface].split()
        names = [self.instantiates, *(f"fmi3{name}" for name in _FUNCTIONS if name not in others)]
        if missing := [name for name in names if not hasattr(self._functions, name)]:
            self.unload()
            raise AttributeError(f"{path.name} lacks {', '.join(missing)}: expected them in FMI 3.0")
        functions = (getattr(self._functions, f"fmi3{name}", 0) for name in _FUNCTIONS)
        addresses = [ctypes.cast(function, _POINTER).value or 0 for function in functions]
        self._addresses, self._elements = np.array(addresses, np.int64), np.array([*elements], _ELEMENT)
        self._instantiate = getattr(self._functions, self.instantiates)
        self._instantiate.restype = _POINTER
        before, after = _FOR_ONE_INTERFACE[interface]
        arguments = [*[ctypes.c_char_p] * 3, _FLAG, _FLAG, *before, _POINTER, _POINTER, *after]
        self._instantiate.argtypes = arguments

    def __getattr__(self, name: str) -> Any:
        return getattr(self._calls, name)

    def instantiate(
        self, interface: int, name: str, guid: str, resources: Path, callbacks: Callbacks, logging_on: bool
    ) -> int | None:
        environment = callbacks.structure.componentEnvironment
        return self.created(name.encode(), guid.encode(), resources, environment, logging_on)

    def created(
        self, name: Any, token: Any, resources: Path, environment: int | None, logging_on: bool, uses: int = 0
    ) -> int | None:
        """Returns the address of a new instance behind the functions of FMI 2.0; None if the FMU refuses.

        name, token: bytes, or buffers of them; uses: sum of `EXAMINED` and the like
        """
        # 2.3.1: the path ends with a separator; NULL without a folder `resources`
        folder = f"{resources}{os.sep}".encode() if resources.is_dir() else None
        before, after = ([kind() for kind in kinds] for kinds in _FOR_ONE_INTERFACE[self._interface])
        if before and uses & (EVENT_MODE | EARLY_RETURN):
            before[:2] = bool(uses & EVENT_MODE), bool(uses & EARLY_RETURN)
            after = [ctypes.cast(self._calls.fmi3_update, _POINTER)]
        # not visible
        arguments = name, token, folder, False, logging_on
        instance = self._instantiate(*arguments, *before, environment, _log, *after)
        arrays = self._addresses.ctypes.data, self._elements.ctypes.data, len(self._elements)
        return instance and self._calls.fmi3_behind(instance, *arrays, _log, environment, uses)

    def function_called(self, handle: ctypes.c_void_p | None, function: str) -> str:
        refused: bytes | None = self._calls.fmi3_refused(handle) if handle else None
        return refused.decode() if refused else _name_of(function)

    def unwritten(self, handle: ctypes.c_void_p | None) -> str:
        """Returns the name of a result that the last step of an examined FMU did not write, or ""."""
        return (self._calls.fmi3_unwritten(handle) or b"").decode()


def _name_of(function: str) -> str:
    """Returns the function of FMI 3.0 for one of FMI 2.0."""
    for old, new in (("fmi2", "fmi3"), ("Real", "Float64"), ("Integer", "Int32"), ("FMUstate", "FMUState")):
        function = function.replace(old, new)
    return function


@cache
def _calls() -> ctypes.CDLL | Exception:
    """Returns the library of the source, or the error."""
    # An error is remembered, too: to find no compiler takes time.
    try:
        calls = compiled_library.load(Path(__file__).with_name(_SOURCE))
    except (ExportError, OSError) as error:
        return error
    for interface in _INSTANTIATE:
        declare(calls, signatures(interface))
    calls.fmi3_behind.restype = _POINTER
    calls.fmi3_refused.restype = calls.fmi3_unwritten.restype = ctypes.c_char_p
    calls.fmi3_behind.argtypes = [_POINTER, _POINTER, _POINTER, _SIZE, _POINTER, _POINTER, ctypes.c_int]
    calls.fmi3_refused.argtypes = calls.fmi3_unwritten.argtypes = [_POINTER]
    return calls
