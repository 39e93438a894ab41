"""A program in a child process, whose parent reports an end that the program did not decide.

An FMU can end the process that it runs in, with status 0 (`_exit(0)`) or by a crash, and this process cannot
report it. So the command line runs in a child process. Both processes share memory, with the names of the
FMUs and the busy one. On macOS and Windows there is no child: Python cannot wait there for signals and a
process at the same time.
"""

import _thread
import atexit
import mmap
import os
import signal
import struct
import sys
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress

from fmus import operating_system

UNEXPECTED_END = 70
_INTERRUPTS = {signal.SIGINT, signal.SIGTERM, getattr(signal, "SIGHUP", signal.SIGINT)}
# the first byte: 1 if the program has ended, 2 if its results are written
_REPORT, _FOLDER, _NAMES, _NAME_SIZE, _PAGE = 64, 4096, 8192, 128, 1 << 17
# place of the number of the busy FMU in a report: `orchestration/run/loop_data.py`
_BUSY = 5

_page: mmap.mmap | None = None


def run_watched(program: Callable[[], int]) -> int:
    """Returns the exit status of a program; it runs in a child process if the platform allows it.

    If the child ends before the program does, the status is not 0, and standard error has the reason. The
    child receives interrupts as it would without this process, and one when this process is killed.
    """
    if not operating_system.CAN_WATCH:
        return program()
    global _page  # noqa: PLW0603
    _page = mmap.mmap(-1, _PAGE)
    lifeline, end = os.pipe()
    child, blocked = operating_system.fork(_INTERRUPTS)
    if child:
        os.close(lifeline)
        status = _exit_status(operating_system.wait_for(child, _INTERRUPTS), _page)
        _end_without_clearing_up(status)
        return status
    os.close(end)
    _thread.start_new_thread(_interrupt_without_parent, (lifeline,))
    try:
        operating_system.block_alone(blocked)
        status = program()
    finally:
        end_is_meant()
    _end_without_clearing_up(status)
    return status


def _end_without_clearing_up(status: int) -> None:
    """Ends this process after the functions that are registered for the end.

    Does nothing while other threads work, and if output cannot be written: Python then ends as usual.
    """
    # To free each imported object, as the interpreter does, takes a fifth of the time of a short command.
    others = set(threading.enumerate()) - {threading.current_thread()}
    if all(thread.daemon for thread in others):
        # private, but the only way to call them before `os._exit`
        atexit._run_exitfuncs()
        with suppress(OSError, ValueError):
            # a closed stream (>&-) has the value None
            for stream in filter(None, (sys.stdout, sys.stderr)):
                stream.flush()
            # ctypes loads FMUs: the output of their C code may stand in a buffer of C
            if "ctypes" in sys.modules:
                sys.modules["ctypes"].CDLL(None).fflush(None)
            os._exit(status)


def end_is_meant() -> None:
    """Notes that the process means to end: its exit status is then taken as it is."""
    if _page:
        _page[0] = 1


def results_are_written() -> None:
    """Notes that the results are safe, even if the process ends too early."""
    if _page:
        _page[0] = 2


def share_temporary_folder(folder: str) -> None:
    """Names a folder that the parent process removes if this one cannot."""
    if _page:
        content = folder.encode()
        _page[_FOLDER : _FOLDER + len(content)] = content


def share_names(names: Iterable[str]) -> None:
    """Gives the names of the FMUs to the parent process, in the order of their numbers in a report."""
    if _page:
        texts = [name.encode()[:_NAME_SIZE].ljust(_NAME_SIZE, b"\0") for name in names]
        content = b"".join(texts)[: _PAGE - _NAMES]
        _page[_NAMES : _NAMES + len(content)] = content


def report_memory(size: int) -> memoryview | None:
    """Returns memory for the report of a run that is shared with the parent process, or None without one."""
    return memoryview(_page)[_REPORT : _REPORT + size] if _page else None


def _interrupt_without_parent(lifeline: int) -> None:
    """Waits until the parent process ends, which closes its end of the pipe, and interrupts this one."""
    # an FMU may have closed the pipe
    with suppress(OSError):
        os.read(lifeline, 1)
        os.kill(os.getpid(), signal.SIGTERM)


def _exit_status(status: int, page: mmap.mmap) -> int:
    """Returns the exit status for the child's; prints a line on standard error for an unexpected end."""
    if page[0] == 1:
        return status if status >= 0 else 128 - status
    folder = _text(page, _FOLDER, _NAMES - _FOLDER)
    if folder:
        import shutil

        shutil.rmtree(folder, ignore_errors=True)
    loss = "the files of the run are written" if page[0] else "the run is lost"
    # an FMU called exit: `process_guard.h` has reported it
    if status == UNEXPECTED_END:
        print(f"l1-depth: {loss}", file=sys.stderr)
        return status
    if -status in _INTERRUPTS:
        print("l1-depth: interrupted", file=sys.stderr)
        return 130
    (busy,) = struct.unpack_from("=q", page, _REPORT + 8 * _BUSY)
    name = _text(page, _NAMES + _NAME_SIZE * (abs(busy) - 1), _NAME_SIZE) if busy else ""
    # no other end of a program needs the imports of this module
    from fmus.fmi.process import ending

    print(
        f"l1-depth: {name or 'something'} ended the process with {ending(status)}: {loss}; "
        "with --timeout FMUs have a process of their own",
        file=sys.stderr,
    )
    return 128 - status if status < 0 else UNEXPECTED_END


def _text(page: mmap.mmap, start: int, size: int) -> str:
    return page[start : start + size].rstrip(b"\0").decode("utf-8", "replace")
