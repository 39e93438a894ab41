"""Registry of what is installed and of the paths of FMUs; nothing is built here.

Blocks, commands and places where runs are made are entry points, which other packages can have, too: for
example `MyBlock = "my_package.my_module:BLOCK"` in the group `l1_depth.blocks`.
"""

import os
import sys
from collections.abc import Callable, Iterable
from contextlib import suppress
from enum import StrEnum
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fmus import store
from fmus.errors import ExportError

BLOCKS, COMMANDS, PLACES = "l1_depth.blocks", "l1_depth.commands", "l1_depth.places"
"""Groups of entry points."""
FOLDER_VARIABLE = "L1_DEPTH_FMUS"


class Flavour(StrEnum):
    """Flavour of an FMU: compiled, or on the Python of whoever imports it."""

    NATIVE = "native"
    PYTHON = "python"


def installed(group: str) -> dict[str, EntryPoint]:
    """Returns the entry points of a group by name, sorted.

    Commands and places without their module are left out, for example after its folder was removed. A block
    without its module is an error when it is built. The packages above a module are imported.
    """
    return dict(_read_entry_points(entry_points, group, tuple(map(_version, sys.path))))


@lru_cache(3)
def _read_entry_points(
    read: Callable[..., Iterable[EntryPoint]], group: str, folders: tuple[tuple[str, int], ...]
) -> dict[str, EntryPoint]:
    """Returns the entry points of a group by name, read once while these folders are unchanged."""
    # cached: to read them opens many files
    points = sorted(read(group=group), key=lambda point: point.name)
    return {point.name: point for point in points if group == BLOCKS or _is_there(point.module)}


def _is_there(module: str) -> bool:
    try:
        return find_spec(module) is not None
    except ModuleNotFoundError as error:
        # another name: the package above the module lacks a library, an error that loading reports
        return not f"{module}.".startswith(f"{error.name}.")
    except Exception:  # of a package above the module, which loading reports
        return True


def load(point: EntryPoint, kind: str) -> Any:
    """Returns the object that an entry point names; ExportError if it cannot be loaded. kind: "block" """
    try:
        return point.load()
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ExportError(
            f"{kind} {point.name!r}: its entry point {point.value} cannot be loaded: {reason}"
        ) from error


def _version(folder: str) -> tuple[str, int]:
    """Returns a folder, and the time of the last addition or removal of a member [ns]."""
    with suppress(OSError):
        return folder, os.stat(folder or ".").st_mtime_ns  # noqa: PTH116
    return folder, 0


def block_names() -> list[str]:
    """Returns the names of all installed blocks, sorted."""
    return list(installed(BLOCKS))


def fmu_folder(flavour: Flavour = Flavour.NATIVE) -> Path:
    """Returns the folder of the FMUs that scenarios run.

    It is in the user's cache. The environment variable L1_DEPTH_FMUS names another folder. FMUs that another
    user can have written are refused there (`fmus.store`).
    """
    # one folder per installation: two versions must not overwrite each other's FMUs
    own = store.folder(store.FMUS) / store.digest(str(Path(__file__).resolve().parent).encode())[:12]
    return Path(os.environ.get(FOLDER_VARIABLE) or own).absolute() / flavour.value


def unwritable(folder: Path, error: OSError) -> ExportError:
    """Returns the error for a folder of FMUs that cannot be written, with a remedy."""
    reason = f"cannot write FMUs to {folder}: {error.strerror or error}"
    return ExportError(f"{reason}; set {FOLDER_VARIABLE} to another folder")


def fmu_path(block: str, flavour: Flavour = Flavour.NATIVE) -> Path:
    """Returns the file of a block's FMU, whether or not it is built."""
    return fmu_folder(flavour) / f"{block}.fmu"


def is_in_cache(path: Path) -> bool:
    """Whether a path lies in one of the folders of the FMUs that scenarios run."""
    return any(path.absolute().is_relative_to(fmu_folder(flavour)) for flavour in Flavour)


def block_fmus(paths: Iterable[Path]) -> list[tuple[str, Flavour]]:
    """Returns (block, flavour) of each path that `fmu_path` returns."""
    folders = {flavour: fmu_folder(flavour) for flavour in Flavour}
    known = {
        folders[flavour] / f"{name}.fmu": (name, flavour) for flavour in Flavour for name in block_names()
    }
    return sorted({known[path] for path in paths if path in known})
