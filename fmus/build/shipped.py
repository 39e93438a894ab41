"""The library of a native FMU, called with any parameters, inputs and state before the FMU is written."""

import ctypes
import tempfile
from ctypes import c_bool, c_double, c_size_t, c_void_p
from pathlib import Path
from typing import Any, ClassVar

from fmus.block import Block
from fmus.block.scalars import flatten
from fmus.build.symbolic import traced
from fmus.errors import ExportError
from fmus.fmi.binding import OK, BoundInstance, Library, status_name
from fmus.fmi.callbacks import Callbacks

# the first words of `Data` in fmus/native/instance.h: mode, stale parameters, stale outputs, rates of inputs
_UNKNOWN_PARAMETERS, _AT_START, _IN_STEPS = (2, 1, 1, 0), (2, 0, 1, 0), (4, 0, 0, 0)


class ShippedLibrary(BoundInstance):
    """An instance of the library whose saved state is written in memory, as fmus/native/snapshot.h has it."""

    library_class: ClassVar[type[Library]] = Library

    def __init__(self, block: Block, guid: str, content: bytes) -> None:
        # Windows does not remove a library that is loaded
        with tempfile.TemporaryDirectory(prefix="l1-depth-build-", ignore_cleanup_errors=True) as folder:
            path = Path(folder) / "library"
            path.write_bytes(content)
            super().__init__(self.library_class(path), Callbacks())
        self.instantiate(block.name, guid, path, logging_on=False)
        self._saved, self._states = self.get_fmu_state(), traced(block).step.numel_out(0)
        self._calculated, self._variables = len(flatten(block.calculated)), 1 + len(block.variables)
        words = self._saved + (len(guid) // 8 + 1) * 8
        self._words = (ctypes.c_int64 * 4).from_address(words)
        # time, variables, rates of inputs and state; the last two have one number more than there are
        count = self._variables + len(flatten(block.inputs)) + self._states + 2
        self._numbers = (ctypes.c_double * count).from_address(words + ctypes.sizeof(self._words))

    def check_status(self, function: str, status: int) -> None:
        if status != OK:
            raise ExportError(f"the new library: {function} returns {status_name(status)}: expected ok")

    def close(self) -> None:
        """Frees the instance and unloads the library."""
        self.free_fmu_state(self._saved)
        self.free_instance()
        self.library.unload()
        self.callbacks.close()

    def free_instance(self) -> None:
        self.library.fmi2FreeInstance(self.handle)

    def calculated(self, p: Any) -> list[float] | None:
        """Returns the calculated parameters, at some inputs; None if the FMU refuses the parameters."""
        first = 1 + len(flatten(p))
        self._numbers[1:first] = flatten(p)
        numbers = self._numbers_after(_UNKNOWN_PARAMETERS, "fmi2ExitInitializationMode")
        return numbers and numbers[first : first + self._calculated]

    def reached(self, t: float, *arguments: Any) -> tuple[float, list[float], list[float]] | None:
        """Returns time [s], state and outputs after the initialization or a step; None if the FMU refuses it.

        arguments: those of the block's `initial_state` after t, or of its `step`
        """
        *step, u, p, c = arguments
        known = [t, *flatten(p), *flatten(c), *flatten(u)]
        self._numbers[: len(known)] = known
        call: tuple[Any, ...] = _AT_START, "fmi2ExitInitializationMode"
        if step:
            self._numbers[-self._states - 1 :] = [*flatten(step[1]), 0.0]
            call = _IN_STEPS, "fmi2DoStep", t, step[0], 1
        if (numbers := self._numbers_after(*call)) is None:
            return None
        return numbers[0], numbers[-self._states - 1 : -1], numbers[len(known) : self._variables]

    def _numbers_after(self, words: tuple[int, ...], function: str, *times: float) -> list[float] | None:
        self._words[:] = words
        self.set_fmu_state(self._saved)
        if self.status(function, *times) != OK:
            return None
        self.get_fmu_state(self._saved)
        return self._numbers[:]


# functions of FMI 3.0 by those of FMI 2.0 that stand for them
_FMI3 = {
    "fmi2ExitInitializationMode": ("fmi3ExitInitializationMode", [c_void_p]),
    "fmi2GetFMUstate": ("fmi3GetFMUState", [c_void_p] * 2),
    "fmi2SetFMUstate": ("fmi3SetFMUState", [c_void_p] * 2),
    "fmi2FreeFMUstate": ("fmi3FreeFMUState", [c_void_p] * 2),
    "fmi2DoStep": ("fmi3DoStep", [c_void_p, c_double, c_double, c_bool, *[c_void_p] * 4]),
    "fmi2FreeInstance": ("fmi3FreeInstance", [c_void_p]),
    "fmi2Instantiate": (
        "fmi3InstantiateCoSimulation",
        [*[c_void_p] * 3, *[c_bool] * 4, c_void_p, c_size_t, *[c_void_p] * 3],
    ),
}


class _Fmi3Functions(Library):
    """A loaded library of FMI 3.0; the functions are attributes by their names of FMI 2.0."""

    def __init__(self, path: Path) -> None:
        self._functions = ctypes.CDLL(str(path.resolve()))
        for name, (own, types) in _FMI3.items():
            function = getattr(self._functions, own)
            function.argtypes, function.restype = (
                types,
                c_void_p if name == "fmi2Instantiate" else ctypes.c_int,
            )
            setattr(self, name, function)


class ShippedFmi3Library(ShippedLibrary):
    """An instance of a library of FMI 3.0, likewise."""

    library_class = _Fmi3Functions

    def instantiate(self, name: str, guid: str, resources: Path, logging_on: bool) -> bool:
        off = (False, logging_on, False, False)
        address = self.library.fmi2Instantiate(
            name.encode(), guid.encode(), None, *off, None, 0, None, None, None
        )
        self.handle = c_void_p(address) if address else None
        return self.handle is not None

    def status(self, function: str, *arguments: Any) -> int:
        if function == "fmi2DoStep":
            results = (ctypes.byref(kind()) for kind in (c_bool, c_bool, c_bool, c_double))
            arguments = (*arguments, *results)
        return super().status(function, *arguments)
