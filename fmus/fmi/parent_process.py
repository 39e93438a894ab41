"""A program in a process that another one waits for, which reports an end that the program did not decide.

An FMU can end the process that it runs in, with status 0 (`_exit(0)`) or by a crash, and nothing in that
process can report it then. So the command line runs in a child process. Both share memory: which FMU is
busy, and the names. On macOS and Windows there is no child: Python cannot wait there for signals and a
process at once.
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
# the first byte: 1 where the program has ended, 2 where its results are written
_REPORT, _FOLDER, _NAMES, _NAME_SIZE, _PAGE = 64, 4096, 8192, 128, 1 << 17
_BUSY = 5  # the number in a report that is that of the busy FMU: `orchestration/run/loop_data.py`

_page: mmap.mmap | None = None


def run_watched(program: Callable[[], int]) -> int:
    """Returns the exit status of a program, which runs in a child process where the platform allows that.

    Where the child ends before the program does, the status is not 0, and a line on standard error tells why.
    The child receives interrupts as it would without this process, and one when this process is killed.
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
    """Ends this process, but does not free each imported object, which takes a fifth of a short command.

    Functions that were registered for the end are called before. Does nothing while other threads are at
    work, and where output cannot be written: the interpreter then ends as it always does.
    """
    others = set(threading.enumerate()) - {threading.current_thread()}
    if all(thread.daemon for thread in others):
        atexit._run_exitfuncs()  # private, but the only way to call them before `os._exit`
        with suppress(OSError, ValueError):
            for stream in filter(None, (sys.stdout, sys.stderr)):  # None where they were closed: >&-
                stream.flush()
            if "ctypes" in sys.modules:  # which loads FMUs: what their C code has printed is not lost
                sys.modules["ctypes"].CDLL(None).fflush(None)
            os._exit(status)


def end_is_meant() -> None:
    """Notes that the process means to end: its exit status is then taken as it is."""
    if _page:
        _page[0] = 1


def results_are_written() -> None:
    """Notes that an end which is not meant loses nothing any more."""
    if _page:
        _page[0] = 2


def share_temporary_folder(folder: str) -> None:
    """Lets the process that waits for this one remove a folder where this one cannot."""
    if _page:
        content = folder.encode()
        _page[_FOLDER : _FOLDER + len(content)] = content


def share_names(names: Iterable[str]) -> None:
    """Lets the process that waits for this one know the FMUs, in the order in which a report counts them."""
    if _page:
        texts = [name.encode()[:_NAME_SIZE].ljust(_NAME_SIZE, b"\0") for name in names]
        content = b"".join(texts)[: _PAGE - _NAMES]
        _page[_NAMES : _NAMES + len(content)] = content


def report_memory(size: int) -> memoryview | None:
    """Returns memory for the report of a run, shared with the process that waits for this one, if any."""
    return memoryview(_page)[_REPORT : _REPORT + size] if _page else None


def _interrupt_without_parent(lifeline: int) -> None:
    """Waits until the other process is killed, which closes its end, and interrupts this one."""
    with suppress(OSError):  # an FMU has closed it
        os.read(lifeline, 1)
        os.kill(os.getpid(), signal.SIGTERM)


def _exit_status(status: int, page: mmap.mmap) -> int:
    """Returns the exit status for the child's; prints a line on standard error if its end was not meant."""
    if page[0] == 1:
        return status if status >= 0 else 128 - status
    folder = _text(page, _FOLDER, _NAMES - _FOLDER)
    if folder:
        import shutil

        shutil.rmtree(folder, ignore_errors=True)
    loss = "the files of the run are written" if page[0] else "the run is lost"
    if status == UNEXPECTED_END:  # an FMU called exit: `process_guard.h` has told that
        print(f"l1-depth: {loss}", file=sys.stderr)
        return status
    if -status in _INTERRUPTS:
        print("l1-depth: interrupted", file=sys.stderr)
        return 130
    (busy,) = struct.unpack_from("=q", page, _REPORT + 8 * _BUSY)
    name = _text(page, _NAMES + _NAME_SIZE * (abs(busy) - 1), _NAME_SIZE) if busy else ""
    from fmus.fmi.process import ending  # whose imports no other end needs

    print(
        f"l1-depth: {name or 'something'} ended the process with {ending(status)}: {loss}; "
        "with --timeout FMUs have a process of their own",
        file=sys.stderr,
    )
    return 128 - status if status < 0 else UNEXPECTED_END


def _text(page: mmap.mmap, start: int, size: int) -> str:
    return page[start : start + size].rstrip(b"\0").decode("utf-8", "replace")
