"""A native FMU whose instances step in groups: its equations for vectors, and the memory of the groups."""

import ctypes
import math
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fmus.errors import ExportError
from fmus.fmi.description import FileVersion
from fmus.native import compiled_library
from fmus.native.lanes import LANES, SOURCE, lane_sources
from orchestration.errors import EnsembleError

_MAGIC, _FORMAT, _GUID, _HEAD = b"L1-STATE", 2, 16, 52  # snapshot.h: magic, format, then the GUID
_FIRST_VALUE = 5  # word of `Data` in instance.h
_MOST_LIBRARIES = 64


class LaneLibrary:
    """variables, states: how many an instance has; words: of 8 bytes, of a group

    internal_step: value reference of the parameter; step: address of the function that steps a group
    wholes: how many Reals take whole numbers alone, as in FMUs of Reals only
    """

    def __init__(self, library: ctypes.CDLL) -> None:
        sizes = (ctypes.c_int64 * 5)()
        library.lanes_sizes(sizes)
        self.variables, self.states, n_bytes, self.internal_step, self.wholes = sizes
        self.words = n_bytes // 8
        library.lanes_guid.restype = ctypes.c_char_p
        self._guid: bytes = library.lanes_guid()
        self.step = ctypes.cast(library.lanes_step, ctypes.c_void_p).value or 0
        self._clear, self._change = library.lanes_clear, library.lanes_parameters_changed
        self._initialize = library.lanes_initialize
        self._clear.argtypes = self._change.argtypes = [ctypes.c_void_p]
        self._initialize.argtypes = [ctypes.c_void_p, ctypes.c_double]
        self._clear.restype = self._change.restype = None
        self._initialize.restype = ctypes.c_int64

    def memory(self, groups: int, values: np.ndarray) -> np.ndarray:
        """Memory of so many groups, shape (groups, words).

        values: of the variables by value reference, those of every instance
        """
        memory = aligned(groups, self.words)
        memory[:] = 0.0
        memory[:, : self.variables * LANES] = np.repeat(values, LANES)
        for group in memory:
            self._clear(group.ctypes.data)
        return memory

    def parameters_changed(self, group: np.ndarray) -> None:
        """Parameters were written: the next step begins with what follows from them."""
        self._change(group.ctypes.data)

    def initialise(self, group: np.ndarray, time: float) -> int:
        """Compute states and outputs at the start time [s]; the lanes that are refused, as bits."""
        return self._initialize(group.ctypes.data, time)

    def values(self, state: bytes) -> np.ndarray:
        """The variables of an instance by value reference, from its serialised FMU state."""
        words = np.frombuffer(state, "<f8", offset=_HEAD, count=(len(state) - _HEAD) // 8)
        if not state.startswith(_MAGIC + bytes([_FORMAT])) or len(words) < self.variables + self.states:
            raise EnsembleError("a state of another version of l1-depth: build the FMU again")
        if state[_GUID:_HEAD] != self._guid:
            raise EnsembleError("the FMU was built again: expected a new Ensemble of it")
        return words[_FIRST_VALUE : _FIRST_VALUE + self.variables]


def aligned(*shape: int) -> np.ndarray:
    """An array at an address that vectors need, of any values."""
    memory, count = np.empty(math.prod(shape) + LANES), math.prod(shape)
    first = -memory.ctypes.data % (8 * LANES) // 8
    return memory[first : first + count].reshape(shape)


def lane_library(component: str, fmu: Path, instructions: str) -> LaneLibrary:
    """The library of an FMU, compiled at its first use and kept in the user's cache.

    Raises EnsembleError for an FMU that has no sources of this exporter, or if it cannot be compiled.
    """
    try:
        return _loaded(FileVersion.of(fmu), instructions)
    except (ExportError, OSError) as error:
        raise EnsembleError(f"{component}: no ensemble of {error}; Simulator runs it") from error


def is_compiled(fmu: Path, instructions: str) -> bool:
    """Whether the library of an FMU is in the user's cache; not that of an FMU that can have none."""
    try:
        with _written_source(fmu) as source:
            return compiled_library.is_compiled(source, _options(instructions))
    except (ExportError, OSError):
        return False


@lru_cache(_MOST_LIBRARIES)
def _loaded(fmu: FileVersion, instructions: str) -> LaneLibrary:
    with _written_source(fmu.path) as source:
        return LaneLibrary(load_compiled(source, instructions))


@contextmanager
def _written_source(fmu: Path) -> Iterator[Path]:
    """The C source of the library of an FMU, in a folder with its headers while the context lasts."""
    with TemporaryDirectory(prefix="l1-depth-", ignore_cleanup_errors=True) as name:
        for file, text in lane_sources(fmu).items():
            Path(name, file).write_text(text, encoding="utf-8", newline="\n")
        yield Path(name, SOURCE)


def load_compiled(source: Path, instructions: str) -> ctypes.CDLL:
    """The library of a C source for groups of instances, from this user's cache if it is there."""
    return compiled_library.load(source, _options(instructions))


def _options(instructions: str) -> list[str]:
    machine = [] if instructions == "portable" else [f"-mcpu={instructions.replace('-', '_')}"]
    return [f"-DLANES={LANES}", *machine]
