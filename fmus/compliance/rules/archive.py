"""Rules of the zip archive: FMI 2.0.5, 2.3 FMU Distribution."""

import re
import stat
import struct
import zipfile
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from fmus.compliance.fmu_file import DESCRIPTION, FmuFile
from fmus.compliance.rows import add_rows, anything, repeats, row
from fmus.compliance.rule import Stage, rule

CLAUSE = "2.3 FMU Distribution"
_TOP = (
    DESCRIPTION, "model.png",
    "binaries/", "documentation/", "resources/", "sources/", "extra/", "terminalsAndIcons/",
)  # fmt: skip
_METHODS = {zipfile.ZIP_STORED: "store", zipfile.ZIP_DEFLATED: "deflate"}
_ENCRYPTED, _DESCRIPTOR = 0x0001 | 0x0040 | 0x2000, 0x0008  # general purpose bits
_NEWEST = 20  # version 2.0 of the zip format
_END, _END_SIZE, _LONGEST_COMMENT = b"PK\x05\x06", 22, 65535


def unreadable(fmu: FmuFile) -> str:
    """Returns the reason why rules of the archive's members do not apply."""
    return "the archive cannot be read" if fmu.archive_problem else ""


@rule(CLAUSE, Stage.FILE)
def archive_is_zip(fmu: FmuFile) -> Iterable[str]:
    """The file is a zip archive, and every member unpacks to what its checksum says."""
    problem = fmu.archive_problem or fmu.too_large
    return [problem] if problem else _damaged(fmu)


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
def archive_is_one_file(fmu: FmuFile) -> Iterator[str]:
    """The archive is neither split nor spanned."""
    with fmu.path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(0, size - _END_SIZE - _LONGEST_COMMENT))
        data = stream.read()
    end = data.rfind(_END)
    disks = struct.unpack("<HH", data[end + 4 : end + 8]) if end >= 0 else (0, 0)
    if any(disks) or any(member.volume for member in fmu.members):
        yield f"it is part {max(disks)} of a split archive: expected one file"


class _Header(NamedTuple):
    """Header of a member, in the central directory or before its data."""

    name: str
    version: int
    flags: int
    method: int


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


def _is_not_portable(path: str) -> bool:
    is_absolute = path.startswith("/") or re.match(r"[A-Za-z]:", path)
    return bool(is_absolute) or "\\" in path or ".." in path.split("/")


add_rows(__name__, CLAUSE, Stage.FILE, condition=unreadable, rows=(
    row("archive-compression", "Members are compressed by method 8 (deflate) or 0 (store).", _headers,
        (lambda h, _: h.method not in _METHODS,
         "{name}: compression method {method}: expected 8 (deflate) or 0 (store)")),
    row("archive-data-descriptors",
        "General purpose bit 3, sizes after the data, is set for deflated members alone.", _headers,
        (lambda h, _: h.flags & _DESCRIPTOR and h.method == zipfile.ZIP_STORED,
         "{name} is stored and has general purpose bit 3: expected it for deflated members alone")),
    row("archive-version", "No member needs a version of the zip format beyond 2.0 to be extracted.",
        _headers, (lambda h, _: h.version > _NEWEST and h.version / 10,
                   "{name}: version needed to extract is {value}: expected at most 2.0")),
    row("archive-is-not-encrypted", "No member is encrypted.", _headers,
        (lambda h, _: h.flags & _ENCRYPTED, "{name} is encrypted: expected a plain file")),
    row("archive-has-no-links", "No member is a link.", lambda fmu: fmu.members,
        (lambda m, _: stat.S_ISLNK(m.external_attr >> 16),
         "{filename} is a symbolic link: expected a plain file")),
    row("archive-paths-are-portable",
        "Paths in the archive are relative, with forward slashes, and lead nowhere else.",
        lambda fmu: fmu.members,
        (lambda m, _: _is_not_portable(m.orig_filename),
         "path {orig_filename!r}: expected a relative one with forward slashes, inside the archive")),
    row("archive-paths-are-unique", "No two members have the same path.",
        lambda fmu: repeats(name for name in fmu.names if not name.endswith("/")),
        (anything, "{count} members are called {name!r}: expected one")),
    row("archive-paths-differ-by-more-than-case", "No two paths differ by upper and lower case alone.",
        lambda fmu: repeats(name.lower() for name in fmu.paths),
        (anything, "several members are called {name!r} but for their case: expected other names"),
        clause="advice: Windows and macOS do not tell them apart"),
    row("archive-folders-are-ascii", "Names of directories hold ASCII characters alone.",
        lambda fmu: sorted({name.rpartition("/")[0] for name in fmu.names}),
        (lambda folder, _: not folder.isascii(),
         "directory {subject!r}: expected ASCII characters, others are a problem on some systems")),
    row("archive-layout", "At the top of the archive there is nothing but what FMI puts there.",
        lambda fmu: sorted({path.split("/")[0] + "/" * ("/" in path) for path in fmu.names}),
        (lambda name, _: name not in _TOP, f"{{subject}}: expected one of {', '.join(_TOP)}")),
))  # fmt: skip


@rule(CLAUSE, Stage.FILE, condition=unreadable)
def archive_has_description(fmu: FmuFile) -> Iterator[str]:
    """modelDescription.xml stands at the top of the archive."""
    if DESCRIPTION not in fmu.paths:
        elsewhere = [name for name in fmu.names if name.endswith(DESCRIPTION)]
        yield f"no {DESCRIPTION} at the top; it is at {', '.join(elsewhere) or 'no other place either'}"
