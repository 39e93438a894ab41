"""Rules of the zip archive and of the shared libraries in it: FMI 2.0.5, 2.3."""

import posixpath
import re
import stat
import struct
import zipfile
from collections.abc import Iterator, Sequence
from copy import copy

from fmus.compliance.fmu_file import DESCRIPTION, FmuFile
from fmus.compliance.library_reader import Library, read_libraries
from fmus.compliance.rows import add_rows, anything, row
from fmus.compliance.rule import Stage, repeated, rule
from fmus.fmi.binding import CO_SIMULATION, MODEL_EXCHANGE, signatures
from fmus.platforms import FMPY

CLAUSE = "2.3 FMU Distribution"
_TOP = (
    DESCRIPTION, "model.png",
    "binaries/", "documentation/", "resources/", "sources/", "extra/", "terminalsAndIcons/",
)  # fmt: skip
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED, _DESCRIPTOR = 0x0001 | 0x0040 | 0x2000, 0x0008  # general purpose bits
_NEWEST = 20  # version 2.0 of the zip format
_LONGEST_END = 22 + 65535  # bytes of the end of the central directory, with its comment
PLATFORM = re.compile(
    r"(?:win|linux|darwin)(?:32|64)|(?:(?:aarch|riscv|ppc|x86_)(?:32|64)|x86)-(?:windows|linux|darwin)(?:-\w+)?"
)


def _last_part(fmu: FmuFile) -> int:
    """Returns the number of the part that a member begins in, or the archive ends in; 0 if it is one file."""
    with fmu.path.open("rb") as stream:
        stream.seek(-min(_LONGEST_END, stream.seek(0, 2)), 2)
        end = stream.read()
    (last,) = struct.unpack_from("<H", end, end.rfind(b"PK\5\6") + 4)
    return max([last, *(member.volume for member in fmu.members)])


def unreadable(fmu: FmuFile) -> str:
    """Returns the reason why rules of the archive's members do not apply."""
    return "the archive cannot be read" if fmu.archive_problem else ""


@rule(CLAUSE, Stage.FILE)
def archive_is_zip(fmu: FmuFile) -> Iterator[str]:
    """The file is a zip archive, and every member unpacks to what its checksum says."""
    if problem := fmu.archive_problem or fmu.too_large:
        yield problem
    # `archive-is-one-file` reports a split archive
    if problem or _last_part(fmu):
        return
    with zipfile.ZipFile(fmu.path) as archive:
        for member in fmu.members:
            if member.flag_bits & _ENCRYPTED or member.compress_type not in _METHODS:
                # `archive-is-not-encrypted` and `archive-compression` report these
                continue
            try:
                with archive.open(member) as stream:
                    while stream.read(1 << 20):
                        pass
            except Exception as error:
                # each compression method has its own errors
                yield f"{member.filename} is damaged: {error}"


def _headers(fmu: FmuFile) -> Iterator[zipfile.ZipInfo]:
    """Yields each member by the central directory, and by the header before its data."""
    with fmu.path.open("rb") as stream:
        for member in fmu.members:
            yield member
            stream.seek(member.header_offset)
            data = stream.read(10)
            if len(data) == 10 and data.startswith(b"PK\x03\x04"):  # otherwise it is no zip
                local = copy(member)
                local.extract_version, local.flag_bits, local.compress_type = struct.unpack("<HHH", data[4:])
                yield local


def _is_not_portable(path: str) -> bool:
    is_absolute = path.startswith("/") or re.match(r"[A-Za-z]:", path)
    return bool(is_absolute) or "\\" in path or ".." in path.split("/")


add_rows(__name__, Stage.FILE, condition=unreadable, rows=(
    row("archive-extension", lambda fmu: [fmu.path],
        (lambda path, _: path.suffix != ".fmu", "file {subject.name}: expected the extension .fmu")),
    row("archive-compression", _headers,
        (lambda m, _: m.compress_type not in _METHODS,
         "{filename}: compression method {compress_type}: expected 8 (deflate) or 0 (store)")),
    row("archive-data-descriptors", _headers,
        (lambda m, _: m.flag_bits & _DESCRIPTOR and m.compress_type == zipfile.ZIP_STORED,
         "{filename} is stored and has general purpose bit 3: expected it for deflated members alone")),
    row("archive-version",
        _headers, (lambda m, _: m.extract_version & 0xFF > _NEWEST and (m.extract_version & 0xFF) / 10,
                   "{filename}: version needed to extract is {value}: expected at most 2.0")),
    row("archive-is-not-encrypted", _headers,
        (lambda m, _: m.flag_bits & _ENCRYPTED, "{filename} is encrypted: expected a plain file")),
    row("archive-is-one-file", lambda fmu: [_last_part(fmu)],
        (lambda last, _: last and last + 1, "the archive has {value} parts: expected one file")),
    row("archive-has-no-links", lambda fmu: fmu.members,
        (lambda m, _: stat.S_ISLNK(m.external_attr >> 16),
         "{filename} is a symbolic link: expected a plain file")),
    row("archive-paths-are-portable", lambda fmu: fmu.members,
        (lambda m, _: _is_not_portable(m.orig_filename),
         "path {orig_filename!r}: expected a relative one with forward slashes, inside the archive")),
    row("archive-paths-are-unique",
        lambda fmu: repeated(name for name in fmu.names if not name.endswith("/")).items(),
        (anything, "{subject[1]} members are called {subject[0]!r}: expected one")),
    row("archive-layout",
        lambda fmu: sorted({path.split("/")[0] + "/" * ("/" in path) for path in fmu.names}),
        (lambda name, _: name not in _TOP, f"{{subject}}: expected one of {', '.join(_TOP)}")),
    row("archive-has-description", lambda fmu: [[name for name in fmu.names if name.endswith(DESCRIPTION)]],
        (lambda names, _: DESCRIPTION not in names and (", ".join(names) or "no other place either"),
         f"no {DESCRIPTION} at the top; it is at {{value}}")),
))  # fmt: skip


# libraries

_MACHINES = {
    "linux64": "ELF x64", "linux32": "ELF x86", "x86_64-linux": "ELF x64", "aarch64-linux": "ELF AArch64",
    "win64": "PE AMD64", "win32": "PE I386", "x86_64-windows": "PE AMD64", "aarch64-windows": "PE ARM64",
    "darwin64": "Mach-O x86_64", "x86_64-darwin": "Mach-O x86_64", "aarch64-darwin": "Mach-O ARM64",
}  # fmt: skip
_DECLARED = re.compile(r"^FMI3_Export +\w+ +(fmi3\w+);", re.MULTILINE)
_TYPES = {"CoSimulation": CO_SIMULATION, "ModelExchange": MODEL_EXCHANGE}


def _no_library(fmu: FmuFile) -> str:
    return "" if fmu.libraries() else "there is no library"


def _libraries(fmu: FmuFile) -> Sequence[Library]:
    """Returns every library of a platform that can be read."""
    return [one for one in read_libraries(fmu) if PLATFORM.fullmatch(fmu.libraries()[one.path])]


@rule("2.3", Stage.LIBRARY, condition=_no_library)
def library_format(fmu: FmuFile) -> Iterator[str]:
    """Each library has the format and the processor that its folder names."""
    for path, folder in fmu.libraries().items():
        expected = _MACHINES.get(folder)
        got = [library.machine for library in read_libraries(fmu) if library.path == path]
        if not got and expected:
            yield f"{path} is not a shared library: expected one for {folder}"
        elif expected and expected not in got:
            yield f"{path} is {', '.join(got)}: expected {expected}"


def _missing_functions(library: Library, fmu: FmuFile) -> str:
    """Returns the missing functions of the interfaces whose modelIdentifier is the name of the library, or in
    FMI 3.0 of all interfaces.
    """
    if fmu.is_fmi3:
        header = (FMPY / "c-code" / "fmi3Functions.h").read_text(encoding="utf-8")
        return ", ".join(sorted({*_DECLARED.findall(header)} - library.exports))
    identifier = posixpath.basename(library.path).rpartition(".")[0]
    kinds = [kind for kind, stated in fmu.interfaces.items() if stated.get("modelIdentifier") == identifier]
    expected = {name for kind in kinds for name in signatures(_TYPES[kind])}
    return ", ".join(sorted(expected - library.exports))


def _own_memory(library: Library, fmu: FmuFile) -> str:
    is_claimed = fmu.claims("canNotUseMemoryManagementFunctions")
    return "" if is_claimed else ", ".join(sorted(library.imports & {"malloc", "calloc", "realloc"}))


add_rows(__name__, Stage.LIBRARY, condition=_no_library, rows=(
    row("library-exports", _libraries, (_missing_functions, "{path} does not export {value}")),
    row("memory-functions-are-callbacks", _libraries, (_own_memory,
        "{path} uses {value}: expected canNotUseMemoryManagementFunctions, or allocateMemory alone")),
))  # fmt: skip
