"""A native FMU whose instances step in groups: its equations for vectors, and the memory of the groups.

The equations are a file of the FMU, which its exporter writes beside the files of its library.
"""

import ctypes
import math
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from importlib import resources
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fmus.errors import ExportError
from fmus.fmi.description import FileVersion
from fmus.native import compiled_library
from orchestration.errors import EnsembleError

LANES = 8
"""Instances of a group: a vector of as many doubles is one register of some processors, two of others."""
_SOURCE, _HEADERS = "lanes.c", ("lane_functions.h", "lane_sine.h")
_OF_FMU = ("variables.h", "model.h", "model_lanes.h")
_MAGIC, _FORMAT, _GUID, _HEAD = b"L1-STATE", 3, 16, 52  # snapshot.h: magic, format, then the GUID
FIRST_VALUE = 5  # word of `Data` in instance.h
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
        """Returns memory of so many groups, shape (groups, words).

        values: of the variables by value reference, for every instance
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
        """Computes states and outputs at the start time [s]; the lanes that are refused, as bits."""
        return self._initialize(group.ctypes.data, time)

    def values(self, state: bytes) -> np.ndarray:
        """Returns the variables of an instance by value reference, from its serialised FMU state."""
        return data_words(state, self._guid, self.variables + self.states)[FIRST_VALUE:][: self.variables]


def data_words(state: bytes, guid: bytes, least: int) -> np.ndarray:
    """Returns `Data` of instance.h, of so many words at least, from a serialised FMU state."""
    words = np.frombuffer(state, "<f8", offset=_HEAD, count=(len(state) - _HEAD) // 8)
    if not state.startswith(_MAGIC + bytes([_FORMAT])) or len(words) < least:
        raise EnsembleError("a state of another version of l1-depth: build the FMU again")
    if state[_GUID:_HEAD] != guid:
        raise EnsembleError("the FMU was built again: expected a new Ensemble of it")
    return words


def aligned(*shape: int) -> np.ndarray:
    """Returns an array at an address that vectors need, of any values."""
    memory, count = np.empty(math.prod(shape) + LANES), math.prod(shape)
    first = -memory.ctypes.data % (8 * LANES) // 8
    return memory[first : first + count].reshape(shape)


def lane_library(component: str, fmu: Path, instructions: str) -> LaneLibrary:
    """Returns the library of an FMU, compiled at its first use and kept in the user's cache.

    Raises EnsembleError for an FMU without equations for vectors, or if they cannot be compiled.
    """
    with _named(component):
        return _loaded(FileVersion.of(fmu), instructions)


def is_compiled(component: str, fmu: Path, instructions: str) -> bool:
    """Whether the library of an FMU is in the user's cache; EnsembleError for an FMU that can have none."""
    with _named(component), _written_source(fmu) as source:
        return compiled_library.is_compiled(source, _options(instructions))


@contextmanager
def _named(component: str) -> Iterator[None]:
    """Raises EnsembleError of a component in place of what its file or the compiler raises."""
    try:
        yield
    except (ExportError, OSError) as error:
        raise EnsembleError(f"{component}: no ensemble of {error}; Simulator runs it") from error


@lru_cache(_MOST_LIBRARIES)
def _loaded(fmu: FileVersion, instructions: str) -> LaneLibrary:
    with _written_source(fmu.path) as source:
        return LaneLibrary(load_compiled(source, instructions))


@contextmanager
def _written_source(fmu: Path) -> Iterator[Path]:
    """Yields the C source of the library of an FMU, in a folder with its headers while the context lasts.

    Raises ExportError for an FMU that has no such headers.
    """
    with (
        TemporaryDirectory(prefix="l1-depth-", ignore_cleanup_errors=True) as name,
        zipfile.ZipFile(fmu) as archive,
    ):
        if missing := {f"sources/{file}" for file in _OF_FMU} - {*archive.namelist()}:
            files = ", ".join(sorted(missing))
            raise ExportError(f"{fmu}, which has no {files}: build it again with this version of l1-depth")
        for file in _OF_FMU:
            Path(name, file).write_bytes(archive.read(f"sources/{file}"))
        for file in (_SOURCE, *_HEADERS):
            Path(name, file).write_bytes((resources.files("fmus.native") / "vectors" / file).read_bytes())
        yield Path(name, _SOURCE)


def load_compiled(source: Path, instructions: str) -> ctypes.CDLL:
    """Returns the library of a C source for groups of instances, from this user's cache if it is there."""
    return compiled_library.load(source, _options(instructions))


def _options(instructions: str) -> list[str]:
    machine = [] if instructions == "portable" else [f"-mcpu={instructions.replace('-', '_')}"]
    return [f"-DLANES={LANES}", *machine]
