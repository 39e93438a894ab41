"""Store of data that outlives a process: entries in the user's cache, each found by a kind and a key.

The caller computes the key from everything that the content depends on. So an entry is never out of date. The
least recently used entries are removed.

Libraries are executed. So an entry is used only if no other user can have written it, and if it is unchanged.
On Windows the system protects the folders of a user from others.
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
"""Kind -> largest number of entries. Files of `FMUS` are not counted: scenarios name them."""

# lock that processes share while they run FMUs
_IN_USE = "in-use.lock"
_REMEDY = "remove it, or set XDG_CACHE_HOME (for FMUs L1_DEPTH_FMUS) to a folder of your own"
_SEAL_BYTES = hashlib.sha256().digest_size


def digest(*parts: object) -> str:
    """Returns the SHA-256 of bytes, or of the representations of other parts."""
    content = parts[0] if len(parts) == 1 and isinstance(parts[0], bytes) else repr(parts).encode()
    return hashlib.sha256(content).hexdigest()


def digests(folder: Path, skipped: Collection[str] = ()) -> Iterator[tuple[str, str, float]]:
    """Yields path, digest and time of the last change [s] of each file below a folder, in the order of paths.

    skipped: names of further folders to skip; folders of compiled Python always are
    """
    for parent, names, files in os.walk(folder):
        names[:] = sorted({*names} - {"__pycache__", *skipped})
        for name in sorted(files):
            file = os.path.join(parent, name)  # noqa: PTH118
            content, changed = read_with_time(file)
            yield os.path.relpath(file, folder), digest(content), changed


def read_with_time(file: str) -> tuple[bytes, float]:
    """Returns the content of a file, and the time of its last change [s since the epoch]."""
    with open(file, "rb") as stream:  # noqa: PTH123
        status = os.fstat(stream.fileno())
        # a copy may keep the modification time of its original; its status changed later
        return stream.read(), max(status.st_mtime, status.st_ctime)


def folder(kind: str = "") -> Path:
    """Returns the folder of a kind in the user's cache; without a kind, the folder of all kinds."""
    if cache := os.environ.get("XDG_CACHE_HOME"):
        return Path(cache, "l1-depth", kind)
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        return Path(local, "l1-depth", "Cache", kind)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "l1-depth" / kind
    return Path.home() / ".cache" / "l1-depth" / kind


def get(kind: str, key: str) -> bytes | None:
    """Returns the content of an entry; None if it is missing or cannot be trusted."""
    path = folder(kind) / key
    content = None if reason_for_distrust(path) else unsealed(path)
    if content is not None:
        # the time of the last use, by which entries are removed
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
    """Returns a content with its digest at the end."""
    # the loader of a system ignores what follows a library
    return content + hashlib.sha256(content).digest()


def unsealed(path: Path) -> bytes | None:
    """Returns the content of a sealed file; None if it is missing or damaged."""
    with suppress(OSError):
        data = path.read_bytes()
        if sealed(content := data[:-_SEAL_BYTES]) == data:
            return content
    return None


def reason_for_distrust(path: Path) -> str:
    """Returns why a file of a cache is not used, with a remedy; "" if no other user can have written it.

    Its folder counts, too. A missing file or folder is not distrusted.
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

    Raises PermissionError, with a remedy, for a folder that others can write.
    """
    for parent in reversed([parent for parent in (path.parent, *path.parents) if not parent.exists()]):
        parent.mkdir(mode=0o700, exist_ok=True)
    if reason := _distrust(path.parent):
        raise PermissionError(reason)
    write_bytes_atomically(path, content, mode=0o644)


def record_build(fmu: bytes) -> None:
    """Records the digest of an FMU that was built."""
    put(BUILDS, digest(fmu), b"")


def is_own_build(fmu: bytes) -> bool:
    """Whether a build of this user wrote these bytes; path and tool of the FMU do not matter."""
    return get(BUILDS, digest(fmu)) is not None


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Holds the lock of a file until the context or the process ends.

    Raises BlockingIOError at once if another process holds the lock.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    descriptor = _lock(path)
    try:
        yield
    finally:
        _remove(path)
        os.close(descriptor)
        if not operating_system.CAN_REMOVE_OPEN_FILES:
            # there nobody removes a lock that another process holds
            _remove(path)


def _remove(path: Path) -> None:
    with suppress(OSError):  # of another user, open in Windows, or removed meanwhile
        path.unlink()


def _lock(path: Path, shared: bool = False) -> int:
    """Returns the file descriptor of a lock; a shared lock waits for an exclusive one."""
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
        try:
            operating_system.lock(descriptor, shared)
        except OSError:
            os.close(descriptor)
            raise
        if os.fstat(descriptor).st_nlink:
            return descriptor
        # the last holder has removed the file meanwhile: a lock of it would exclude nobody
        os.close(descriptor)


def keep_fmus() -> None:
    """Keeps the FMUs of the cache, and the records of builds, until this process ends."""
    lock = folder(_IN_USE)
    # to run an FMU does not create a cache
    if lock.parent.is_dir():
        _kept(lock)


@cache
def _kept(lock: Path) -> int | None:
    with suppress(OSError):  # of a cache that cannot be written
        return _lock(lock, shared=True)
    return None


def entries(kind: str) -> Iterator[tuple[float, int, Path]]:
    """Yields the last use [s since the epoch], the size [bytes] and the path of each file of a kind."""
    top = folder(kind)
    # a link could lead to files that are no entries, and that would be removed
    for parent, _, names in () if top.is_symlink() else os.walk(top):
        for path in (Path(parent, name) for name in names):
            with suppress(FileNotFoundError):  # another process has removed it
                status = path.lstat()
                yield status.st_mtime, status.st_size, path


def clear(kind: str) -> list[int]:
    """Removes the entries of a kind, and returns their sizes [bytes]. Other processes then make them anew.

    Raises BlockingIOError for FMUs and their records while another process runs some.
    """
    freed = []
    with locked(folder(_IN_USE)) if kind in (FMUS, BUILDS) else nullcontext():
        for _, size, path in entries(kind):
            with suppress(OSError):  # of another user, or removed meanwhile
                path.unlink()
                freed.append(size)
    return freed
