"""Reader of the shared libraries in an FMU, of every platform, without loading them."""

import io
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from fmus.compliance.fmu_file import FmuFile
from fmus.errors import MissingExtraError
from fmus.extras import require

_NEEDED = "check", "a check of FMUs"
_LOCAL, _UNDEFINED = "STB_LOCAL", "SHN_UNDEF"
_MOST_EXPORTS = 1 << 16  # of a DLL: an ordinal has 16 bits
_TABLES = "IMAGE_DIRECTORY_ENTRY_EXPORT", "IMAGE_DIRECTORY_ENTRY_IMPORT"


@dataclass(frozen=True)
class Library:
    """Shared library, or the part of a macOS one for one processor. machine: its format and processor."""

    path: str
    machine: str
    exports: frozenset[str]
    imports: frozenset[str]


@lru_cache(maxsize=1)
def read_libraries(fmu: FmuFile) -> Sequence[Library]:
    """Returns the libraries of an FMU that can be read. Raises what `FmuFile.read` does."""
    libraries = list[Library]()
    for path in fmu.libraries():
        content = fmu.read(path)
        reader = next((reader for begin, reader in _READERS.items() if content.startswith(begin)), None)
        try:
            libraries += [Library(path, *found) for found in reader(content)] if reader else []
        except MissingExtraError:
            raise
        except Exception:
            # a library may be cut off, or damaged in many ways
            continue
    return libraries


_Found = tuple[str, frozenset[str], frozenset[str]]
"""Format and processor, names of exported symbols, names of imported ones."""


def _names(names: Iterable[str | bytes | None]) -> frozenset[str]:
    """Returns names as texts, without the underscore that macOS puts before each."""
    texts = (name.decode("utf-8", "replace") if isinstance(name, bytes) else name for name in names)
    return frozenset(text.removeprefix("_") for text in texts if text)


def _read_elf(content: bytes) -> Iterator[_Found]:
    elffile: Any = require("elftools.elf.elffile", *_NEEDED)
    library = elffile.ELFFile(io.BytesIO(content))
    found = {True: list[str](), False: list[str]()}
    # the segment of the loader has the same symbols; it looks for its tables again for each of them
    for table in [*library.iter_sections("SHT_DYNSYM")] or library.iter_segments("PT_DYNAMIC"):
        if hasattr(table, "get_table_offset"):
            table.get_table_offset = cache(table.get_table_offset)
        for symbol in table.iter_symbols():
            if symbol["st_info"]["bind"] != _LOCAL:
                found[symbol["st_shndx"] != _UNDEFINED].append(symbol.name)
    yield f"ELF {library.get_machine_arch()}", _names(found[True]), _names(found[False])


def _read_pe(content: bytes) -> Iterator[_Found]:
    pefile: Any = require("pefile", *_NEEDED)
    library = pefile.PE(data=content, fast_load=True, max_symbol_exports=_MOST_EXPORTS)
    library.parse_data_directories([pefile.DIRECTORY_ENTRY[name] for name in _TABLES])
    imports = (s.name for entry in getattr(library, "DIRECTORY_ENTRY_IMPORT", ()) for s in entry.imports)
    exports = getattr(getattr(library, "DIRECTORY_ENTRY_EXPORT", None), "symbols", ())
    machine = pefile.MACHINE_TYPE.get(library.FILE_HEADER.Machine, "unknown").rpartition("_")[2]
    yield f"PE {machine}", _names(symbol.name for symbol in exports), _names(imports)


def _read_mach_o(content: bytes) -> Iterator[_Found]:
    macho: Any = require("macholib.MachO", *_NEEDED)
    names: Any = require("macholib.mach_o", *_NEEDED)
    symbols: Any = require("macholib.SymbolTable", *_NEEDED)
    with tempfile.TemporaryDirectory(prefix="fmu-check-", ignore_cleanup_errors=True) as folder:
        path = Path(folder, "library")
        path.write_bytes(content)
        library = macho.MachO(str(path), allow_unknown_load_commands=True)
        for header in library.headers:
            table = symbols.SymbolTable(library, header)
            machine = names.CPU_TYPE_NAMES.get(header.header.cputype, "unknown")
            exports, imports = ((name for _, name in some) for some in (table.extdefsyms, table.undefsyms))
            yield f"Mach-O {machine}", _names(exports), _names(imports)


_MACH_O = (b"\xcf\xfa\xed\xfe", b"\xce\xfa\xed\xfe", b"\xca\xfe\xba\xbe", b"\xca\xfe\xba\xbf")
_READERS = {b"\x7fELF": _read_elf, b"MZ": _read_pe, **dict.fromkeys(_MACH_O, _read_mach_o)}
