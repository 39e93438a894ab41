"""Settings and resources of this process that an FMU could change, compared before and after its calls."""

import ctypes
import gc
import itertools
import locale
import os
import re
import signal
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

_SELF = Path("/proc/self")
_LINES = {  # of /proc/self/status
    "signal handlers": re.compile(rb"SigIgn:\s*(.*)\nSigCgt:\s*(.*)"),
    "signal mask": re.compile(rb"SigBlk:\s*(.*)"),
    "processors": re.compile(rb"Cpus_allowed_list:\s*(.*)"),
}
_STREAMS = [_SELF / "fd" / number for number in "012"]
_MOST_OF_A_FILE = 1 << 16  # bytes
_RESTORED = ("working directory", "file mode mask", "locale")
_TINY = 2.2250738585072014e-308  # half of it is below the normal numbers
_IN_USE, _IN_LARGE_BLOCKS = 7, 4  # uordblks, hblkhd


_freeze_once = cache(gc.freeze)


class MallocInformation(ctypes.Structure):
    """`struct mallinfo2` of glibc."""

    _fields_ = (("numbers", ctypes.c_size_t * 10),)


def _status() -> bytes:
    """Returns the content of /proc/self/status, without the layers of `open`: it is read often."""
    descriptor = os.open(_SELF / "status", os.O_RDONLY)
    try:
        return os.read(descriptor, _MOST_OF_A_FILE)
    finally:
        os.close(descriptor)


def _target(stream: Path) -> str:
    """Returns where a standard stream leads."""
    try:
        return str(stream.readlink())
    except OSError:
        return "closed"


class ProcessSettings:
    """Settings of this process in the C library and the operating system, compared with the first ones."""

    def __init__(self) -> None:
        linux: Any = ctypes.CDLL(None) if _SELF.is_dir() else None
        self._heap = getattr(linux, "mallinfo2", None)
        if self._heap is not None:
            self._heap.restype = MallocInformation
        self._tiny = _TINY
        self._mathematics: Any = None
        with suppress(OSError):
            self._mathematics = linux and ctypes.CDLL("libm.so.6")
        # larger than fenv_t of any platform
        self._first_fenv = ctypes.create_string_buffer(64)
        if self._mathematics:
            self._mathematics.fegetenv(self._first_fenv)
        self._environment: Any = None
        with suppress(ValueError):
            self._environment = ctypes.POINTER(ctypes.c_char_p).in_dll(linux, "environ") if linux else None
        self._first_environment = self._variables()
        self._process, self._floating_point = self._process_now(), self._floating_point_now()

    def _floating_point_now(self) -> str:
        """Returns the floating-point control in words; "" if it is unknown."""
        if not self._mathematics:
            return ""
        rounding, traps = self._mathematics.fegetround(), self._mathematics.fegetexcept()
        flushed = ", numbers near zero are flushed" if self._tiny / 2 == 0.0 else ""
        return f"rounding mode {rounding:#x}, traps {traps:#x}{flushed}"

    def differing(self) -> list[tuple[str, str, str]]:
        """Returns (setting, first value, present value) of each setting that differs in a callback."""
        path = "working directory"
        rows = [("floating-point control", self._floating_point, self._floating_point_now())]
        rows.append((path, self._process[path], str(Path.cwd())))
        return [(name, before, now) for name, before, now in rows if before != now]

    def changed(self) -> list[list[str]]:
        """Returns [setting, before, after] of each setting changed since the start or the last call."""
        now, rows = self._floating_point_now(), []
        self.restore_floating_point()
        if now != self._floating_point:
            rows.append(["floating-point control", self._floating_point, now])
        after = self._process_now()
        rows += [[name, value, after[name]] for name, value in self._process.items() if after[name] != value]
        self._process |= {name: x for name, x in after.items() if name not in _RESTORED}
        return rows

    def restore(self) -> None:
        """Sets back the settings that can be set back."""
        self.restore_floating_point()
        os.chdir(self._process["working directory"])
        os.umask(int(self._process["file mode mask"], 8))
        locale.setlocale(locale.LC_ALL, self._process["locale"])

    def restore_floating_point(self) -> None:
        """Sets back rounding mode, precision and traps."""
        if self._mathematics:
            self._mathematics.fesetenv(self._first_fenv)

    def _process_now(self) -> dict[str, str]:
        """Returns name -> value of the settings that this operating system provides."""
        umask = os.umask(0)
        os.umask(umask)
        settings = {
            "working directory": str(Path.cwd()),
            "file mode mask": oct(umask),
            "locale": locale.setlocale(locale.LC_ALL),
        }
        if os.name == "posix":
            timers = (signal.getitimer(kind)[0] > 0.0 for kind in (signal.ITIMER_REAL, signal.ITIMER_VIRTUAL))
            settings["timers"] = " ".join(map(str, timers))
            settings["environment"] = self._environment_now()
        with suppress(OSError):
            status = _status()
            found = ((name, line.search(status)) for name, line in _LINES.items())
            settings |= {name: b" ".join(match.groups()).decode() for name, match in found if match}
            settings["standard streams"] = " ".join(map(_target, _STREAMS))
        return settings

    def _variables(self) -> dict[bytes, bytes]:
        """Returns the environment variables of the C library: name -> NAME=VALUE."""
        if self._environment is None:
            return {}
        rows = itertools.takewhile(bool, (self._environment[i] for i in itertools.count()))
        return {row.split(b"=", 1)[0]: row for row in rows}

    def _environment_now(self) -> str:
        """Returns the environment variables that differ from those at the start, with their values."""
        now, first = self._variables(), self._first_environment
        names = sorted(name for name in now | first if now.get(name) != first.get(name))
        rows = (now.get(name, name + b" removed") for name in names)
        return ", ".join(row.decode("utf-8", "replace")[:60] for row in rows)

    def resources_in_use(self) -> dict[str, int]:
        """Returns open files and threads of the process, and bytes of its heap, 0 if unknown."""
        gc.collect()
        # the remaining objects stay, so that later collections are short
        _freeze_once()
        heap = self._heap().numbers if self._heap is not None else [0] * 10
        counts = {"heap": heap[_IN_USE] + heap[_IN_LARGE_BLOCKS]}
        for name, folder in (("open files", "fd"), ("threads", "task")):
            with suppress(OSError):
                counts[name] = len(list((_SELF / folder).iterdir()))
        return counts
