"""Registry of the installed blocks and the paths of their FMUs; nothing is loaded or built here.

Blocks are entry points of the group `l1_depth.blocks`, so that another package's blocks build the same way:
`MyBlock = "my_package.my_module:BLOCK"`.
"""

import os
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from enum import StrEnum
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from fmus import store
from fmus.errors import ExportError

GROUP = "l1_depth.blocks"
FOLDER_VARIABLE = "L1_DEPTH_FMUS"


class Flavour(StrEnum):
    """Flavour of an FMU: compiled, or on the Python of whoever imports it."""

    NATIVE = "native"
    PYTHON = "python"


def block_entry_points() -> dict[str, EntryPoint]:
    """Returns the entry point of every installed block, by its name, sorted."""
    return dict(_read_entry_points(entry_points, tuple(map(_version, sys.path))))


@lru_cache(1)
def _read_entry_points(
    read: Callable[..., Iterable[EntryPoint]], folders: tuple[tuple[str, int], ...]
) -> dict[str, EntryPoint]:
    """Returns `read()`, read once while these folders of packages are unchanged: it opens many files."""
    return {point.name: point for point in sorted(read(group=GROUP), key=lambda point: point.name)}


def _version(folder: str) -> tuple[str, int]:
    """Returns a folder, and when a member of it was last added or removed."""
    with suppress(OSError):
        return folder, os.stat(folder or ".").st_mtime_ns  # noqa: PTH116
    return folder, 0


def block_names() -> list[str]:
    """Returns the names of all installed blocks, sorted."""
    return list(block_entry_points())


def fmu_folder(flavour: Flavour = Flavour.NATIVE) -> Path:
    """Returns the folder of the FMUs that scenarios run.

    It is in the user's cache, another one for each installation, so that two versions do not overwrite each
    other's FMUs. The environment variable L1_DEPTH_FMUS names another folder. FMUs that another user can have
    written are refused there (`fmus.store`).
    """
    own = store.folder(store.FMUS) / store.digest(str(Path(__file__).resolve().parent).encode())[:12]
    return Path(os.environ.get(FOLDER_VARIABLE) or own).absolute() / flavour.value


def unwritable(folder: Path, error: OSError) -> ExportError:
    """Returns the error for a folder of FMUs that cannot be written, with what to do."""
    reason = f"cannot write FMUs to {folder}: {error.strerror or error}"
    return ExportError(f"{reason}; set {FOLDER_VARIABLE} to another folder")


def fmu_path(block: str, flavour: Flavour = Flavour.NATIVE) -> Path:
    """Returns the file of a block's FMU, whether or not it is built."""
    return fmu_folder(flavour) / f"{block}.fmu"


def is_in_cache(path: Path) -> bool:
    """Whether a path lies in one of the folders of the FMUs that scenarios run."""
    return any(path.absolute().is_relative_to(fmu_folder(flavour)) for flavour in Flavour)


def block_fmus(paths: Iterable[Path]) -> list[tuple[str, Flavour]]:
    """Returns (block, flavour) of those paths that `fmu_path` gives."""
    folders = {flavour: fmu_folder(flavour) for flavour in Flavour}
    known = {
        folders[flavour] / f"{name}.fmu": (name, flavour) for flavour in Flavour for name in block_names()
    }
    return sorted({known[path] for path in paths if path in known})
