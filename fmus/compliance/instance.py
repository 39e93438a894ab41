"""The process that loads an FMU and calls it: each status is checked, memory is counted.

It judges nothing, and what it sends is not trusted: the FMU can do to it whatever it likes.
"""

import ctypes
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fmpy.fmi2 import fmi2DoStepStatus, fmi2Integer, fmi2Real, fmi2Status

from fmus.binding import (
    ELEMENTS,
    PENDING,
    WARNING,
    BoundInstance,
    Callbacks,
    CountingAllocator,
    Library,
    reference_array,
    status_name,
)
from fmus.process import Parent

MOST_MEMORY = 4 << 30  # bytes
MOST_OF_A_FILE = 1 << 30  # bytes


class CallError(Exception):
    """A call that did not succeed; names the call, its status and the messages that the FMU logged."""


class CheckedInstance(BoundInstance):
    """An instance between `instantiate` and `free`; a call that does not succeed raises CallError.

    Variables are given by their value references, and by the type in the names of the functions.
    """

    def check_status(self, function: str, status: int) -> None:
        messages = "; ".join(message for _, message in self.log) or "it logged nothing"
        self.log.clear()
        if status == PENDING and function == "fmi2DoStep":
            self._wait()
        elif status > WARNING:
            raise CallError(f"{function} returned {status_name(status)}: expected ok; {messages}")

    def _wait(self) -> None:
        """Wait until a pending step has ended; the time limit of the rule ends a wait without end."""
        status = fmi2Status(PENDING)
        while status.value == PENDING:
            time.sleep(0.001)
            self.call("fmi2GetStatus", fmi2DoStepStatus, ctypes.byref(status))
        if status.value > WARNING:
            raise CallError(f"the pending step ended with {status_name(status.value)}: expected ok")

    def get(self, kind: str, references: Sequence[int]) -> list[Any]:
        values = (ELEMENTS[kind] * len(references))()
        self.call(f"fmi2Get{kind}", reference_array(references), len(references), values)
        return list(values)

    def set(self, kind: str, references: Sequence[int], values: Sequence[float]) -> None:
        content = (ELEMENTS[kind] * len(references))(*values)
        self.call(f"fmi2Set{kind}", reference_array(references), len(references), content)

    def do_step(self, t: float, h: float) -> None:
        """Advance from t to t + h seconds."""
        self.call("fmi2DoStep", t, h, 0)

    def directional_derivatives(self, unknowns: Sequence[int], known: int) -> list[float]:
        """Derivatives of the unknowns with respect to one known."""
        result, seed = (fmi2Real * len(unknowns))(), (fmi2Real * 1)(1.0)
        arguments = (reference_array(unknowns), len(unknowns), reference_array([known]), 1, seed, result)
        self.call("fmi2GetDirectionalDerivative", *arguments)
        return list(result)

    def set_input_derivative(self, reference: int, order: int, value: float) -> None:
        arguments = (reference_array([reference]), 1, (fmi2Integer * 1)(order), (fmi2Real * 1)(value))
        self.call("fmi2SetRealInputDerivatives", *arguments)

    def output_derivatives(self, references: Sequence[int], order: int) -> list[float]:
        count = len(references)
        result, orders = (fmi2Real * count)(), (fmi2Integer * count)(*[order] * count)
        self.call("fmi2GetRealOutputDerivatives", reference_array(references), count, orders, result)
        return list(result)

    def freed_fmu_state(self, state: int) -> int | None:
        """The address that fmi2FreeFMUstate leaves: it frees a saved state."""
        pointer = ctypes.c_void_p(state)
        self.call("fmi2FreeFMUstate", ctypes.byref(pointer))
        return pointer.value

    def free(self) -> None:
        if self.handle is not None:
            self.status("fmi2FreeInstance")
            self.handle = None
        self.callbacks.close()


class LoadedFmu:
    """A loaded library with its instances by number."""

    def __init__(self, library: Path, resources: Path) -> None:
        self._library, self._resources = Library(library), resources
        self._memory = CountingAllocator()
        self._instances: dict[int, CheckedInstance] = {}

    def text(self, function: str) -> str:
        """What a function without arguments returns."""
        return getattr(self._library, function)().decode("utf-8", "replace")

    def memory(self) -> tuple[int, int]:
        """Blocks that instances hold, and how often an unknown address was freed."""
        return len(self._memory.held), self._memory.foreign_frees

    def set_search_path(self, path: str) -> str:
        """Set the search path for programs; returns the one before."""
        before, os.environ["PATH"] = os.environ.get("PATH", ""), path
        return before

    def create(self, number: int, guid: str) -> bool:
        """Create an instance; False if the FMU returns NULL."""
        instance = CheckedInstance(self._library, Callbacks(self._memory, asynchronous=True))
        self._instances[number] = instance
        return instance.instantiate(f"instance {number}", guid, self._resources, logging_on=False)

    def of(self, number: int, method: str, *arguments: Any) -> Any:
        """Call a method of an instance."""
        return getattr(self._instances[number], method)(*arguments)


def call_fmu(parent: Parent) -> None:
    """Receive a working folder and the paths of library and resources, then (number, calls of `LoadedFmu`).

    Sends [number, results, error]: results of the calls up to the first error, and that error, or null.
    """
    folder, *paths = parent.receive()
    os.chdir(folder)  # where the FMU writes files
    _limit_resources()
    fmu = None
    while True:
        number, calls = parent.receive()
        results, error = [], None
        try:
            if calls and fmu is None:
                fmu = LoadedFmu(*paths)
            for method, *arguments in calls:
                result = getattr(fmu, method)(*arguments)
                results.append(result.hex() if isinstance(result, bytes) else result)
        except Exception as exception:  # whatever a foreign library makes of a call is a finding
            error = str(exception) or type(exception).__name__
        parent.send_json([number, results, error])


def _limit_resources() -> None:
    """Limit memory, and the size of a file, where the operating system does that; no core is dumped."""
    try:
        import resource
    except ImportError:  # of Windows
        return
    limits = (
        (resource.RLIMIT_DATA, MOST_MEMORY),
        (resource.RLIMIT_FSIZE, MOST_OF_A_FILE),
        (resource.RLIMIT_CORE, 0),
    )
    for kind, limit in limits:
        _, hard = resource.getrlimit(kind)
        bound = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
        resource.setrlimit(kind, (bound, bound))
