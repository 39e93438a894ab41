"""A native FMU whose instances step in groups: its equations compiled for vectors, and the memory of its groups."""

import ctypes
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from platformdirs import user_cache_path

from fmus import compiled_library
from fmus.errors import ExportError
from fmus.lanes import SOURCE, lane_sources
from orchestration.errors import EnsembleError
from orchestration.fmi.description import FileVersion

_MAGIC, _FORMAT, _HEAD = b"L1-STATE", 2, 52  # snapshot.h: magic, format and GUID
_FIRST_VALUE = 5  # word of `Data` in instance.h; those of the state are the last ones before the checksum
_ALIGNMENT = 64
_MOST_LIBRARIES = 64


class LaneLibrary:
    """lanes: instances of a group; variables, states: of an instance; words: of 8 bytes of a group

    internal_step: value reference of the parameter; step: address of the function that steps a group
    """

    def __init__(self, library: ctypes.CDLL) -> None:
        sizes = (ctypes.c_int64 * 5)()
        library.lanes_sizes(sizes)
        self.lanes, self.variables, self.states, n_bytes, self.internal_step = sizes
        self.words = n_bytes // 8
        self.step = ctypes.cast(library.lanes_step, ctypes.c_void_p).value or 0
        self._begin, self._change = library.lanes_begin, library.lanes_parameters_changed
        self._begin.argtypes = self._change.argtypes = [ctypes.c_void_p]
        self._begin.restype, self._change.restype = None, ctypes.c_int64

    def memory(self, groups: int) -> np.ndarray:
        """Zeros for so many groups, shape (groups, words), each at an address that vectors need."""
        memory = np.zeros(groups * self.words + _ALIGNMENT // 8)
        first = -memory.ctypes.data % _ALIGNMENT // 8
        return memory[first:][: groups * self.words].reshape(groups, self.words)

    def begin(self, memory: np.ndarray, initial: np.ndarray) -> None:
        """Write what instances begin with, and prepare the groups.

        initial: shape (groups * lanes, variables + states), of `initial_words`
        """
        count = self.variables + self.states
        lanes = initial.reshape(len(memory), self.lanes, count).swapaxes(1, 2)
        memory[:, : count * self.lanes] = lanes.reshape(len(memory), -1)
        for group in memory:
            self._begin(group.ctypes.data)

    def set(self, group: np.ndarray, variable: int, value: float) -> int:
        """Set a parameter or an input of all lanes of a group; the lanes that contradict themselves, as bits."""
        group[variable * self.lanes : (variable + 1) * self.lanes] = value
        return self._change(group.ctypes.data)

    def initial_words(self, state: bytes) -> np.ndarray:
        """Values and states of an instance, shape (variables + states,), from its serialised FMU state."""
        words = np.frombuffer(state, "<f8", offset=_HEAD, count=(len(state) - _HEAD) // 8)
        if not state.startswith(_MAGIC + bytes([_FORMAT])) or len(words) < self.variables + self.states:
            raise EnsembleError("a state of another version of l1-depth: build the FMU again")
        values = words[_FIRST_VALUE : _FIRST_VALUE + self.variables]
        return np.concatenate([values, words[-2 - self.states : -2]])


def lane_library(component: str, fmu: Path, instructions: str) -> LaneLibrary:
    """The library of an FMU, compiled at its first use and kept in the user's cache.

    Raises EnsembleError for an FMU that has no sources of this exporter, or if it cannot be compiled.
    """
    try:
        return _loaded(FileVersion.of(fmu), instructions)
    except (ExportError, OSError) as error:
        raise EnsembleError(f"{component}: no ensemble of {error}; Simulator runs it") from error


@lru_cache(_MOST_LIBRARIES)
def _loaded(fmu: FileVersion, instructions: str) -> LaneLibrary:
    options = [] if instructions == "portable" else [f"-mcpu={instructions.replace('-', '_')}"]
    with TemporaryDirectory(prefix="l1-depth-", ignore_cleanup_errors=True) as name:
        for file, text in lane_sources(fmu.path).items():
            Path(name, file).write_text(text, encoding="utf-8", newline="\n")
        return LaneLibrary(load_compiled(Path(name, SOURCE), options))


def load_compiled(source: Path, options: list[str]) -> ctypes.CDLL:
    """The library of a C source, from this user's cache if it is there."""
    return compiled_library.load(source, user_cache_path("l1-depth") / "libraries", options)
