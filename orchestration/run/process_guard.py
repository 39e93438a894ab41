"""What an FMU changes in this process beside its own state is put back, or ends the run; an exit is told.

A child that an FMU forks ends where it returns from a call, and the run ends with an error.

After each call of an FMU the floating-point mode (rounding, denormals) is that of before. After each FMU is
loaded, after the initialisation and after each batch of steps, working directory, locale and handlers of
signals are compared and put back; a run whose FMU has closed files of this process ends, since nobody knows
which. In a run that the caller leads step by step, they are compared around one step in a millisecond, and
after the first change around each. What changes between two such steps may be the caller's own doing, and
stays; where other steps were in between, a warning names it. `exit` has status 70 at once; for `_exit` see
`fmus/fmi/parent_process.py`. FMUs in a process of their own (`timeout`) need none of this.

Of a system of native FMUs that this user built, which are known to change nothing, only the loading is
looked at, and the floating-point mode after calls outside the communication loop.
"""

import atexit
import ctypes
import locale
import mmap
import os
import signal
import threading
import warnings
from collections.abc import Iterable
from functools import cache

import numpy as np

from fmus.errors import ExportError
from fmus.fmi import parent_process
from fmus.fmi.process import CHILD_RETURNED
from orchestration.errors import FmuWarning, OrchestrationError
from orchestration.run.compiled_loop import library
from orchestration.run.loop_data import Report

_TEXT_SIZE, _MOST_RUNS = 256, 256  # as in process_guard.h
# those of process_guard.h: what ends programs, and SIGCHLD
_NAMES = ("HUP", "INT", "ILL", "ABRT", "FPE", "SEGV", "PIPE", "ALRM", "TERM", "CHLD")
_SIGNALS = [getattr(signal, f"SIG{name}") for name in _NAMES if hasattr(signal, f"SIG{name}")]
_forks = np.frombuffer(mmap.mmap(-1, 8), np.int64)  # children that returned; shared with them
_lock = threading.Lock()
_texts: dict[int, tuple[np.ndarray, bytes]] = {}  # what the rows of the table refer to


class ProcessGuard:
    """Guards this process while the FMUs of a simulator are loaded; `close` ends it.

    components: the FMUs that `report[BUSY]` counts from 1
    has_restored: whether FMUs have changed something
    """

    has_restored = False

    def __init__(self, components: Iterable[str], report: np.ndarray) -> None:
        names = [*components, "one of several FMUs"]
        ends = " ended the process (it called exit): the run is lost; with a timeout FMUs have their own\n"
        lines = [f"l1-depth: {name}".encode()[:100] + ends.encode() for name in names]
        texts = b"".join(line.ljust(_TEXT_SIZE, b"\0") for line in lines)
        with _lock:
            self._library = _library()
            runs = _runs() if self._library else np.zeros((0, 2), np.int64)
            free = np.flatnonzero(runs[:, 0] == 0)
            self._row = int(free[0]) if len(free) else -1
            if self._row >= 0:
                _texts[self._row] = report, texts
                runs[self._row] = report.ctypes.data, np.frombuffer(texts, np.uint8).ctypes.data
        parent_process.share_names(names)
        self.restore_float_mode = self._library.guard_restore_float_mode if self._library else lambda: 0
        self._own = _own_descriptor()  # closed by an FMU that closes all files
        self._files = {number: _identity(number) for number in (1, 2, self._own)}
        if self._library:
            self._library.guard_count_forks(ctypes.c_void_p(_forks.ctypes.data))
        self._forks = int(_forks[0])
        self.note_surroundings()
        self.note_handlers()

    def note_surroundings(self) -> None:
        """Note the present folder, locale and output files as those to compare with."""
        self._folder, self._locale = _working_directory(), locale.setlocale(locale.LC_ALL)
        for number in (1, 2):
            self._files[number] = _identity(number) or self._files[number]  # no caller closes them for good

    def changed_surroundings(self) -> list[str]:
        """What differs from what was noted."""
        changed = ["the locale"] if locale.setlocale(locale.LC_ALL) != self._locale else []
        changed += ["the working directory"] if _working_directory() != self._folder else []
        is_output_changed = any(_identity(n) not in (None, self._files[n]) for n in (1, 2))
        return changed + (["the output"] if is_output_changed else [])

    def note_handlers(self) -> None:
        """Note the present handlers of signals as those to put back."""
        self._handlers = {number: signal.getsignal(number) for number in _SIGNALS}
        if self._library:
            for number in _SIGNALS:
                self._library.guard_handler(number, 0)

    def restore(self, name: str) -> None:
        """Put back what the FMUs changed, and warn of it; name: of the FMU or FMUs that may have done so.

        OrchestrationError if they closed files, or forked the process and a child went on.
        """
        changed = ["the floating-point mode"] if self.restore_float_mode() else []
        if _forks[0] != self._forks:
            raise OrchestrationError(f"{name} forked its process{CHILD_RETURNED}")
        if locale.setlocale(locale.LC_ALL) != self._locale:
            locale.setlocale(locale.LC_ALL, self._locale)
            changed.append("the locale")
        if self._folder and _working_directory() != self._folder:
            os.chdir(self._folder)
            changed.append("the working directory")
        changed += [f"the handler of {signal.Signals(n).name}" for n in self._restored_handlers()]
        if changed:
            self.has_restored = True
            text = f"{name} changed {' and '.join(changed)} of this process: it is restored"
            warnings.warn(text, FmuWarning, stacklevel=3)
        if any(_identity(number) != file for number, file in self._files.items()):
            raise OrchestrationError(
                f"{name} closed files of this process: expected its own ones alone; "
                "with a timeout FMUs have a process of their own"
            )

    def _restored_handlers(self) -> list[int]:
        """The signals whose handlers the FMUs changed; one that Python changed meanwhile is left as it is."""
        if not self._library:
            return []
        changed, by_fmus = self._library.guard_changed_handlers(), []
        for number in [number for number in _SIGNALS if changed >> number & 1]:
            by_python = signal.getsignal(number) is not self._handlers[number]
            self._library.guard_handler(number, not by_python)
            by_fmus += [] if by_python else [number]
        return by_fmus

    def close(self) -> None:
        if self._row >= 0:
            with _lock:
                _runs()[self._row] = 0
                del _texts[self._row]
                self._row = -1
        own = self._files.pop(self._own, None)
        if own and _identity(self._own) == own:
            os.close(self._own)


def new_report() -> np.ndarray:
    """The report of a run, where the process that waits for this one can read which FMU is busy.

    That process reads one report: the run of another thread has memory of its own.
    """
    is_main = threading.current_thread() is threading.main_thread()
    memory = parent_process.report_memory(8 * len(Report)) if is_main else None
    report = np.zeros(len(Report), np.int64) if memory is None else np.frombuffer(memory, np.int64)
    report[:] = 0
    return report


@cache
def _library() -> ctypes.CDLL | None:
    try:
        loaded = library()
    except (ExportError, OSError):  # nothing is compiled
        return None
    loaded.guard_runs.restype = ctypes.POINTER(ctypes.c_int64)
    loaded.guard_changed_handlers.restype = ctypes.c_int64
    return loaded


@cache
def _runs() -> np.ndarray:
    """Addresses of the report and of the texts of each run in progress, a row each: the table in C."""
    guard = _library()
    assert guard
    runs = np.ctypeslib.as_array(guard.guard_runs(), (_MOST_RUNS, 2))
    atexit.register(runs.fill, 0)  # from then on the process ends by itself
    return runs


def _own_descriptor() -> int:
    """An open file like no other: should an FMU close it, its number may become that of somebody else's."""
    own, other_end = os.pipe()
    os.close(other_end)
    return own


def _identity(descriptor: int) -> tuple[int, int] | None:
    """What tells an open file from others; None if it is not open."""
    try:
        status = os.fstat(descriptor)
    except OSError:
        return None
    return status.st_dev, status.st_ino


def _working_directory() -> str | None:
    try:
        return os.getcwd()  # noqa: PTH109  quicker, and it is asked for after each batch of steps
    except OSError:  # it was removed
        return None
