"""Reader of shared libraries of Linux, Windows and macOS, without loading them: ELF, PE and Mach-O.

A damaged library counts as no library. Each loop ends: a library may be made to attack its reader.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fmus.compliance.fmu_file import FmuFile

_MOST = 1 << 20  # symbols of a library, and entries of its tables
_LONGEST = 4096  # bytes of a name
_MOST_PARTS = 96  # sections of a library for Windows, architectures of one for macOS
_DAMAGED = struct.error, ValueError, LookupError, OverflowError

_Symbol = tuple[str, bool]  # name, and whether it is defined here


@dataclass(frozen=True)
class Library:
    """Library, or one architecture's slice of a macOS one.

    machine: format and processor. needed: libraries that it needs but the system's.
    search_paths: RPATH and RUNPATH of a library for Linux.
    """

    path: str
    machine: str
    exports: frozenset[str]
    imports: frozenset[str]
    needed: tuple[str, ...] = ()
    search_paths: tuple[str, ...] = ()


# what every Linux of a distribution has, by the beginning of its name
_SYSTEM = (
    "libc.so", "libm.so", "libdl.so", "libpthread.so", "librt.so", "libutil.so", "ld-linux", "libgcc_s.so",
    "libstdc++.so", "libresolv.so", "libnsl.so", "libcrypt.so", "linux-vdso.so",
)  # fmt: skip


def no_library(fmu: "FmuFile") -> str:
    return "" if fmu.libraries() else "there is no library"


@lru_cache(maxsize=2)
def read_libraries(fmu: "FmuFile") -> tuple[Library, ...]:
    """Returns the libraries of an FMU, but those that cannot be read. Raises what `FmuFile.read` does."""
    return tuple(library for path in fmu.libraries() for library in slices(path, fmu.read(path)))


def slices(path: str, content: bytes) -> list[Library]:
    """Returns the library, or each architecture's of a macOS one; none if it is no library."""
    try:
        if content.startswith(b"\xca\xfe\xba\xbe"):
            (number,) = struct.unpack_from(">I", content, 4)
            places = struct.iter_unpack(">5I", content[8 : 8 + 20 * number])
            parts = [content[offset : offset + size] for _, _, offset, size, _ in islice(places, _MOST_PARTS)]
            return [_mach_o(path, part) for part in parts]
        reader = next(read for magic, read in _READERS.items() if content.startswith(magic))
        return [reader(path, content)]
    except (*_DAMAGED, StopIteration):
        return []


def _library(path: str, machine: str, symbols: Iterator[_Symbol], *others: tuple[str, ...]) -> Library:
    exports, imports = set[str](), set[str]()
    for name, is_defined in islice(symbols, _MOST):
        (exports if is_defined else imports).add(name.removeprefix("_"))
    return Library(path, machine, frozenset(exports), frozenset(imports), *others)


def _name(content: bytes, offset: int) -> str:
    """Returns the text up to the next zero; ValueError without one."""
    return content[offset : content.index(b"\0", offset, offset + _LONGEST)].decode("utf-8", "replace")


# ELF: System V gABI

_ELF_MACHINES = {3: "X86", 40: "ARM", 62: "X86_64", 183: "ARM64", 243: "RISCV"}
_NEEDED, _HASH, _STRINGS, _SYMBOLS, _RPATH, _RUNPATH, _GNU_HASH = 1, 4, 5, 6, 15, 29, 0x6FFFFEF5
_LOAD, _DYNAMIC = 1, 2  # types of segments


def _elf(path: str, content: bytes) -> Library:
    is_wide, order = content[4] == 2, "<" if content[5] == 1 else ">"
    (machine,) = struct.unpack_from(order + "H", content, 18)
    (first,) = struct.unpack_from(order + ("Q" if is_wide else "I"), content, 32 if is_wide else 28)
    size, number = struct.unpack_from(order + "HH", content, 54 if is_wide else 42)
    # type, offset, virtual address and size in the file of each segment
    layout = order + ("I4xQQ8xQ" if is_wide else "III4xI")
    segments = [struct.unpack_from(layout, content, first + i * size) for i in range(number)]

    def place(address: int) -> int:
        """Returns the offset in the file of an address in memory."""
        inside = ((o, a) for kind, o, a, s in segments if kind == _LOAD and a <= address < a + s)
        offset, begin = next(inside, (0, -len(content)))
        return address - begin + offset

    begin, length = next((o, s) for kind, o, _, s in segments if kind == _DYNAMIC)
    entries = list(struct.iter_unpack(order + ("qQ" if is_wide else "iI"), content[begin : begin + length]))
    table = dict(reversed(entries))
    strings, symbols = place(table[_STRINGS]), place(table[_SYMBOLS])
    of = {tag: tuple(_name(content, strings + v) for t, v in entries if t == tag) for tag in (1, 15, 29)}
    symbol = order + ("IBBHQQ" if is_wide else "IIIBBH")

    def named() -> Iterator[_Symbol]:
        for i in range(1, _count_of_symbols(content, order, is_wide, table, place)):
            entry = struct.unpack_from(symbol, content, symbols + i * struct.calcsize(symbol))
            info, section = (entry[1], entry[3]) if is_wide else (entry[3], entry[5])
            if info >> 4:  # no local one
                yield _name(content, strings + entry[0]), section != 0

    needed = tuple(name for name in of[_NEEDED] if not name.startswith(_SYSTEM))
    search_paths = tuple(one for paths in (*of[_RPATH], *of[_RUNPATH]) for one in paths.split(":"))
    name = f"ELF {_ELF_MACHINES.get(machine, machine)}"
    return _library(path, name, named(), needed, search_paths)


def _count_of_symbols(
    content: bytes, order: str, is_wide: bool, table: dict[int, int], place: Callable[[int], int]
) -> int:
    """Returns the number of dynamic symbols, from the table by which the loader finds them."""
    if _HASH in table:
        return struct.unpack_from(order + "4xI", content, place(table[_HASH]))[0]
    start = place(table[_GNU_HASH])
    buckets, first, words = struct.unpack_from(order + "III", content, start)
    chains = start + 16 + words * (8 if is_wide else 4)
    last = max(struct.unpack_from(f"{order}{buckets}I", content, chains), default=0)
    if last < first:
        return first
    chains += 4 * (buckets - first)
    while not struct.unpack_from(order + "I", content, chains + 4 * last)[0] & 1:
        last += 1
    return last + 1


# PE: Microsoft's specification of the Portable Executable format

_PE_MACHINES = {0x14C: "X86", 0x8664: "X86_64", 0xAA64: "ARM64", 0x1C4: "ARM"}


def _pe(path: str, content: bytes) -> Library:
    (start,) = struct.unpack_from("<I", content, 60)
    signature, machine, number, size, magic = struct.unpack_from("<4sHH12xH2xH", content, start)
    if signature != b"PE\0\0":
        raise ValueError("it is a program of DOS")
    is_wide, sections = magic == 0x20B, start + 24 + size
    # virtual address, size in the file and offset of each section
    first_parts = range(min(number, _MOST_PARTS))
    places = [struct.unpack_from("<III", content, sections + 40 * i + 12) for i in first_parts]

    def place(address: int) -> int:
        for begin, size, offset in places:
            if begin <= address < begin + size:
                return address - begin + offset
        raise ValueError(f"address {address} is in no section")

    (count_of_tables,) = struct.unpack_from("<I", content, start + 24 + (108 if is_wide else 92))
    tables = start + 24 + (112 if is_wide else 96)
    exported, imported = (
        struct.unpack_from("<I", content, tables + 8 * i)[0] if i < count_of_tables else 0 for i in (0, 1)
    )

    def named() -> Iterator[_Symbol]:
        if exported:
            names, _, array = struct.unpack_from("<III", content, place(exported) + 24)
            for i in range(names):
                (address,) = struct.unpack_from("<I", content, place(array) + 4 * i)
                yield _name(content, place(address)), True
        for i in range(_MOST) if imported else ():
            lookup, *_, thunks = struct.unpack_from("<5I", content, place(imported) + 20 * i)
            if not thunks:
                break
            for j in range(_MOST):
                layout, width = ("<Q", 8) if is_wide else ("<I", 4)
                (entry,) = struct.unpack_from(layout, content, place(lookup or thunks) + width * j)
                if not entry:
                    break
                is_number = entry >> (8 * width - 1)
                # a number of the function yields an entry too, so that the end comes
                yield "" if is_number else _name(content, place(entry) + 2), False

    return _library(path, f"PE {_PE_MACHINES.get(machine, machine)}", named())


# Mach-O: mach-o/loader.h and mach-o/nlist.h

_MACH_MACHINES = {7: "X86", 0x1000007: "X86_64", 12: "ARM", 0x100000C: "ARM64"}
_TABLE_OF_SYMBOLS = 2  # a load command
_DEBUGGING, _KIND, _EXTERNAL = 0xE0, 0x0E, 0x01  # bits of the type of a symbol


def _mach_o(path: str, content: bytes) -> Library:
    magic, machine, _, _, commands = struct.unpack_from("<5I", content)
    is_wide, offset = magic == 0xFEEDFACF, 32 if magic == 0xFEEDFACF else 28
    tables = list[Any]()
    for _ in range(min(commands, _MOST)):
        command, size = struct.unpack_from("<II", content, offset)
        if command == _TABLE_OF_SYMBOLS:
            tables.append(struct.unpack_from("<4I", content, offset + 8))
        offset += size

    def named() -> Iterator[_Symbol]:
        width = 16 if is_wide else 12
        for symbols, number, strings, _ in tables:
            for i in range(number):
                name, kind = struct.unpack_from("<IB", content, symbols + width * i)
                if kind & _EXTERNAL and not kind & _DEBUGGING:
                    yield _name(content, strings + name), kind & _KIND != 0

    return _library(path, f"MACHO {_MACH_MACHINES.get(machine, machine)}", named())


_READERS: dict[bytes, Callable[[str, bytes], Library]] = {
    b"\x7fELF": _elf,
    b"MZ": _pe,
    b"\xcf\xfa\xed\xfe": _mach_o,
    b"\xce\xfa\xed\xfe": _mach_o,
}
