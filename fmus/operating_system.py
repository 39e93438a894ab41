"""Processors, memory, processes and locks, which Linux, macOS and Windows handle differently.

No other module calls functions that some systems lack. Each call stands beside its substitute.
"""

import contextlib
import ctypes
import errno
import os
import signal
import stat
import sys
import threading
import time
from collections.abc import Collection
from pathlib import Path

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl
    import resource

CAN_WATCH = sys.platform == "linux"
"""Whether a process can wait for signals and for the end of a child at once."""
CAN_REMOVE_OPEN_FILES = sys.platform != "win32"
# not distrusted: this user can replace the program itself
_ROOT = 0
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_MOST_READERS = 1 << 20  # bytes of a lock in Windows: a process that shares it takes one of them
_WAIT_S = 0.02  # between two tries there


def usable_processors() -> int:
    """Returns the number of processors that this process may use: a container may have fewer."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def memory_size() -> int | None:
    """Returns the bytes of memory of this machine; None where Windows has no count of them."""
    if sys.platform == "win32":
        kilobytes = ctypes.c_ulonglong()
        is_counted = ctypes.windll.kernel32.GetPhysicallyInstalledSystemMemory(ctypes.byref(kilobytes))
        return 1024 * kilobytes.value if is_counted else None
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def foreign_threads() -> set[str]:
    """Returns the threads of this process that Python did not start; an empty set outside Linux."""
    # a thread of C that has called Python once is a dummy
    own = [thread for thread in threading.enumerate() if not isinstance(thread, threading._DummyThread)]
    return {task.name for task in Path("/proc/self/task").glob("*")} - {str(x.native_id) for x in own}


def allocate(descriptor: int, size: int) -> None:
    """Gives an empty file its size; OSError without room on the disk, which Linux reserves at once."""
    if sys.platform == "linux":
        os.posix_fallocate(descriptor, 0, size)
    else:
        os.ftruncate(descriptor, size)


def limit_process(memory: int, file_size: int) -> None:
    """Limits the memory [B] of this process and the size of its files, without core dumps; not in Windows."""
    if sys.platform != "win32":
        limits = (
            (resource.RLIMIT_DATA, memory),
            (resource.RLIMIT_FSIZE, file_size),
            (resource.RLIMIT_CORE, 0),
        )
        for kind, limit in limits:
            _, hard = resource.getrlimit(kind)
            bound = limit if hard == resource.RLIM_INFINITY else min(limit, hard)
            resource.setrlimit(kind, (bound, bound))


def kill_group(leader: int) -> None:
    """Kills the leader of a session and all processes of the session; in Windows the leader alone."""
    with contextlib.suppress(OSError):  # they have ended
        if sys.platform == "win32":
            # no process can handle this signal in Windows: it ends at once
            os.kill(leader, signal.SIGTERM)
        else:
            os.killpg(leader, signal.SIGKILL)


def lock(descriptor: int, shared: bool) -> None:
    """Locks a file; a shared lock waits for an exclusive one, which raises BlockingIOError at once."""
    if sys.platform != "win32":
        fcntl.flock(descriptor, fcntl.LOCK_SH if shared else fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    while True:
        # Windows has no shared lock: a reader locks one byte by chance, a writer all of them
        os.lseek(descriptor, int.from_bytes(os.urandom(8)) % _MOST_READERS if shared else 0, os.SEEK_SET)
        try:
            # LK_LOCK would wait for ten seconds at most
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1 if shared else _MOST_READERS)
            return
        except OSError as error:
            # of a lock of another process: EACCES in Windows, none in Wine
            if error.errno not in (errno.EACCES, 0):
                raise
            if not shared:
                raise BlockingIOError(*error.args) from None
        time.sleep(_WAIT_S)


def reason_for_distrust(status: os.stat_result) -> str:
    """Returns why others than the user and the administrator may have written a file; "" in Windows."""
    if sys.platform == "win32":
        return ""
    if status.st_uid not in (_ROOT, os.geteuid()):
        return "belongs to another user"
    return "can be written by other users" if status.st_mode & _WRITABLE_BY_OTHERS else ""


def fork(signals: Collection[int]) -> tuple[int, Collection[int]]:
    """Returns the number of a child process, 0 in the child, and the signals that were blocked before.

    In both, these signals and the end of a child are blocked. OSError if not `CAN_WATCH`.
    """
    if sys.platform != "linux":
        raise OSError("no child process: expected Linux")
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {*signals, signal.SIGCHLD})
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)  # where it is ignored, a child leaves no status
    return os.fork(), before


def block_alone(signals: Collection[int]) -> None:
    """Unblocks all signals except these."""
    if sys.platform != "win32":
        signal.pthread_sigmask(signal.SIG_SETMASK, signals)


def wait_for(child: int, signals: Collection[int]) -> int:
    """Returns the status of a child at its end: an exit code, or minus the number of a signal.

    Passes the blocked signals on to the child. A signal of the terminal reaches the child directly.
    """
    if sys.platform != "linux":
        raise OSError("no child process: expected Linux")
    while True:
        received = signal.sigwaitinfo({*signals, signal.SIGCHLD})
        if received.si_signo == signal.SIGCHLD:
            number, status = os.waitpid(child, os.WNOHANG)
            if number:
                return os.waitstatus_to_exitcode(status)
        # sent by a process; or by a terminal that the child has left, as an FMU may call setsid
        elif received.si_code <= 0 or os.getsid(child) != os.getsid(0):
            os.kill(child, received.si_signo)
