"""What an FMU changes in this process beside its own state is put back, and an exit of the process is told.

After each call of an FMU the floating-point mode (rounding, denormals) is that of before. Working directory
and locale are compared after each FMU is loaded and after each batch of steps.
What an FMU does in no process but its own (`timeout`) needs none of this.
"""

import atexit
import locale
import os
import threading
import warnings
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import numpy as np

from fmus.errors import ExportError
from orchestration.errors import FmuWarning
from orchestration.master.compiled_loop import guarded_runs, library

_TEXT_SIZE = 256  # bytes, as in loop.c
_lock = threading.Lock()
_texts: dict[int, tuple[np.ndarray, bytes]] = {}  # what the rows of the table refer to


class ProcessGuard:
    """Guards this process while the FMUs of a simulator are loaded; `close` ends it.

    components: the FMUs that `report[BUSY]` counts from 1
    """

    def __init__(self, components: Iterable[str], report: np.ndarray) -> None:
        ends = " ended the process (it called exit): the run is lost; with a timeout FMUs have their own\n"
        lines = [f"l1-depth: {name}".encode()[:100] + ends.encode() for name in components]
        texts = b"".join(line.ljust(_TEXT_SIZE, b"\0") for line in lines)
        try:
            self._runs = _runs()
            self.restore_float_mode = library().loop_restore_float_mode
        except (ExportError, OSError):  # nothing is compiled
            self._runs = np.zeros((0, 2), np.int64)
            self.restore_float_mode = lambda: 0
        with _lock:
            free = np.flatnonzero(self._runs[:, 0] == 0)
            self._row = int(free[0]) if len(free) else -1
            if self._row >= 0:
                _texts[self._row] = report, texts
                self._runs[self._row] = report.ctypes.data, np.frombuffer(texts, np.uint8).ctypes.data
        self._folder, self._locale = _working_directory(), locale.setlocale(locale.LC_ALL)

    def restore(self, name: str) -> None:
        """Put back what the FMUs changed, and warn of it; name: of the FMU or FMUs that may have done so."""
        changed = ["the floating-point mode"] if self.restore_float_mode() else []
        if locale.setlocale(locale.LC_ALL) != self._locale:
            locale.setlocale(locale.LC_ALL, self._locale)
            changed.append("the locale")
        if self._folder and _working_directory() != self._folder:
            os.chdir(self._folder)
            changed.append("the working directory")
        if changed:
            text = f"{name} changed {' and '.join(changed)} of this process: it is restored"
            warnings.warn(text, FmuWarning, stacklevel=3)

    def close(self) -> None:
        if self._row >= 0:
            with _lock:
                self._runs[self._row] = 0
                del _texts[self._row]
                self._row = -1


@cache
def _runs() -> np.ndarray:
    runs = guarded_runs()
    atexit.register(runs.fill, 0)  # from then on the process ends by itself
    return runs


def _working_directory() -> Path | None:
    try:
        return Path.cwd()
    except OSError:  # it was removed
        return None
