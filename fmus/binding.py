"""The FMI 2.0 binding: the library of an unpacked FMU, callbacks of an instance, calls of its functions."""

import contextlib
import ctypes
import functools
import itertools
import shutil
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
from fmpy import fmi2

from fmus.errors import ExportError
from fmus.platforms import host_platform, library_name

OK, WARNING, DISCARD, ERROR, FATAL, PENDING = range(6)  # fmi2Status
LAST_SUCCESSFUL_TIME, TERMINATED = 2, 3  # fmi2StatusKind
_STATUS_NAMES = ("ok", "warning", "discard", "error", "fatal", "pending")

# type of the functions that transfer numbers -> ctypes element
ELEMENTS = {"Real": fmi2.fmi2Real, "Integer": fmi2.fmi2Integer, "Boolean": fmi2.fmi2Boolean}


def element_type(transfer_type: str) -> Any:
    return fmi2.fmi2String if transfer_type == "String" else ELEMENTS[transfer_type]


def status_name(status: int) -> str:
    """The name of an fmi2Status; a number that is none is named as it is."""
    return _STATUS_NAMES[status] if 0 <= status < len(_STATUS_NAMES) else f"status {status}"


def platform_name() -> str:
    """The FMI name of this machine's platform, or else FMPy's name of it."""
    try:
        return host_platform()
    except ExportError:
        return fmpy.platform


def library_member(members: Collection[str], model_identifier: str) -> str | None:
    """The path inside an FMU of the library that this machine loads; None if there is none.

    members: the paths in the FMU. The folder of the FMI platform comes first, then the folder that FMPy uses.
    """
    candidates = [f"binaries/{fmpy.platform}/{model_identifier}{fmpy.sharedLibraryExtension}"]
    with contextlib.suppress(ExportError):
        candidates.insert(0, library_name(model_identifier, host_platform()))
    return next((path for path in candidates if path in members), None)


def reference_array(references: Sequence[int]) -> Any:
    """Value references as the functions of FMI take them."""
    return (fmi2.fmi2ValueReference * len(references))(*references)


# Functions of FMI 2.0 by the types of their arguments: p(ointer), s(ize), d(ouble), i(nt). They return a
# status unless `_RESULTS` has another type.
_SIGNATURES = {
    "": "GetTypesPlatform GetVersion",
    "p": "FreeInstance EnterInitializationMode ExitInitializationMode Terminate Reset CancelStep",
    "pp": "GetFMUstate SetFMUstate FreeFMUstate",
    "ppp": "SerializedFMUstateSize",
    "pip": "GetStatus GetRealStatus GetIntegerStatus GetBooleanStatus GetStringStatus",
    "pddi": "DoStep",
    "pisp": "SetDebugLogging",
    "ppps": "SerializeFMUstate",
    "ppsp": "GetReal GetInteger GetBoolean GetString SetReal SetInteger SetBoolean SetString "
    "DeSerializeFMUstate",
    "ppspp": "SetRealInputDerivatives GetRealOutputDerivatives",
    "ppspspp": "GetDirectionalDerivative",
    "piddid": "SetupExperiment",
    "pipppii": "Instantiate",
}
_RESULTS = {
    "Instantiate": ctypes.c_void_p,
    "FreeInstance": None,
    "GetTypesPlatform": ctypes.c_char_p,
    "GetVersion": ctypes.c_char_p,
}
_TYPES = {"p": ctypes.c_void_p, "s": ctypes.c_size_t, "d": ctypes.c_double, "i": ctypes.c_int}


class Library:
    """A loaded library; its FMI functions are attributes.

    It is loaded by its whole path, from which the system also resolves what it needs; the working directory,
    which all threads share, stays as it is. Raises OSError if the system refuses, AttributeError if a
    function is missing.
    """

    def __init__(self, path: Path) -> None:
        self._functions = ctypes.CDLL(str(path.resolve()))
        missing = []
        for types, names in _SIGNATURES.items():
            for name in names.split():
                function = getattr(self._functions, f"fmi2{name}", None)
                if function is None:
                    missing.append(f"fmi2{name}")
                    continue
                function.argtypes = [_TYPES[letter] for letter in types]
                function.restype = _RESULTS.get(name, ctypes.c_int)
        if missing:
            self.unload()
            raise AttributeError(
                f"{path.name} lacks {', '.join(missing)}: expected every function of FMI 2.0"
            )

    def __getattr__(self, name: str) -> Any:
        return getattr(self._functions, name)

    def unload(self) -> None:
        fmpy.freeLibrary(self._functions._handle)


class Log(list[tuple[int, str]]):
    """The (status, message) pairs that an instance logged since the last `clear`, without repetitions.

    error_logged: shape (1,), not 0 after a message of status error or fatal; the communication loop reads it
    """

    def __init__(self) -> None:
        super().__init__()
        self.error_logged = np.zeros(1, np.int64)

    def add(
        self, status: int, message: str, instance: str | None = None, category: str | None = None
    ) -> None:
        """Add a message. instance, category: as the FMU gave them, for a log that keeps these too."""
        entry = status, " ".join(message.split())
        if not self or self[-1] != entry:
            self.append(entry)
        if status in (ERROR, FATAL):
            self.error_logged[0] = 1

    def clear(self) -> None:
        super().clear()
        self.error_logged[0] = 0


class CountingAllocator:
    """Memory for FMUs that is counted.

    held: address -> block, of those in use; foreign_frees: how often another address was freed
    """

    def __init__(self) -> None:
        self.held: dict[int, Any] = {}
        self.foreign_frees = 0
        self.allocate = fmi2.fmi2CallbackAllocateMemoryTYPE(self._allocate)
        self.free = fmi2.fmi2CallbackFreeMemoryTYPE(self._free)

    def _allocate(self, count: int, size: int) -> int:
        block = ctypes.create_string_buffer(max(count * size, 1))
        address = ctypes.addressof(block)
        self.held[address] = block
        return address

    def _free(self, address: int | None) -> None:
        if address and self.held.pop(address, None) is None:
            self.foreign_frees += 1


# Logs by the environment that the callbacks carry: two instances in a process may have the same name.
_logs: dict[int, Log] = {}
_environments = itertools.count(1)


def _log_message(
    environment: int | None,
    instance: bytes | None,
    status: int,
    category: bytes | None,
    message: bytes | None,
) -> None:
    log = _logs.get(environment or 0, _logs.get(0))
    if log is not None:
        instance_name, category_name = (None if x is None else _text(x) for x in (instance, category))
        log.add(status, _text(message or b""), instance_name, category_name)


def _text(content: bytes) -> str:
    return content.decode("utf-8", "replace")


_python_logger = fmi2.fmi2CallbackLoggerTYPE(_log_message)


@functools.cache
def _logger() -> Any:
    """A logger that formats messages (their arguments do not reach Python) and passes them to `_log_message`.

    It is FMPy's, in a library copied and loaded for this module alone: FMPy's own copy serves the logger that
    was registered last in the process. Where the copy cannot be loaded, messages arrive without arguments.
    """
    callbacks = fmi2.fmi2CallbackFunctions(logger=_python_logger)
    name = f"logging{fmpy.sharedLibraryExtension}"
    original = Path(fmpy.__file__).parent / "logging" / fmpy.platform / name
    with (
        contextlib.suppress(OSError),
        tempfile.TemporaryDirectory(prefix="l1-depth-", ignore_cleanup_errors=True) as folder,
    ):
        formatter = ctypes.CDLL(shutil.copy(original, folder))
        formatter.addLoggerProxy.argtypes, formatter.addLoggerProxy.restype = [ctypes.c_void_p], None
        formatter.addLoggerProxy(ctypes.byref(callbacks))
    return callbacks.logger


class Callbacks:
    """The callbacks of one instance, and the log that they fill until `close`.

    allocator: FMPy's by default; asynchronous: whether a step may return pending; log: a new one by default;
    environment: of the callbacks, by which messages find their log; 0 for those that find no other
    """

    def __init__(
        self,
        allocator: CountingAllocator | None = None,
        asynchronous: bool = False,
        log: Log | None = None,
        environment: int | None = None,
    ) -> None:
        self._environment = next(_environments) if environment is None else environment
        self.log = _logs[self._environment] = Log() if log is None else log
        self.structure = fmi2.fmi2CallbackFunctions(
            logger=_logger(),
            allocateMemory=allocator.allocate if allocator else fmi2.defaultCallbacks.allocateMemory,
            freeMemory=allocator.free if allocator else fmi2.defaultCallbacks.freeMemory,
            componentEnvironment=self._environment,
        )
        if asynchronous:
            self.structure.stepFinished = fmi2.fmi2StepFinishedTYPE(lambda *_: None)

    def close(self) -> None:
        """Messages that come later are dropped."""
        _logs.pop(self._environment, None)


class BoundInstance(ABC):
    """An instance of an FMU whose functions are called by name; `check_status` decides about each status.

    handle: the fmi2Component, None before `instantiate` and if the FMU refused; log: its messages
    """

    def __init__(self, library: Library, callbacks: Callbacks) -> None:
        self.library, self.callbacks, self.log = library, callbacks, callbacks.log
        self.handle: ctypes.c_void_p | None = None

    @abstractmethod
    def check_status(self, function: str, status: int) -> None:
        """Raise an error for a status that is a failure of the function."""

    def instantiate(self, name: str, guid: str, resources: Path, logging_on: bool) -> bool:
        """Create the instance; False if the FMU returns NULL."""
        address = self.library.fmi2Instantiate(
            name.encode(),
            fmi2.fmi2CoSimulation,
            guid.encode(),
            resources.as_uri().encode(),
            ctypes.byref(self.callbacks.structure),
            fmi2.fmi2False,
            logging_on,
        )
        self.handle = ctypes.c_void_p(address) if address else None
        return self.handle is not None

    def status(self, function: str, *arguments: Any) -> int:
        """The status that a function of the library returns for the instance."""
        return getattr(self.library, function)(self.handle, *arguments)

    def call(self, function: str, *arguments: Any) -> None:
        """Call a function and check its status."""
        self.check_status(function, self.status(function, *arguments))

    def get_values(self, transfer_type: str, references: Sequence[int]) -> list[Any]:
        """The values of variables of one type, in one call; Strings as bytes."""
        buffer = (element_type(transfer_type) * len(references))()
        self.call(f"fmi2Get{transfer_type}", reference_array(references), len(references), buffer)
        return list(buffer)

    def set_values(self, transfer_type: str, references: Sequence[int], values: Sequence[Any]) -> None:
        """Set variables of one type in one call; Strings are given as bytes."""
        buffer = (element_type(transfer_type) * len(references))(*values)
        self.call(f"fmi2Set{transfer_type}", reference_array(references), len(references), buffer)

    def set_up_experiment(self, start_time: float, stop_time: float | None = None) -> None:
        stop = (fmi2.fmi2False, 0.0) if stop_time is None else (fmi2.fmi2True, stop_time)
        self.call("fmi2SetupExperiment", fmi2.fmi2False, 0.0, start_time, *stop)

    def enter_initialization_mode(self) -> None:
        self.call("fmi2EnterInitializationMode")

    def exit_initialization_mode(self) -> None:
        self.call("fmi2ExitInitializationMode")

    def get_fmu_state(self, state: int | None = None) -> int:
        """The FMU's state as it is now; the saved state that is given, if any, is overwritten."""
        pointer = ctypes.c_void_p(state)
        self.call("fmi2GetFMUstate", ctypes.byref(pointer))
        return pointer.value or 0

    def set_fmu_state(self, state: int) -> None:
        self.call("fmi2SetFMUstate", ctypes.c_void_p(state))

    def free_fmu_state(self, state: int) -> None:
        self.call("fmi2FreeFMUstate", ctypes.byref(ctypes.c_void_p(state)))

    def serialize_fmu_state(self, state: int) -> bytes:
        """A saved state as bytes, from which another instance of this FMU can restore it."""
        size, saved = ctypes.c_size_t(), ctypes.c_void_p(state)
        self.call("fmi2SerializedFMUstateSize", saved, ctypes.byref(size))
        content = ctypes.create_string_buffer(max(size.value, 1))
        self.call("fmi2SerializeFMUstate", saved, content, size)
        return content.raw[: size.value]

    def deserialize_fmu_state(self, content: bytes) -> int:
        """A saved state from the bytes of `serialize_fmu_state`."""
        pointer = ctypes.c_void_p()
        buffer = ctypes.create_string_buffer(content, len(content))
        self.call("fmi2DeSerializeFMUstate", buffer, len(content), ctypes.byref(pointer))
        return pointer.value or 0
