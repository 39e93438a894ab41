"""Writing files that appear complete or not at all, and archives that follow from their content alone."""

import io
import json
import os
import secrets
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

_MOST_MEMBERS = 100_000
_MOST_BYTES = 8_000_000_000  # unpacked
_MOST_BYTES_A_BYTE = 200  # unpacked for one of the archive, from `_FEW_BYTES` on
_FEW_BYTES = 100_000_000
# environment variable that keeps the user's temporary folder while a command uses another one
TEMPORARY_VARIABLE = "L1_DEPTH_TMPDIR"
# Umask of a command: an FMU in its process may change the process's umask. None in a user's program, which
# may change the umask on purpose.
command_umask: int | None = None
_EPOCH = (1980, 1, 1, 0, 0, 0)  # the earliest date that a zip can hold


def lasting_folder() -> Path:
    """Returns a new temporary folder of the user, which outlives the command that makes it."""
    return Path(tempfile.mkdtemp(prefix="l1-depth-", dir=os.environ.get(TEMPORARY_VARIABLE)))


@contextmanager
def open_atomically(path: Path, mode: int = 0o666) -> Iterator[io.BufferedRandom]:
    """Yields a stream of bytes that becomes the file `path`; an error leaves nothing.

    The stream can be read, too. An earlier file stays until then. A missing folder is made.
    mode: permissions of the file, from which the user's umask is subtracted
    """
    if command_umask is not None:
        os.umask(command_umask)
    path.parent.mkdir(parents=True, exist_ok=True)
    # in the same folder: a file cannot be renamed to another file system
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        with open(temporary, "x+b", opener=lambda path, flags: os.open(path, flags, mode)) as stream:
            yield stream
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def write_bytes_atomically(path: Path, data: bytes, mode: int = 0o666) -> None:
    """Writes a file of bytes, with the permissions of `open_atomically`."""
    with open_atomically(path, mode) as stream:
        stream.write(data)


def write_text_atomically(path: Path, text: str) -> None:
    """Writes a file of UTF-8, its line ends as they are."""
    write_bytes_atomically(path, text.encode("utf-8"))


def write_json_atomically(path: Path, content: object) -> None:
    """Writes plain data as JSON; ValueError for a number that JSON does not have."""
    write_text_atomically(path, json.dumps(content, indent=2, allow_nan=False))


def write_archive(path: Path, members: Mapping[str, bytes]) -> Path:
    """Writes a zip of these members, as `packed`."""
    write_bytes_atomically(path, packed(members))
    return path


def packed(members: Mapping[str, bytes]) -> bytes:
    """Returns a zip of these members, sorted by name; equal members give equal bytes."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in sorted(members):
            # by default, a member has the time of the build: equal members would give other bytes
            info = zipfile.ZipInfo(name, _EPOCH)
            info.compress_type = zipfile.ZIP_DEFLATED
            # 3 is Unix, whose file modes follow; by default, each system writes its number
            info.create_system = 3
            info.external_attr = 0o644 << 16
            archive.writestr(info, members[name])
    return stream.getvalue()


def xml_document(root: ElementTree.Element) -> bytes:
    """Returns a whole XML file, indented."""
    ElementTree.indent(root)
    return ElementTree.tostring(root, xml_declaration=True, encoding="UTF-8")


def too_large(members: Sequence[zipfile.ZipInfo], packed: int) -> str:
    """Returns why members of an archive of `packed` bytes are too large to unpack; else empty."""
    size = sum(member.file_size for member in members)
    if len(members) > _MOST_MEMBERS:
        return f"{len(members)} files: expected at most {_MOST_MEMBERS}"
    if size > _MOST_BYTES:
        return f"{size} bytes unpacked: expected at most {_MOST_BYTES}"
    if size > max(_FEW_BYTES, _MOST_BYTES_A_BYTE * packed):
        return f"{size} bytes unpacked from {packed}: expected at most {_MOST_BYTES_A_BYTE} times as many"
    return ""


def extract_archive(path: Path, folder: Path, members: Sequence[str] | None = None) -> None:
    """Unpacks a zip, or some of its members.

    Raises ValueError, before anything is written, for an archive larger than any FMU that a tool writes.
    """
    with zipfile.ZipFile(path) as archive:
        reason = too_large(archive.infolist(), path.stat().st_size)
        if reason:
            raise ValueError(reason)
        archive.extractall(folder, members)
