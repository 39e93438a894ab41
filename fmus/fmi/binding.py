"""The FMI 2.0 binding: the library of an unpacked FMU, and calls of its functions for an instance."""

import contextlib
import ctypes
import sys
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from fmus.errors import ExportError
from fmus.fmi.callbacks import Callbacks
from fmus.platforms import (
    SHARED_LIBRARY_SUFFIX,
    SYSTEM_PLATFORM,
    host_platform,
    library_name,
    platform_folder,
)

# fmi2Status, then fmi2StatusKind
OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)
DO_STEP_STATUS, PENDING_STATUS, LAST_SUCCESSFUL_TIME, TERMINATED = range(4)
_STATUS_NAMES = ("ok", "warning", "discard", "error", "fatal", "pending")

# type of the functions that transfer numbers -> ctypes element (fmi2TypesPlatform.h)
ELEMENTS = {"Real": ctypes.c_double, "Integer": ctypes.c_int, "Boolean": ctypes.c_int}
# fmi2Boolean, then fmi2Type
_FALSE, _TRUE = 0, 1
MODEL_EXCHANGE, CO_SIMULATION = 0, 1
# uses of an instance of FMI 3.0, as in fmi3_calls.c
EXAMINED, EVENT_MODE, EARLY_RETURN, ADJOINT = 1, 2, 4, 8


def element_type(transfer_type: str) -> Any:
    return ctypes.c_char_p if transfer_type == "String" else ELEMENTS[transfer_type]


def status_name(status: int) -> str:
    """Returns the name of an fmi2Status, or "status N" for an unknown number."""
    return _STATUS_NAMES[status] if 0 <= status < len(_STATUS_NAMES) else f"status {status}"


def platform_name(fmi: int = 2) -> str:
    """Returns the FMI name of this machine's platform, or else the name of its system and address size.

    fmi: the version of the standard
    """
    try:
        return platform_folder(host_platform(), fmi)
    except ExportError:
        return SYSTEM_PLATFORM


def library_member(members: Collection[str], model_identifier: str, fmi: int = 2) -> str | None:
    """Returns the path inside an FMU of the library that this machine loads, or None.

    members: the paths in the FMU
    fmi: the version of the standard
    """
    # The folder of the FMI platform comes first, then the folder that FMPy uses, whose name has no processor.
    candidates = [f"binaries/{SYSTEM_PLATFORM}/{model_identifier}{SHARED_LIBRARY_SUFFIX}"]
    with contextlib.suppress(ExportError):
        candidates.insert(0, library_name(model_identifier, host_platform(), fmi))
    return next((path for path in candidates if path in members), None)


def reference_array(references: Sequence[int]) -> Any:
    """Returns value references as an array of fmi2ValueReference."""
    return (ctypes.c_uint * len(references))(*references)


# Functions of FMI 2.0 by the types of their arguments: p(ointer), s(ize), d(ouble), i(nt). They return a
# status unless `_RESULTS` has another type.
_COMMON_SIGNATURES = {
    "": "GetTypesPlatform GetVersion",
    "p": "FreeInstance EnterInitializationMode ExitInitializationMode Terminate Reset",
    "pp": "GetFMUstate SetFMUstate FreeFMUstate",
    "ppp": "SerializedFMUstateSize",
    "pisp": "SetDebugLogging",
    "ppps": "SerializeFMUstate",
    "ppsp": "GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString "
    "DeSerializeFMUstate",
    "ppspspp": "GetDirectionalDerivative",
    "piddid": "SetupExperiment",
    "pipppii": "Instantiate",
}
# fmi2Type -> functions of that interface alone
_SIGNATURES = {
    CO_SIMULATION: {
        "p": "CancelStep",
        "pip": "GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus",
        "pddi": "DoStep",
        "ppspp": "SetRealInputDerivatives GetRealOutputDerivatives",
    },
    MODEL_EXCHANGE: {
        "p": "EnterEventMode EnterContinuousTimeMode",
        "pp": "NewDiscreteStates",
        "pipp": "CompletedIntegratorStep",
        "pd": "SetTime",
        "pps": "SetContinuousStates GetDerivatives GetEventIndicators GetContinuousStates "
        "GetNominalsOfContinuousStates",
    },
}
_RESULTS = {
    "fmi2Instantiate": ctypes.c_void_p,
    "fmi2FreeInstance": None,
    "fmi2GetTypesPlatform": ctypes.c_char_p,
    "fmi2GetVersion": ctypes.c_char_p,
}
_TYPES = {"p": ctypes.c_void_p, "s": ctypes.c_size_t, "d": ctypes.c_double, "i": ctypes.c_int}


def signatures(interface: int = CO_SIMULATION) -> dict[str, str]:
    """Returns function -> types of its arguments, for the functions of an interface (fmi2Type)."""
    signatures = (*_COMMON_SIGNATURES.items(), *_SIGNATURES[interface].items())
    return {f"fmi2{name}": types for types, names in signatures for name in names.split()}


def declare(functions: ctypes.CDLL, signatures: Mapping[str, str]) -> list[str]:
    """Declares the types of the functions that a library has; returns the names of the others."""
    missing = []
    for name, types in signatures.items():
        function = getattr(functions, name, None)
        if function is None:
            missing.append(name)
            continue
        function.argtypes = [_TYPES[letter] for letter in types]
        function.restype = _RESULTS.get(name, ctypes.c_int)
    return missing


class Library:
    """A loaded library; its FMI functions are attributes.

    interface: fmi2Type, whose functions it must have
    optional: functions of the interface that may be missing
    Raises OSError if the system refuses, AttributeError if a function is missing.
    """

    instantiates = "fmi2Instantiate"
    fmi = 2  # version of the standard

    def __init__(self, path: Path, interface: int = CO_SIMULATION, optional: Collection[str] = ()) -> None:
        # By its absolute path, the system also finds the libraries that it needs: the working directory,
        # which all threads share, stays as it is.
        self._functions = ctypes.CDLL(str(path.resolve()))
        absent = declare(self._functions, signatures(interface))
        if missing := [name for name in absent if name.removeprefix("fmi2") not in optional]:
            self.unload()
            raise AttributeError(
                f"{path.name} lacks {', '.join(missing)}: expected every function of FMI 2.0"
            )

    def __getattr__(self, name: str) -> Any:
        # an attribute of the object is found faster the next time
        function = self.__dict__[name] = getattr(self._functions, name)
        return function

    def instantiate(
        self, interface: int, name: str, guid: str, resources: Path, callbacks: Callbacks, logging_on: bool
    ) -> int | None:
        """Returns the address of a new instance; None if the FMU refuses. interface: fmi2Type"""
        return self.fmi2Instantiate(
            name.encode(),
            interface,
            guid.encode(),
            resources.as_uri().encode(),
            ctypes.byref(callbacks.structure),
            _FALSE,
            logging_on,
        )

    def function_called(self, handle: ctypes.c_void_p | None, function: str) -> str:
        """Returns the name of the function of the FMU that a call of `function` has called."""
        return function

    def free_of_null(self) -> None:
        """Calls fmi2FreeInstance or fmi3FreeInstance with NULL."""
        getattr(self._functions, f"fmi{self.fmi}FreeInstance")(None)

    def unload(self) -> None:
        # of PythonFMU, which otherwise waits in Windows, maybe for ever, for a thread to end
        if hasattr(self._functions, "finalizePythonInterpreter"):
            self._functions.finalizePythonInterpreter()
        system = ctypes.windll.kernel32 if sys.platform == "win32" else ctypes.CDLL(None)
        free = system.FreeLibrary if sys.platform == "win32" else system.dlclose
        free.argtypes = [ctypes.c_void_p]
        free(self._functions._handle)


class BoundInstance(ABC):
    """An instance of an FMU whose functions are called by name; `check_status` decides about each status.

    interface: fmi2Type
    handle: the fmi2Component, None before `instantiate` and if the FMU refused; log: its messages
    """

    interface = CO_SIMULATION

    def __init__(self, library: Library, callbacks: Callbacks) -> None:
        self.library, self.callbacks, self.log = library, callbacks, callbacks.log
        self.handle: ctypes.c_void_p | None = None

    @abstractmethod
    def check_status(self, function: str, status: int) -> None:
        """Raises an error for a status that is a failure of the function."""

    def instantiate(self, name: str, guid: str, resources: Path, logging_on: bool) -> bool:
        """Creates the instance; False if the FMU returns NULL."""
        address = self.library.instantiate(self.interface, name, guid, resources, self.callbacks, logging_on)
        self.handle = ctypes.c_void_p(address) if address else None
        return self.handle is not None

    def status(self, function: str, *arguments: Any) -> int:
        """Returns the status that a function of the library returns for the instance."""
        return getattr(self.library, function)(self.handle, *arguments)

    def call(self, function: str, *arguments: Any) -> None:
        """Calls a function and checks its status."""
        self.check_status(function, self.status(function, *arguments))

    def get_values(self, transfer_type: str, references: Sequence[int]) -> list[Any]:
        """Returns the values of variables of one type, in one call; Strings as bytes."""
        buffer = (element_type(transfer_type) * len(references))()
        self.call(f"fmi2Get{transfer_type}", reference_array(references), len(references), buffer)
        return list(buffer)

    def set_values(self, transfer_type: str, references: Sequence[int], values: Sequence[Any]) -> None:
        """Sets variables of one type in one call; Strings are given as bytes."""
        buffer = (element_type(transfer_type) * len(references))(*values)
        self.call(f"fmi2Set{transfer_type}", reference_array(references), len(references), buffer)

    def set_up_experiment(
        self, start_time: float, stop_time: float | None = None, tolerance: float | None = None
    ) -> None:
        stop, given = ((_FALSE, 0.0) if x is None else (_TRUE, x) for x in (stop_time, tolerance))
        self.call("fmi2SetupExperiment", *given, start_time, *stop)

    def enter_initialization_mode(self) -> None:
        self.call("fmi2EnterInitializationMode")

    def exit_initialization_mode(self) -> object:
        self.call("fmi2ExitInitializationMode")

    def get_fmu_state(self, state: int | None = None) -> int:
        """Returns the FMU's state as it is now; the saved state that is given, if any, is overwritten."""
        pointer = ctypes.c_void_p(state)
        self.call("fmi2GetFMUstate", ctypes.byref(pointer))
        return pointer.value or 0

    def set_fmu_state(self, state: int) -> None:
        self.call("fmi2SetFMUstate", ctypes.c_void_p(state))

    def free_fmu_state(self, state: int) -> None:
        self.call("fmi2FreeFMUstate", ctypes.byref(ctypes.c_void_p(state)))

    def serialize_fmu_state(self, state: int) -> bytes:
        """Returns a saved state as bytes, from which another instance of this FMU can restore it."""
        size, saved = ctypes.c_size_t(), ctypes.c_void_p(state)
        self.call("fmi2SerializedFMUstateSize", saved, ctypes.byref(size))
        content = ctypes.create_string_buffer(max(size.value, 1))
        self.call("fmi2SerializeFMUstate", saved, content, size)
        return content.raw[: size.value]

    def deserialize_fmu_state(self, content: bytes) -> int:
        """Returns a saved state from the bytes of `serialize_fmu_state`."""
        pointer = ctypes.c_void_p()
        buffer = ctypes.create_string_buffer(content, len(content))
        self.call("fmi2DeSerializeFMUstate", buffer, len(content), ctypes.byref(pointer))
        return pointer.value or 0
