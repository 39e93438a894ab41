"""Reader of shared libraries: LIEF reads them in a separate process, without loading them.

LIEF takes longer to import than all rules take, and may crash or hang on a library. So it reads while the
behaviour of the FMU is judged.
"""

import atexit
import gc
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

from fmus.errors import MissingExtraError
from fmus.extras import imports_of
from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess

if TYPE_CHECKING:
    from fmus.compliance.fmu_file import FmuFile  # which the process that reads does without

LIMIT_S = 60.0  # for the import of LIEF, and for a library where no other limit is given
Member = tuple[str, bytes]  # path of a library in an FMU, and its content


@dataclass(frozen=True)
class Library:
    """Library as LIEF reads it, or one architecture's slice of a macOS one.

    machine: format and processor. needed: libraries that it needs but the system's.
    """

    path: str
    machine: str
    exports: frozenset[str]
    imports: frozenset[str]
    needed: tuple[str, ...]


# what every Linux of a distribution has, by the beginning of its name
_SYSTEM = (
    "libc.so", "libm.so", "libdl.so", "libpthread.so", "librt.so", "libutil.so", "ld-linux", "libgcc_s.so",
    "libstdc++.so", "libresolv.so", "libnsl.so", "libcrypt.so", "linux-vdso.so",
)  # fmt: skip
_MACH_O = (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\xca\xfe\xba\xbf")


def check_lief() -> None:
    """Raises MissingExtraError where LIEF is not installed."""
    with imports_of("check", "a check of FMUs"):
        if find_spec("lief") is None:
            raise ModuleNotFoundError(name="lief")


class Reading:
    """Reading of some libraries by LIEF, from now on, beside whatever else is done.

    timeout: seconds for each library
    """

    def __init__(self, members: Sequence[Member], timeout: float) -> None:
        self._paths, self._timeout = [path for path, _ in members], timeout
        self._process = _reader()
        self._process.request += 1
        self._request = self._process.request
        arguments = members, self._request
        # a large library would block the caller
        threading.Thread(target=self._process.send, args=arguments, daemon=True).start()

    @cached_property
    def result(self) -> tuple[Sequence[Library], str]:
        """Every library that LIEF can read, up to the one on which it crashes or hangs, and that failure.

        Raises MissingExtraError where LIEF does not start, as when it cannot be imported.
        """
        libraries: list[Library] = []
        for path in ("", *self._paths):  # the first answer is that LIEF is imported
            try:
                libraries += self._process.receive(self._timeout if path else LIMIT_S, self._request)
            except (ProcessEndedError, TimeoutError) as error:
                close_reader()
                reason = ": ".join(filter(None, (str(error), getattr(error, "last_error_line", ""))))
                if path:
                    return libraries, f"LIEF cannot read {path}: {reason}"
                text = f"a check of FMUs needs lief, which does not start: {reason}"
                raise MissingExtraError(text) from None
        return libraries, ""


@cache
def _reader() -> WorkerProcess:
    """Returns the process of LIEF, one for all FMUs until it is closed; OSError if it does not start."""
    return WorkerProcess(_read)


@atexit.register
def close_reader() -> None:
    """Ends the process of LIEF, if there is one; the next libraries start another."""
    if _reader.cache_info().currsize:
        _reader().close()
        _reader.cache_clear()


def _read(parent: Parent) -> None:
    """Sends for each message an empty list once LIEF is imported, then the facts of each library."""
    # its import makes objects that all stay: to look for garbage among them takes a fifth of its time
    gc.disable()
    import lief

    gc.enable()
    lief.logging.disable()
    while True:
        members = parent.receive()
        parent.send([])
        for path, content in members:
            parent.send([_facts(path, parsed) for parsed in _slices(lief, content)])


def _slices(lief: Any, content: bytes) -> Iterator[Any]:
    """Yields the library, or each architecture's of a macOS one; none if it is no library.

    A slice is used before the next is asked for: it lives no longer than what LIEF read it from.
    """
    if content.startswith(_MACH_O):
        universal: Any = lief.MachO.parse(list(content)) or ()
        yield from (universal.at(i) for i in range(len(universal)))
    else:
        yield from filter(None, [lief.parse(content)])


def _facts(path: str, parsed: Any) -> Library:
    symbols = [*parsed.exported_functions, *getattr(parsed, "exported_symbols", ())]
    needed = []
    # the table of exports may be missing
    if parsed.format.name == "MACHO":
        symbols += [symbol for symbol in parsed.symbols if symbol.category.name == "EXTERNAL"]
    if parsed.format.name == "ELF":
        needed = [str(name) for name in parsed.libraries if not str(name).startswith(_SYSTEM)]
    exports, imports = (
        frozenset(str(symbol.name).removeprefix("_") for symbol in some)
        for some in (symbols, parsed.imported_functions)
    )
    machine = f"{parsed.format.name} {parsed.abstract.header.architecture.name}"
    return Library(path, machine, exports, imports, tuple(needed))


_readings: WeakKeyDictionary["FmuFile", Reading] = WeakKeyDictionary()


def no_library(fmu: "FmuFile") -> str:
    return "" if fmu.libraries() else "there is no library"


def start_reading(fmu: "FmuFile", timeout: float = LIMIT_S) -> Reading:
    """Starts LIEF's reading of the FMU's libraries at the first call, and returns it.

    timeout: seconds for each library. Raises what `FmuFile.read` does, OSError without a process.
    """
    if fmu not in _readings:
        members = [(path, fmu.read(path)) for path in fmu.libraries()]
        _readings[fmu] = Reading(members, timeout)
    return _readings[fmu]
