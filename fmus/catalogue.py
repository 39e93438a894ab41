"""Building the FMUs of the installed blocks, which `fmus.registry` names."""

import re
import zipfile
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from xml.etree import ElementTree

from fmus.block import Block
from fmus.documentation import reference_files
from fmus.documentation.icon import icon
from fmus.documentation.reference_results import reference_run
from fmus.errors import ExportError, nearest
from fmus.export import native as native_flavour
from fmus.export import python as python_flavour
from fmus.export.faithful import check_faithful
from fmus.export.symbolic import traced
from fmus.files import write_archive
from fmus.instance import Instance
from fmus.platforms import host_platform, library_name
from fmus.registry import FOLDER_VARIABLE, Flavour, block_entry_points, block_fmus, block_names, fmu_folder

_EXPORTS = {Flavour.NATIVE: native_flavour, Flavour.PYTHON: python_flavour}


def load_block(name: str) -> Block:
    """The block of that name; ExportError offers the nearest one."""
    point = block_entry_points().get(name)
    if point is None:
        raise ExportError(f"no block named {name!r}; {nearest(name, block_names())}")
    return _verified(name, point.load())


def _verified(name: str, block: Block) -> Block:
    """The block, if it bears the name it goes by and takes a step at its start values."""
    if block.name != name:
        raise ExportError(f"entry point {name!r} loads a block named {block.name!r}: expected one name")
    if not re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name):
        raise ExportError(f"block {name!r}: expected ASCII letters, digits and single underscores")
    if "internal_step" not in {v.name for v in block.of_causality("parameter")}:
        raise ExportError(f"block {name!r}: expected a parameter internal_step, its longest step in s")
    traced(block)  # before a call with numbers, which a function could remember
    trial = Instance(block)
    try:
        trial.exit_initialization_mode()
        trial.do_step(0.0, block.step_size)
        trial.get(len(block.variables) - 1)
    except Exception as error:
        raise ExportError(f"block {name!r} cannot take a step at its start values: {error!r}") from error
    return block


def build(
    name: str,
    folder: Path | None = None,
    flavour: Flavour = Flavour.NATIVE,
    platforms: Sequence[str] = (),
) -> Path:
    """Write `folder/NAME.fmu`, whatever stands there; by default where scenarios find it.

    platforms: of the libraries in a native FMU, by default this one; those in a python one are PythonFMU's.
    """
    return build_block(load_block(name), folder or fmu_folder(flavour), flavour, platforms)


def build_block(
    block: Block, folder: Path, flavour: Flavour = Flavour.NATIVE, platforms: Sequence[str] = ()
) -> Path:
    """As `build`, of a block that no entry point names."""
    export = _EXPORTS[flavour]
    _, members = export.content(block)
    check_faithful(block)
    libraries = export.libraries(block.name, members, platforms)
    shown = {"model.png": icon(block)} | reference_files.members(reference_run(block), block.name)
    return write_archive(folder / f"{block.name}.fmu", members | libraries | shown)


def write_cross_check(name: str, folder: Path) -> list[Path]:
    """Write what the FMI cross-check wants beside `folder/NAME.fmu`: inputs, results and options."""
    files = reference_files.cross_check_files(reference_run(load_block(name)), name)
    for file, data in files.items():
        (folder / file).write_bytes(data)
    return [folder / file for file in sorted(files)]


def build_if_stale(name: str, folder: Path | None = None, flavour: Flavour = Flavour.NATIVE) -> Path:
    """`folder/NAME.fmu`, built if it is missing, not of the present sources, or of another platform.

    folder: by default the one where scenarios find it
    """
    path = (folder or fmu_folder(flavour)) / f"{name}.fmu"
    guid, _ = _EXPORTS[flavour].content(load_block(name))
    needed = library_name(name, host_platform()) if flavour is Flavour.NATIVE else None
    return path if _is_present(path, guid, needed) else build(name, path.parent, flavour)


def build_missing(paths: Iterable[Path]) -> None:
    """Build those of the paths that scenarios find the FMUs of blocks at, where missing or stale."""
    for name, flavour in block_fmus(paths):
        try:
            build_if_stale(name, flavour=flavour)
        except OSError as error:
            raise ExportError(
                f"cannot write FMUs to {fmu_folder(flavour)}: {error.strerror}; "
                f"set {FOLDER_VARIABLE} to another folder"
            ) from error


def _is_present(path: Path, guid: str, library: str | None) -> bool:
    try:
        with zipfile.ZipFile(path) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            is_complete = not archive.testzip() and (library is None or library in archive.namelist())
    except (OSError, zipfile.BadZipFile, zlib.error, KeyError, ElementTree.ParseError):
        return False
    return is_complete and root.get("guid") == guid
