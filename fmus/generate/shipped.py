"""The library of a native FMU, called with any parameters, inputs and state before the FMU is written."""

import ctypes
import tempfile
from pathlib import Path
from typing import Any

from fmus.block import Block
from fmus.block.scalars import flatten
from fmus.errors import ExportError
from fmus.fmi.binding import OK, BoundInstance, Library, status_name
from fmus.fmi.callbacks import Callbacks
from fmus.fmi.fmi3 import Fmi3Library
from fmus.generate.symbolic import traced

# the first words of `Data` in fmus/native/instance.h: mode, stale parameters, stale outputs, rates of inputs
_UNKNOWN_PARAMETERS, _AT_START, _IN_STEPS = (2, 1, 1, 0), (2, 0, 1, 0), (4, 0, 0, 0)


class ShippedLibrary(BoundInstance):
    """An instance of the library whose saved state is written in memory, as fmus/native/snapshot.h has it.

    fmi: the version of the standard
    """

    def __init__(self, block: Block, guid: str, content: bytes, fmi: int = 2) -> None:
        # Windows does not remove a library that is loaded
        with tempfile.TemporaryDirectory(prefix="l1-depth-build-", ignore_cleanup_errors=True) as folder:
            path = Path(folder) / "library"
            path.write_bytes(content)
            super().__init__(Fmi3Library(path) if fmi == 3 else Library(path), Callbacks())
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
