"""The store of what outlives a process: entries in the user's cache, each found by a kind and a key.

Callers say what they key on and what they store. A key follows from all that the content follows from. So no
entry is ever out of date: it is there or not. The entries that were used longest ago are removed.

Libraries are executed. So an entry is used only if no other user can have written it, and if it is as it was
written. On Windows the system keeps the folders of a user from others.
"""

import hashlib
import os
import stat
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from pathlib import Path

from fmus import operating_system
from fmus.files import write_bytes_atomically

FMUS, BUILDS = "fmus", "builds"
MOST = {BUILDS: 10_000, "libraries": 300}
"""Kind -> how many entries are kept.

The files of `FMUS` are no entries: scenarios name them.
"""

_IN_USE = "in-use.lock"  # which processes that run FMUs share
_REMEDY = "remove it, or set XDG_CACHE_HOME (for FMUs L1_DEPTH_FMUS) to a folder of your own"
_SEAL_BYTES = hashlib.sha256().digest_size


def digest(*parts: object) -> str:
    """Returns the SHA-256 of bytes, or of the representations of other parts."""
    content = parts[0] if len(parts) == 1 and isinstance(parts[0], bytes) else repr(parts).encode()
    return hashlib.sha256(content).hexdigest()


def digests(folder: Path, skipped: Collection[str] = ()) -> Iterator[tuple[str, str, float]]:
    """Yields path, digest and time of the last change [s] of each file below a folder, in the order of paths.

    skipped: names of folders, beside those of compiled Python
    """
    for parent, names, files in os.walk(folder):
        names[:] = sorted({*names} - {"__pycache__", *skipped})
        for name in sorted(files):
            file = os.path.join(parent, name)  # noqa: PTH118
            content, changed = read_with_time(file)
            yield os.path.relpath(file, folder), digest(content), changed


def read_with_time(file: str) -> tuple[bytes, float]:
    """Returns the content of a file, and when it was last changed [s since the epoch]."""
    with open(file, "rb") as stream:  # noqa: PTH123
        status = os.fstat(stream.fileno())
        return stream.read(), max(status.st_mtime, status.st_ctime)


def folder(kind: str = "") -> Path:
    """Returns the folder of a kind in the user's cache, by default the one of all kinds."""
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        return Path(local, "l1-depth", "Cache", kind)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "l1-depth" / kind
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "l1-depth", kind)


def get(kind: str, key: str) -> bytes | None:
    """Returns the content of an entry; None if there is none, or none that can be trusted."""
    path = folder(kind) / key
    content = None if reason_for_distrust(path) else unsealed(path)
    if content is not None:
        with suppress(OSError):  # of a cache that can only be read
            os.utime(path)
    return content


def put(kind: str, key: str, content: bytes) -> None:
    """Stores an entry, and removes those used longest ago; a cache that cannot be written stores nothing."""
    with suppress(OSError):
        write(folder(kind) / key, sealed(content))
        for _, _, path in sorted(entries(kind))[: -MOST[kind]]:
            _remove(path)


def sealed(content: bytes) -> bytes:
    """Returns a content with its digest at the end, where the loader of a system ignores it in a library."""
    return content + hashlib.sha256(content).digest()


def unsealed(path: Path) -> bytes | None:
    """Returns the content of a sealed file; None if it is missing or damaged."""
    with suppress(OSError):
        data = path.read_bytes()
        if sealed(content := data[:-_SEAL_BYTES]) == data:
            return content
    return None


def reason_for_distrust(path: Path) -> str:
    """Returns why a file of a cache is not used, "" if nobody else can have written it, nor its folder.

    What is missing is no reason. The text ends with what to do.
    """
    return _distrust(path.parent) or _distrust(path)


def _distrust(path: Path) -> str:
    with suppress(OSError):
        status = path.lstat()
        is_link = stat.S_ISLNK(status.st_mode)
        reason = "is a link" if is_link else operating_system.reason_for_distrust(status)
        return f"{path} {reason}: {_REMEDY}" if reason else ""
    return ""


def write(path: Path, content: bytes) -> None:
    """Writes a file of a cache, whatever the umask is; missing folders become private.

    Raises PermissionError, with what to do, for a folder that others can write.
    """
    for parent in reversed([parent for parent in (path.parent, *path.parents) if not parent.exists()]):
        parent.mkdir(mode=0o700, exist_ok=True)
    if reason := _distrust(path.parent):
        raise PermissionError(reason)
    write_bytes_atomically(path, content, mode=0o644)


def record_build(fmu: bytes) -> None:
    """Records an FMU that was built by its digest: that of its library, its sources and all else."""
    put(BUILDS, digest(fmu), b"")


def is_own_build(fmu: bytes) -> bool:
    """Whether a build of this user wrote an FMU, wherever it is now and whatever tool it names."""
    return get(BUILDS, digest(fmu)) is not None


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Holds the lock of a file until the context ends, or the process in any way.

    Raises BlockingIOError at once if another process holds the lock.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = _lock(path)
    try:
        yield
    finally:
        _remove(path)
        os.close(descriptor)


def _remove(path: Path) -> None:
    with suppress(OSError):  # of another user, open in Windows, or removed meanwhile
        path.unlink()


def _lock(path: Path, shared: bool = False) -> int:
    """Returns the file descriptor of a lock; one that is shared waits for one that is not."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            operating_system.lock(descriptor, shared)
        except OSError:
            os.close(descriptor)
            raise
        if os.fstat(descriptor).st_nlink:
            return descriptor
        os.close(descriptor)  # of a file that its last holder has removed meanwhile


def keep_fmus() -> None:
    """Keeps the FMUs of the cache, and the records of builds, until this process ends."""
    lock = folder(_IN_USE)
    if lock.parent.is_dir():  # running leaves no cache where there was none
        _kept(lock)


@cache
def _kept(lock: Path) -> int | None:
    with suppress(OSError):  # of a cache that cannot be written
        return _lock(lock, shared=True)
    return None


def entries(kind: str) -> Iterator[tuple[float, int, Path]]:
    """Yields the last use [s since the epoch], the size [bytes] and the path of each file of a kind."""
    top = folder(kind)
    for parent, _, names in () if top.is_symlink() else os.walk(top):
        for path in (Path(parent, name) for name in names):
            with suppress(FileNotFoundError):  # another process has removed it
                status = path.lstat()
                yield status.st_mtime, status.st_size, path


def clear(kind: str) -> list[int]:
    """Removes the entries of a kind, which other processes then make anew; returns their sizes [bytes].

    Raises BlockingIOError for FMUs and their records while another process runs some.
    """
    freed = []
    with locked(folder(_IN_USE)) if kind in (FMUS, BUILDS) else nullcontext():
        for _, size, path in entries(kind):
            with suppress(OSError):  # of another user, or removed meanwhile
                path.unlink()
                freed.append(size)
    return freed
