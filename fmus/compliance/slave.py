"""One instance of an FMU for the behaviour rules: every call's status is looked at, memory is counted."""

import ctypes
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from fmpy import fmi2
from fmpy.fmi1 import FMICallException
from fmpy.logging import addLoggerProxy

from fmus.compliance.variable import Variable

STATUS = ("ok", "warning", "discard", "error", "fatal", "pending")
_PENDING = 5
_ELEMENTS = {"Real": fmi2.fmi2Real, "Integer": fmi2.fmi2Integer, "Boolean": fmi2.fmi2Boolean}


class CallError(Exception):
    """A call that did not succeed; names the call, its status and what the FMU logged."""


class Memory:
    """The importer's allocator, which knows what is still held and what was freed but never given."""

    def __init__(self) -> None:
        self.held: dict[int, Any] = {}
        self.given = self.foreign_frees = 0

    def allocate(self, count: int, size: int) -> int:
        block = ctypes.create_string_buffer(max(count * size, 1))
        address = ctypes.addressof(block)
        self.held[address] = block
        self.given += 1
        return address

    def free(self, address: int | None) -> None:
        if address and self.held.pop(address, None) is None:
            self.foreign_frees += 1


memory = Memory()
log: list[str] = []


def _keep(_: Any, instance: bytes, status: int, category: bytes, message: bytes) -> None:
    log.append(" ".join((message or b"").decode("utf-8", "replace").split()))


# one set for the whole process: the proxy that formats messages serves one logger only
callbacks = fmi2.fmi2CallbackFunctions()
callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(_keep)
callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(memory.allocate)
callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(memory.free)
callbacks.stepFinished = fmi2.fmi2StepFinishedTYPE(lambda *_: None)
addLoggerProxy(ctypes.byref(callbacks))


class Slave:
    """An instance between its creation and `free`."""

    def __init__(self, library: Any, name: str, guid: str, resources: Path) -> None:
        self._library = library
        arguments = (name.encode(), fmi2.fmi2CoSimulation, guid.encode(), resources.as_uri().encode())
        log.clear()
        self.handle = library.fmi2Instantiate(*arguments, ctypes.byref(callbacks), 0, 0)

    @property
    def exists(self) -> bool:
        return self.handle is not None

    def call(self, function: str, *arguments: Any) -> None:
        """Call fmi2`function`; CallError unless it returns ok or warning."""
        log.clear()
        try:
            getattr(self._library, f"fmi2{function}")(self.handle, *arguments)
        except FMICallException as error:
            if error.status == _PENDING and function == "DoStep":
                self._wait()
                return
            name = STATUS[error.status] if 0 <= error.status < len(STATUS) else str(error.status)
            said = "; ".join(log) or "it logged nothing"
            raise CallError(f"fmi2{function} returned {name}: expected ok; {said}") from error

    def _wait(self) -> None:
        """Until a pending step has ended; the watchdog of the process ends what never does."""
        status = fmi2.fmi2Status(_PENDING)
        while status.value == _PENDING:
            time.sleep(0.001)
            self.call("GetStatus", fmi2.fmi2DoStepStatus, ctypes.byref(status))
        if status.value > 1:
            raise CallError(f"the pending step ended with {STATUS[status.value]}: expected ok")

    def get(self, variables: Iterable[Variable]) -> dict[str, Any]:
        """Name -> value, of numbers and Booleans."""
        values = {}
        for base, members in _grouped(variables).items():
            buffer = (_ELEMENTS[base] * len(members))()
            self.call(f"Get{base}", _references(members), len(members), buffer)
            values.update({v.name: value for v, value in zip(members, buffer, strict=True)})
        return values

    def set(self, variable: Variable, value: Any) -> None:
        element = _ELEMENTS[variable.base_kind]
        self.call(f"Set{variable.base_kind}", _references([variable]), 1, (element * 1)(value))

    def enter(self, start: float = 0.0) -> None:
        """Set the experiment up and enter initialization mode."""
        self.call("SetupExperiment", 0, 0.0, start, 0, 0.0)
        self.call("EnterInitializationMode")

    def begin(self, start: float = 0.0) -> None:
        """To step mode."""
        self.enter(start)
        self.call("ExitInitializationMode")

    def step(self, t: float, h: float) -> None:
        self.call("DoStep", t, h, 0)

    def save(self) -> ctypes.c_void_p:
        state = ctypes.c_void_p()
        self.call("GetFMUstate", ctypes.byref(state))
        return state

    def free_state(self, state: ctypes.c_void_p) -> None:
        self.call("FreeFMUstate", ctypes.byref(state))

    def serialised(self, state: ctypes.c_void_p) -> bytes:
        size = ctypes.c_size_t()
        self.call("SerializedFMUstateSize", state, ctypes.byref(size))
        buffer = ctypes.create_string_buffer(max(size.value, 1))
        self.call("SerializeFMUstate", state, buffer, size.value)
        return buffer.raw[: size.value]

    def deserialised(self, content: bytes) -> ctypes.c_void_p:
        state = ctypes.c_void_p()
        buffer = ctypes.create_string_buffer(content, len(content))
        self.call("DeSerializeFMUstate", buffer, len(content), ctypes.byref(state))
        return state

    def directional(self, unknowns: Sequence[Variable], known: Variable) -> list[float]:
        """Derivatives of the unknowns by one known."""
        result = (fmi2.fmi2Real * len(unknowns))()
        seed = (fmi2.fmi2Real * 1)(1.0)
        arguments = (_references(unknowns), len(unknowns), _references([known]), 1, seed, result)
        self.call("GetDirectionalDerivative", *arguments)
        return list(result)

    def set_input_derivative(self, variable: Variable, order: int, value: float) -> None:
        arguments = (_references([variable]), 1, (fmi2.fmi2Integer * 1)(order), (fmi2.fmi2Real * 1)(value))
        self.call("SetRealInputDerivatives", *arguments)

    def output_derivatives(self, variables: Sequence[Variable], order: int) -> list[float]:
        count = len(variables)
        result = (fmi2.fmi2Real * count)()
        orders = (fmi2.fmi2Integer * count)(*[order] * count)
        self.call("GetRealOutputDerivatives", _references(variables), count, orders, result)
        return list(result)

    def free(self) -> None:
        if self.exists:
            self._library.fmi2FreeInstance(self.handle)
            self.handle = None


def _references(variables: Sequence[Variable]) -> Any:
    return (fmi2.fmi2ValueReference * len(variables))(*[v.reference or 0 for v in variables])


def _grouped(variables: Iterable[Variable]) -> dict[str, list[Variable]]:
    groups: dict[str, list[Variable]] = {}
    for v in variables:
        if v.base_kind in _ELEMENTS and v.reference is not None:
            groups.setdefault(v.base_kind, []).append(v)
    return groups
