"""The process of a run: interrupts, floating-point mode, an end by `exit`, children that an FMU forks.

An interrupt waits for the end of a step: inside an FMU it would look like the FMU's own failure.

After each call of an FMU the floating-point mode (rounding, denormals) is restored. An FMU that calls
`exit` is named, and the status is 70; for `_exit` and crashes see `fmus/fmi/parent_process.py`. A child that
an FMU forks ends where it returns from a call, and the run ends with an error.
Whatever else FMUs change in this process stays: locale, environment, handlers of signals, open files. With a
`timeout` they have a process of their own.

Of a system of native FMUs that this user built, which are known to change nothing, the mode is looked at
after calls outside the communication loop alone.
"""

import atexit
import ctypes
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache, partial

import numpy as np

from fmus.fmi import parent_process
from fmus.fmi.process import CHILD_RETURNED
from orchestration.errors import FmuWarning, OrchestrationError
from orchestration.run.compiled_loop import library
from orchestration.run.loop_data import Report

_TEXT_SIZE, _MOST_RUNS = 256, 256  # as in process_guard.h
_lock = threading.Lock()
# keeps alive the memory to which the rows of the table in C refer
_texts: dict[int, tuple[np.ndarray, bytes]] = {}


class ProcessGuard:
    """Guards this process while the FMUs of a simulator are loaded; `close` ends it.

    components: the FMUs that `report[BUSY]` counts from 1
    """

    def __init__(self, components: Iterable[str], report: np.ndarray) -> None:
        names = [*components, "one of several FMUs"]
        ends = " ended the process (it called exit); with a timeout FMUs have a process of their own\n"
        lines = [f"l1-depth: {name}".encode()[:100] + ends.encode() for name in names]
        texts = b"".join(line.ljust(_TEXT_SIZE, b"\0") for line in lines)
        with _lock:
            runs = _runs()
            free = np.flatnonzero(runs[:, 0] == 0)
            self._row = int(free[0]) if len(free) else -1
            if self._row >= 0:
                _texts[self._row] = report, texts
                runs[self._row] = report.ctypes.data, np.frombuffer(texts, np.uint8).ctypes.data
        parent_process.share_names(names)
        library().guard_forget_forks()
        self._report = report
        self.end_call = partial(library().guard_end_call, report.ctypes.data_as(ctypes.c_void_p))

    def restore(self, name: str) -> None:
        """Puts the floating-point mode back, with a warning if it was changed.

        name: of the FMUs that may have done so
        Raises OrchestrationError if an FMU forked the process and a child went on.
        """
        if self.end_call():
            text = f"{name} changed the floating-point mode of this process: it is restored"
            warnings.warn(text, FmuWarning, stacklevel=3)
        if self._report[Report.FORKED]:
            raise OrchestrationError(f"{name} forked its process{CHILD_RETURNED}")

    def close(self) -> None:
        if self._row >= 0:
            with _lock:
                _runs()[self._row] = 0
                del _texts[self._row]
                self._row = -1


def new_report() -> np.ndarray:
    """Returns the report of a run, where the process that waits for this one can read which FMU is busy.

    That process reads one report: the run of another thread has separate memory.
    """
    is_main = threading.current_thread() is threading.main_thread()
    memory = parent_process.report_memory(8 * len(Report)) if is_main else None
    report = np.zeros(len(Report), np.int64) if memory is None else np.frombuffer(memory, np.int64)
    report[:] = 0
    return report


@cache
def _runs() -> np.ndarray:
    """Returns the table in C, a row for each run in progress: addresses of its report and its texts."""
    guard = library()
    guard.guard_runs.restype = ctypes.POINTER(ctypes.c_int64)
    runs = np.ctypeslib.as_array(guard.guard_runs(), (_MOST_RUNS, 2))
    # from then on the process ends in order: the handler in C must not report an `exit` of an FMU
    atexit.register(runs.fill, 0)
    return runs


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], None]]:
    """Keeps an interrupt until the yielded function is called: it must not strike inside an FMU."""
    with kept_interrupts() as received:

        def check_interrupt() -> None:
            if received:
                raise KeyboardInterrupt

        yield check_interrupt
    # an interrupt may have come after the last check
    check_interrupt()


class _InterruptTimes(list[float]):
    """A handler of SIGINT that only records the times [s of time.monotonic] of interrupts."""

    def __call__(self, number: int, frame: object) -> None:
        self.append(time.monotonic())


@contextmanager
def kept_interrupts() -> Iterator[list[float]]:
    """Interrupts only leave their time [s of time.monotonic] in the list given.

    Inside another such context the list is the outer one's, with the interrupts that came before.
    Outside the main thread, which receives no interrupts, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield []
        return
    before = signal.getsignal(signal.SIGINT)
    if isinstance(before, _InterruptTimes):
        yield before
        return
    times = _InterruptTimes()
    signal.signal(signal.SIGINT, times)
    try:
        yield times
    finally:
        signal.signal(signal.SIGINT, before)
