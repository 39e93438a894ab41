"""What LIEF reads of shared libraries, without loading them, in a process of its own.

LIEF takes longer to import than all rules take: it is imported there beside the behaviour of an FMU.
"""

import atexit
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

from fmus.extras import imports_of
from fmus.process import Parent, WorkerProcess

Member = tuple[str, str, bytes]
"""A library in an FMU: its path, the folder of its platform, its content."""


@dataclass(frozen=True)
class Library:
    """What LIEF reads of one library, or of one architecture's slice of a macOS one.

    needed: libraries that it needs but the system's. search_paths: RPATH and RUNPATH of a library for Linux.
    """

    path: str
    folder: str
    machine: tuple[str, str]
    exports: frozenset[str]
    imports: frozenset[str]
    needed: tuple[str, ...]
    search_paths: tuple[str, ...]

    @property
    def directory(self) -> str:
        return self.path.rpartition("/")[0]


# what every Linux of a distribution has, by the beginning of its name
_SYSTEM = (
    "libc.so", "libm.so", "libdl.so", "libpthread.so", "librt.so", "libutil.so", "ld-linux", "libgcc_s.so",
    "libstdc++.so", "libresolv.so", "libnsl.so", "libcrypt.so", "linux-vdso.so",
)  # fmt: skip
_MACH_O = (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\xca\xfe\xba\xbf")


def check_lief() -> None:
    """MissingExtraError where LIEF is not installed."""
    with imports_of("check", "a check of FMUs"):
        if find_spec("lief") is None:
            raise ModuleNotFoundError(name="lief")


@cache
def start_reader() -> WorkerProcess:
    """The process of LIEF, one for all FMUs until it is closed. Raises OSError where it cannot be started."""
    return WorkerProcess(_answer)


@atexit.register
def close_reader() -> None:
    """End the process of LIEF, if there is one; the next libraries start another."""
    if start_reader.cache_info().currsize:
        start_reader().close()
        start_reader.cache_clear()


def read_libraries(members: Sequence[Member]) -> tuple[Library, ...]:
    """Every library that LIEF can read. Raises ProcessEndedError where LIEF fails."""
    process = start_reader()
    process.send(members)
    try:
        return process.receive()
    except BaseException:  # an interrupt, too, which would leave an answer for the next libraries
        close_reader()
        raise


def _answer(parent: Parent) -> None:
    """What the process does: facts of the libraries in each message."""
    import lief

    lief.logging.disable()
    while True:
        parent.send(
            tuple(
                _facts(path, folder, parsed)
                for path, folder, content in parent.receive()
                for parsed in _slices(lief, content)
            )
        )


def _slices(lief: Any, content: bytes) -> Iterator[Any]:
    """The library, or each architecture's of a macOS one; none if it is no library.

    A slice is used before the next is asked for: it lives no longer than what LIEF read it from.
    """
    if content.startswith(_MACH_O):
        universal: Any = lief.MachO.parse(list(content)) or ()
        yield from (universal.at(i) for i in range(len(universal)))
        return
    parsed = lief.parse(content)
    if parsed is not None:
        yield parsed


def _facts(path: str, folder: str, parsed: Any) -> Library:
    symbols = [*parsed.exported_functions, *getattr(parsed, "exported_symbols", ())]
    exports = frozenset(str(symbol.name).removeprefix("_") for symbol in symbols)
    needed, search_paths = [], []
    if parsed.format.name == "ELF":
        needed = [str(name) for name in parsed.libraries if not str(name).startswith(_SYSTEM)]
        entries = [entry for entry in parsed.dynamic_entries if hasattr(entry, "paths")]
        search_paths = [str(one) for entry in entries for one in entry.paths]
    imports = frozenset(str(symbol.name).removeprefix("_") for symbol in parsed.imported_functions)
    return Library(path, folder, _machine(parsed), exports, imports, tuple(needed), tuple(search_paths))


def _machine(parsed: Any) -> tuple[str, str]:
    header = parsed.header
    kind = getattr(header, "machine_type", None) or getattr(header, "machine", None) or header.cpu_type
    return parsed.format.name, getattr(kind, "name", str(kind))  # a number that LIEF does not know
