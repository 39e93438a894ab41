"""Files in the user's cache, which are used only if no other user can have written them; records of builds.

Libraries in a cache are executed, and rows of a score are published as results of this user. On Windows the
system keeps the folders of a user from others.
"""

import hashlib
import os
import stat
import sys
from contextlib import suppress
from pathlib import Path

from fmus.files import write_bytes_atomically

_ROOT = 0  # this user can replace the program itself
_WRITABLE_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_REMEDY = "remove it, or set XDG_CACHE_HOME (for FMUs L1_DEPTH_FMUS) to a folder of your own"


def cache_folder(name: str) -> Path:
    """Returns the folder of this name in the user's cache, whether or not it is there."""
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
        return Path(local, "l1-depth", "Cache", name)
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "l1-depth" / name
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "l1-depth", name)


def reason_for_distrust(path: Path) -> str:
    """Returns why a file of a cache is not used, "" if nobody else can have written it, nor its folder.

    What is missing is no reason. The text ends with what to do.
    """
    return _distrust(path.parent) or _distrust(path)


def _distrust(path: Path) -> str:
    with suppress(OSError):
        status = path.lstat()
        reasons = {
            "is a link": stat.S_ISLNK(status.st_mode),
            "belongs to another user": os.name != "nt" and status.st_uid not in (_ROOT, os.geteuid()),
            "can be written by other users": os.name != "nt" and status.st_mode & _WRITABLE_BY_OTHERS,
        }
        return next((f"{path} {reason}: {_REMEDY}" for reason, holds in reasons.items() if holds), "")
    return ""


def write_cached(path: Path, content: bytes) -> None:
    """Writes a file of a cache, whatever the umask is; missing folders become private.

    Raises PermissionError, with what to do, for a folder that others can write.
    """
    for folder in reversed([folder for folder in (path.parent, *path.parents) if not folder.exists()]):
        folder.mkdir(mode=0o700, exist_ok=True)
    if reason := _distrust(path.parent):
        raise PermissionError(reason)
    write_bytes_atomically(path, content, mode=0o644)


def record_build(fmu: bytes) -> None:
    """Records an FMU that was built; a cache that cannot be written records nothing.

    A record is an empty file, named after the digest of the FMU: of its library, its sources and all else.
    """
    with suppress(OSError):
        write_cached(_record(fmu), b"")


def is_own_build(fmu: bytes) -> bool:
    """Whether a build of this user wrote an FMU, wherever it is now and whatever tool it names."""
    return _record(fmu).is_file() and not reason_for_distrust(_record(fmu))


def _record(fmu: bytes) -> Path:
    return cache_folder("builds") / hashlib.sha256(fmu).hexdigest()
