"""Settings and resources of this process that an FMU could change: read around its calls, and set back."""

import ctypes
import gc
import os
import platform
import signal
from contextlib import suppress
from pathlib import Path
from typing import Any

try:
    import resource
except ImportError:  # of Windows
    resource: Any = None

_LC_ALL = 6  # of glibc, musl; other C libraries have another number, and then no locale is compared
_SIGNAL_LINES = ("SigIgn", "SigCgt")
_NOTED = (
    "signal handlers",
    "signal mask",
    "environment",
    "standard streams",
    "timers",
    "limits",
    "priority",
    "processors",
)
_STREAMS = (0, 1, 2)  # file descriptors
_SELF = Path("/proc/self")
_LIMITS = sorted({getattr(resource, name) for name in dir(resource) if name.startswith("RLIMIT_")})
_processors = getattr(os, "sched_getaffinity", lambda _: ())  # those that a process may run on: of Linux


def _stream(number: int) -> str:
    """Returns the stream to which a file descriptor leads."""
    try:
        status = os.fstat(number)
    except OSError:
        return "closed"
    return f"{status.st_dev}:{status.st_ino}"


class MallocInformation(ctypes.Structure):
    """`struct mallinfo2` of glibc."""

    _fields_ = tuple(
        (name, ctypes.c_size_t)
        for name in [
            "arena",
            "ordblks",
            "smblks",
            "hblks",
            "hblkhd",
            "usmblks",
            "fsmblks",
            "uordblks",
            "fordblks",
            "keepcost",
        ]
    )


def _function(library: Any, name: str, result: Any = ctypes.c_int, *arguments: Any) -> Any:
    function = getattr(library, name, None)
    if function is not None:
        function.restype, function.argtypes = result, list(arguments)
    return function


class ProcessSettings:
    """Settings of this process in the C library and the operating system, against what they were at first."""

    def __init__(self) -> None:
        linux = _SELF.is_dir()
        library: Any = ctypes.CDLL(None) if os.name == "posix" else None
        mathematics: Any = None
        with suppress(OSError):
            mathematics = ctypes.CDLL("libm.so.6") if linux else library
        self._flush = _function(library, "fflush", ctypes.c_int, ctypes.c_void_p)
        self._locale = _function(library, "setlocale", ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p)
        self._locale = self._locale if linux else None
        self._rounding = _function(mathematics, "fegetround")
        self._set_rounding = _function(mathematics, "fesetround", ctypes.c_int, ctypes.c_int)
        self._traps = _function(mathematics, "fegetexcept") if linux else None
        self._set_traps = _function(mathematics, "fedisableexcept", ctypes.c_int, ctypes.c_int)
        x87 = mathematics if linux and platform.machine() == "x86_64" else None
        self._get_environment = _function(x87, "fegetenv", ctypes.c_int, ctypes.c_char_p)
        self._set_environment = _function(x87, "fesetenv", ctypes.c_int, ctypes.c_char_p)
        self._x87, self._first_x87 = (ctypes.create_string_buffer(64) for _ in range(2))
        if self._get_environment is not None:
            self._get_environment(self._first_x87)
        self._environment: Any = None
        self._first_environment: frozenset[bytes] | None = None
        with suppress(ValueError):
            self._environment = ctypes.POINTER(ctypes.c_char_p).in_dll(library, "environ") if linux else None
        self._heap = _function(library, "mallinfo2", MallocInformation) if linux else None
        self._process, self._floating_point = self._process_now(), self._floating_point_now()

    def flush(self) -> None:
        """Lets what was printed leave the buffers of the C library."""
        if self._flush is not None:
            self._flush(None)

    def _floating_point_now(self) -> tuple[int, int, bool, str]:
        """Returns rounding mode, trapped exceptions, whether numbers near zero are kept, x87 control word."""
        rounding = self._rounding() if self._rounding is not None else 0
        traps = self._traps() if self._traps is not None else 0
        return rounding, traps, float.fromhex("0x1p-1022") / _TWO != 0.0, self._control_word()

    def _control_word(self) -> str:
        """Returns the control word of the x87, where there is one: its precision."""
        if self._get_environment is None:
            return ""
        self._get_environment(self._x87)
        return self._x87.raw[:2].hex()

    def floating_point_differs(self) -> bool:
        """Whether the control of floating point is another than when this was made."""
        return self._floating_point_now() != self._floating_point

    def changed(self) -> list[list[str]]:
        """Returns [setting, before, after] of those changed since this was made, or noticed last."""
        now, rows = self._floating_point_now(), []
        self.restore_floating_point()
        if now != self._floating_point:
            rows.append(["floating-point control", str(self._floating_point), str(now)])
        after = self._process_now()
        rows += [[name, value, after[name]] for name, value in self._process.items() if after[name] != value]
        self._process |= {name: after[name] for name in _NOTED if name in after}  # they stay as they are
        return rows

    def restore(self) -> None:
        """Sets back what can be."""
        self.restore_floating_point()
        self._restore_process()

    def restore_floating_point(self) -> None:
        """Sets back rounding mode and traps."""
        rounding, traps, *_ = self._floating_point
        if self._set_rounding is not None:
            self._set_rounding(rounding)
        if self._set_traps is not None:
            self._set_traps(~traps & 0x3D)
        if self._set_environment is not None and self._control_word() != self._floating_point[3]:
            self._set_environment(self._first_x87)

    def _process_now(self) -> dict[str, str]:
        """Settings by name."""
        settings = {"working directory": str(Path.cwd()), "signal handlers": ""}
        umask = os.umask(0)
        os.umask(umask)
        settings["file mode mask"] = oct(umask)
        if self._locale is not None:
            settings["locale"] = (self._locale(_LC_ALL, None) or b"").decode("utf-8", "replace")
        with suppress(OSError):
            lines = dict(line.split(":", 1) for line in (_SELF / "status").read_text().splitlines())
            settings["signal handlers"] = " ".join(lines[name].strip() for name in _SIGNAL_LINES)
            settings["signal mask"] = lines["SigBlk"].strip()
        return settings | self._shared_now()

    def _shared_now(self) -> dict[str, str]:
        """Settings that all of the process shares, where the operating system has them."""
        if os.name != "posix":
            return {}
        return {
            "environment": self._environment_now(),
            "standard streams": " ".join(map(_stream, _STREAMS)),
            "timers": " ".join(
                str(signal.getitimer(kind)[0] > 0.0) for kind in (signal.ITIMER_REAL, signal.ITIMER_VIRTUAL)
            ),
            "limits": " ".join(str(resource.getrlimit(kind)) for kind in _LIMITS),
            "priority": str(os.getpriority(os.PRIO_PROCESS, 0)),
            "processors": " ".join(map(str, sorted(_processors(0)))),
        }

    def _environment_now(self) -> str:
        """Returns the environment variables that differ from those at the start, with their values."""
        if self._environment is None:
            return ""
        rows, index = [], 0
        while row := self._environment[index]:
            rows.append(row)
            index += 1
        now = frozenset(rows)
        if self._first_environment is None:
            self._first_environment = now
        removed = {row.split(b"=", 1)[0] for row in self._first_environment - now}
        removed -= {row.split(b"=", 1)[0] for row in now}
        rows = [*sorted(now - self._first_environment), *(name + b" removed" for name in sorted(removed))]
        return ", ".join(row.decode("utf-8", "replace")[:60] for row in rows)

    def _restore_process(self) -> None:
        before = self._process
        os.chdir(before["working directory"])
        os.umask(int(before["file mode mask"], 8))
        if self._locale is not None:
            self._locale(_LC_ALL, before["locale"].encode())

    def _heap_now(self) -> int:
        """Returns the bytes of the heap in use, and of large blocks beside it."""
        if self._heap is None:
            return 0
        information = self._heap()
        return int(information.uordblks) + int(information.hblkhd)

    def resources_in_use(self) -> dict[str, int]:
        gc.collect()
        if not gc.get_freeze_count():
            gc.freeze()  # what is left stays: the next collections are short
        counts = {"heap": self._heap_now()}
        for name, folder in (("open files", "fd"), ("threads", "task")):
            with suppress(OSError):
                counts[name] = len(list((_SELF / folder).iterdir()))
        return counts


_TWO = 2.0
