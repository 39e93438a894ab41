"""Mutants of the zip archive: how an FMU is packed."""

import stat
import struct
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

from tests.mutants.base import BASE, written
from tests.mutants.mutant import Mutant

Change = Callable[[bytes], bytes]


def _field(signature: bytes, offset: int, change: Callable[[int], int]) -> Change:
    """A change of the 16-bit field at `offset` behind the first signature of each kind of header."""

    def changed_bytes(data: bytes) -> bytes:
        start = data.index(signature) + offset
        (value,) = struct.unpack("<H", data[start : start + 2])
        return data[:start] + struct.pack("<H", change(value)) + data[start + 2 :]

    return changed_bytes


_LOCAL, _CENTRAL = b"PK\x03\x04", b"PK\x01\x02"


def _changed_bytes(changes: list[Change], method: int, folder: Path) -> Path:
    path = folder / "Base.fmu"
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in BASE.items():
            archive.writestr(name, content)
    data = path.read_bytes()
    for change in changes:
        data = change(data)
    path.write_bytes(data)
    return path


def _both(offset: int, change: Callable[[int], int]) -> list[Change]:
    """A change of a field in the header before the data and in the central directory."""
    return [_field(_LOCAL, offset, change), _field(_CENTRAL, offset + 2, change)]


_BYTES: list[tuple[str, str, int, list[Change]]] = [
    ("a version of the zip format beyond 2.0", "archive-version", 8, _both(4, lambda _: 45)),
    ("a version beyond 2.0 before the data alone", "archive-version", 8, [_field(_LOCAL, 4, lambda _: 45)]),
    ("bit 3 of a stored member", "archive-data-descriptors", 0, _both(6, lambda flags: flags | 8)),
    ("bit 3 of a stored member in the directory alone", "archive-data-descriptors", 0,
     [_field(_CENTRAL, 8, lambda flags: flags | 8)]),
    ("a member in part 1 of a split archive", "archive-is-one-file", 8,
     [_field(_CENTRAL, 34, lambda _: 1)]),
    ("the last part of a split archive", "archive-is-one-file", 8, [_field(b"PK\5\6", 4, lambda _: 1)]),
]  # fmt: skip


def _appended(member: zipfile.ZipInfo, content: bytes, method: int, folder: Path) -> Path:
    path = written(BASE, folder)
    with zipfile.ZipFile(path, "a", method) as archive:
        archive.writestr(member, content, method)
    return path


def _encrypted(folder: Path) -> Path:
    path = _appended(zipfile.ZipInfo("sources/x.h"), b"", zipfile.ZIP_STORED, folder)
    data = path.read_bytes()
    local, central = data.rindex(_LOCAL) + 6, data.rindex(_CENTRAL) + 8
    changed_data = bytearray(data)
    changed_data[local] |= 1
    changed_data[central] |= 1
    path.write_bytes(bytes(changed_data))
    return path


def _link() -> zipfile.ZipInfo:
    member = zipfile.ZipInfo("resources/link")
    member.external_attr = (stat.S_IFLNK | 0o777) << 16
    return member


def _damaged(folder: Path) -> Path:
    path = written(BASE | {"sources/x.h": bytes(range(256))}, folder)
    data = bytearray(path.read_bytes())
    data[data.index(b"sources/x.h") + 40] ^= 0xFF
    path.write_bytes(bytes(data))
    return path


def _not_a_zip(folder: Path) -> Path:
    path = folder / "Base.fmu"
    path.write_bytes(b"no zip")
    return path


def _mutant(name: str, rules: str, write: Callable[[Path], Path], clause: str = "2.3") -> Mutant:
    return Mutant(name, clause, frozenset(rules.split()), write)


_PLAIN = zipfile.ZipInfo("resources/x")
ARCHIVE_MUTANTS = (
    *(
        _mutant(name, rules, partial(_changed_bytes, changes, method))
        for name, rules, method, changes in _BYTES
    ),
    _mutant("a file that is no zip", "archive-is-zip", _not_a_zip),
    _mutant("a damaged member", "archive-is-zip", _damaged),
    _mutant("another extension", "archive-extension", partial(written, BASE, name="Base.zip")),
    _mutant("a member packed by bzip2", "archive-compression archive-version",
            partial(_appended, _PLAIN, b"x", zipfile.ZIP_BZIP2)),
    _mutant("a member packed by LZMA", "archive-compression archive-version",
            partial(_appended, _PLAIN, b"x", zipfile.ZIP_LZMA)),
    _mutant("an encrypted member", "archive-is-not-encrypted", _encrypted),
    _mutant("a symbolic link", "archive-has-no-links", partial(_appended, _link(), b"x", zipfile.ZIP_STORED)),
    _mutant("two members of one path", "archive-paths-are-unique",
            partial(_appended, zipfile.ZipInfo("sources/base.c"), b"", zipfile.ZIP_STORED)),
)  # fmt: skip
