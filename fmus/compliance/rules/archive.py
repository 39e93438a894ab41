"""Rules of the zip archive: FMI 2.0.5, 2.3 FMU Distribution."""

import re
import stat
import struct
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass

from fmus.compliance.fmu_file import DESCRIPTION, FmuFile
from fmus.compliance.rule import Stage, repeated, rule

CLAUSE = "2.3 FMU Distribution"
_FOLDERS = ("binaries", "documentation", "resources", "sources", "extra", "terminalsAndIcons")
_FILES = (DESCRIPTION, "model.png")
_METHODS = {zipfile.ZIP_STORED: "store", zipfile.ZIP_DEFLATED: "deflate"}
_ENCRYPTED, _DESCRIPTOR = 0x0001 | 0x0040 | 0x2000, 0x0008  # general purpose bits
_NEWEST = 20  # version 2.0 of the zip format
_END, _END_SIZE, _LONGEST_COMMENT = b"PK\x05\x06", 22, 65535


@dataclass(frozen=True)
class _Header:
    """Header of a member, in the central directory or before its data."""

    name: str
    version: int
    flags: int
    method: int


def unreadable(fmu: FmuFile) -> str:
    """Returns the reason why rules of the archive's members do not apply."""
    return "the archive cannot be read" if fmu.archive_problem else ""


def _headers(fmu: FmuFile) -> Iterator[_Header]:
    with fmu.path.open("rb") as stream:
        for member in fmu.members:
            name = member.filename
            yield _Header(name, member.extract_version & 0xFF, member.flag_bits, member.compress_type)
            stream.seek(member.header_offset)
            data = stream.read(10)
            if len(data) == 10 and data.startswith(b"PK\x03\x04"):  # otherwise it is no zip
                version, flags, method = struct.unpack("<HHH", data[4:])
                yield _Header(name, version & 0xFF, flags, method)


def _names(headers: Iterator[_Header]) -> Iterator[str]:
    yield from dict.fromkeys(header.name for header in headers)


@rule(CLAUSE, Stage.FILE)
def archive_is_zip(fmu: FmuFile) -> Iterator[str]:
    """The file is a zip archive, and every member unpacks to what its checksum says."""
    if fmu.archive_problem:
        yield fmu.archive_problem
    elif fmu.too_large:
        yield fmu.too_large
    else:
        yield from _damaged(fmu)


def _damaged(fmu: FmuFile) -> Iterator[str]:
    with zipfile.ZipFile(fmu.path) as archive:
        for member in fmu.members:
            if member.flag_bits & _ENCRYPTED or member.compress_type not in _METHODS:
                continue  # rules of their own
            try:
                with archive.open(member) as stream:
                    while stream.read(1 << 20):
                        pass
            except Exception as error:  # each way of compression has its own errors
                yield f"{member.filename} is damaged: {error}"


@rule(CLAUSE, Stage.FILE)
def archive_extension(fmu: FmuFile) -> Iterator[str]:
    """The name of the file ends in .fmu."""
    if fmu.path.suffix != ".fmu":
        yield f"file {fmu.path.name}: expected the extension .fmu"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_compression(fmu: FmuFile) -> Iterator[str]:
    """Members are compressed by method 8 (deflate) or 0 (store)."""
    for header in dict.fromkeys(_headers(fmu)):
        if header.method not in _METHODS:
            yield f"{header.name}: compression method {header.method}: expected 8 (deflate) or 0 (store)"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_data_descriptors(fmu: FmuFile) -> Iterator[str]:
    """General purpose bit 3, sizes after the data, is set for deflated members alone."""
    for name in _names(h for h in _headers(fmu) if h.flags & _DESCRIPTOR and h.method == zipfile.ZIP_STORED):
        yield f"{name} is stored and has general purpose bit 3: expected it for deflated members alone"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_version(fmu: FmuFile) -> Iterator[str]:
    """No member needs a version of the zip format beyond 2.0 to be extracted."""
    for header in {h.name: h for h in _headers(fmu) if h.version > _NEWEST}.values():
        major, minor = divmod(header.version, 10)
        yield f"{header.name}: version needed to extract is {major}.{minor}: expected at most 2.0"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_is_not_encrypted(fmu: FmuFile) -> Iterator[str]:
    """No member is encrypted."""
    for name in _names(h for h in _headers(fmu) if h.flags & _ENCRYPTED):
        yield f"{name} is encrypted: expected a plain file"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_is_one_file(fmu: FmuFile) -> Iterator[str]:
    """The archive is neither split nor spanned."""
    with fmu.path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - _END_SIZE - _LONGEST_COMMENT))
        data = stream.read()
    end = data.rfind(_END)
    disks = struct.unpack("<HH", data[end + 4 : end + 8]) if end >= 0 else (0, 0)
    elsewhere = [member.filename for member in fmu.members if member.volume]
    if any(disks) or elsewhere:
        yield f"it is part {max(disks)} of a split archive: expected one file"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_has_no_links(fmu: FmuFile) -> Iterator[str]:
    """No member is a link."""
    for member in fmu.members:
        if stat.S_ISLNK(member.external_attr >> 16):
            yield f"{member.filename} is a symbolic link: expected a plain file"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_paths_are_portable(fmu: FmuFile) -> Iterator[str]:
    """Paths in the archive are relative, with forward slashes, and lead nowhere else."""
    for member in fmu.members:
        name = member.orig_filename
        if "\\" in name or name.startswith("/") or re.match(r"[A-Za-z]:", name) or ".." in name.split("/"):
            yield f"path {name!r}: expected a relative one with forward slashes, inside the archive"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_paths_are_unique(fmu: FmuFile) -> Iterator[str]:
    """No two members have the same path."""
    for name, count in repeated(name for name in fmu.names if not name.endswith("/")).items():
        yield f"{count} members are called {name!r}: expected one"


@rule("advice: Windows and macOS do not tell them apart", Stage.FILE, condition=unreadable)
def archive_paths_differ_by_more_than_case(fmu: FmuFile) -> Iterator[str]:
    """No two paths differ by upper and lower case alone."""
    for name in repeated(name.lower() for name in fmu.paths):
        yield f"several members are called {name!r} but for their case: expected other names"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_folders_are_ascii(fmu: FmuFile) -> Iterator[str]:
    """Names of directories hold ASCII characters alone."""
    for folder in sorted({name.rpartition("/")[0] for name in fmu.names}):
        if not folder.isascii():
            yield f"directory {folder!r}: expected ASCII characters, others are a problem on some systems"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_has_description(fmu: FmuFile) -> Iterator[str]:
    """modelDescription.xml stands at the top of the archive."""
    if DESCRIPTION not in fmu.paths:
        elsewhere = [name for name in fmu.names if name.endswith(DESCRIPTION)]
        yield f"no {DESCRIPTION} at the top; it is at {', '.join(elsewhere) or 'no other place either'}"


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_layout(fmu: FmuFile) -> Iterator[str]:
    """At the top of the archive there is nothing but what FMI puts there."""
    for name in sorted({path.split("/")[0] + "/" * ("/" in path) for path in fmu.names}):
        known = name.rstrip("/") in _FOLDERS if name.endswith("/") else name in _FILES
        if not known:
            yield f"{name}: expected one of {', '.join(_FILES)}, {'/, '.join(_FOLDERS)}/"
