"""Callbacks that an importer gives to an instance of an FMI 2.0 FMU: logger and memory; and the log."""

import contextlib
import ctypes
import functools
import itertools
import sys
from typing import Any

from fmus.native.compiled_library import load_copy
from fmus.platforms import FMPY, SHARED_LIBRARY_SUFFIX, SYSTEM_PLATFORM

# fmi2Status
_ERROR, _FATAL = 3, 4

Logger = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_char_p
)
AllocateMemory = ctypes.CFUNCTYPE(ctypes.c_void_p, ctypes.c_size_t, ctypes.c_size_t)
FreeMemory = ctypes.CFUNCTYPE(None, ctypes.c_void_p)
StepFinished = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_int)
_C_LIBRARY = ctypes.cdll.msvcrt if sys.platform == "win32" else ctypes.CDLL(None)


class CallbackFunctions(ctypes.Structure):
    """Structure fmi2CallbackFunctions of fmi2FunctionTypes.h."""

    _fields_ = (
        ("logger", Logger),
        ("allocateMemory", AllocateMemory),
        ("freeMemory", FreeMemory),
        ("stepFinished", StepFinished),
        ("componentEnvironment", ctypes.c_void_p),
    )


class Log(list[tuple[int, str]]):
    """The (status, message) pairs that an instance logged since the last `clear`, without repetitions.

    error_logged: shape (1,), not 0 after a message of status error or fatal; the communication loop reads it
    """

    def __init__(self) -> None:
        super().__init__()
        self.error_logged: Any = (ctypes.c_int64 * 1)()

    def add(
        self, status: int, message: str, instance: str | None = None, category: str | None = None
    ) -> None:
        """Adds a message. instance, category: as the FMU gave them, for a subclass that stores these, too."""
        entry = status, " ".join(message.split())
        if not self or self[-1] != entry:
            self.append(entry)
        if status in (_ERROR, _FATAL):
            self.error_logged[0] = 1

    def clear(self) -> None:
        super().clear()
        self.error_logged[0] = 0


class CountingAllocator:
    """Allocator of memory for FMUs that counts it.

    held: address -> block in use
    given: number of blocks that were allocated
    foreign_frees: number of frees of another address
    """

    def __init__(self) -> None:
        self.held: dict[int, Any] = {}
        self.given = self.foreign_frees = 0
        self.allocate = AllocateMemory(self._allocate)
        self.free = FreeMemory(self._free)

    def _allocate(self, count: int, size: int) -> int:
        block = ctypes.create_string_buffer(max(count * size, 1))
        address = ctypes.addressof(block)
        self.held[address] = block
        self.given += 1
        return address

    def _free(self, address: int | None) -> None:
        if address and self.held.pop(address, None) is None:
            self.foreign_frees += 1


# Logs by the environment that the callbacks carry: two instances in a process may have the same name.
_logs: dict[int, Log] = {}
_environments = itertools.count(1)


def log_message(
    environment: int | None,
    instance: bytes | None,
    status: int,
    category: bytes | None,
    message: bytes | None,
) -> None:
    """Adds a message to the log of the callbacks with this environment."""
    log = _logs.get(environment or 0, _logs.get(0))
    if log is not None:
        instance_name, category_name = (None if x is None else _text(x) for x in (instance, category))
        log.add(status, _text(message or b""), instance_name, category_name)


def _text(content: bytes) -> str:
    return content.decode("utf-8", "replace")


_python_logger = Logger(log_message)


@functools.cache
def _logger() -> Any:
    """Returns a logger that formats messages for `log_message`; variable arguments do not reach Python."""
    # The library is FMPy's, copied and loaded for this module alone: FMPy's own copy serves the logger that
    # was registered last in the process. Where the copy cannot be loaded, messages arrive without arguments.
    callbacks = CallbackFunctions(logger=_python_logger)
    with contextlib.suppress(OSError):
        formatter = load_copy(FMPY / "logging" / SYSTEM_PLATFORM / f"logging{SHARED_LIBRARY_SUFFIX}")
        formatter.addLoggerProxy.argtypes, formatter.addLoggerProxy.restype = [ctypes.c_void_p], None
        formatter.addLoggerProxy(ctypes.byref(callbacks))
    return callbacks.logger


class Callbacks:
    """The callbacks of one instance, and the log that they fill until `close`.

    allocator: calloc and free of C by default
    asynchronous: whether a step may return pending
    log: a new one by default
    environment: of the callbacks, by which messages find their log; the log of 0 gets all other messages
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
        self.structure = CallbackFunctions(
            logger=_logger(),
            allocateMemory=allocator.allocate if allocator else AllocateMemory(("calloc", _C_LIBRARY)),
            freeMemory=allocator.free if allocator else FreeMemory(("free", _C_LIBRARY)),
            componentEnvironment=self._environment,
        )
        if asynchronous:
            self.structure.stepFinished = StepFinished(lambda *_: None)

    def close(self) -> None:
        """Closes the log: messages that come later are dropped."""
        _logs.pop(self._environment, None)
