"""Building the FMUs of the installed blocks, which `fmus.registry` names, and of the blocks of a file."""

import hashlib
import keyword
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

from fmus.block import Block
from fmus.block_file import blocks_in
from fmus.documentation import reference_files
from fmus.documentation.icon import icon
from fmus.documentation.reference_results import ReferenceRun, reference_run
from fmus.documentation.terminals import terminals
from fmus.errors import ExportError, nearest
from fmus.export import native as native_flavour
from fmus.export import python as python_flavour
from fmus.export.faithful import check_faithful
from fmus.export.guard import location, own_line
from fmus.export.symbolic import traced
from fmus.files import write_archive
from fmus.instance import BlockError, Instance
from fmus.platforms import host_platform, library_name
from fmus.registry import FOLDER_VARIABLE, Flavour, block_entry_points, block_fmus, block_names, fmu_folder

_EXPORTS = {Flavour.NATIVE: native_flavour, Flavour.PYTHON: python_flavour}


def load_block(name: str) -> Block:
    """The block of that name; ExportError offers the nearest one."""
    point = block_entry_points().get(name)
    if point is None:
        file = f"; the file is {name}.py" if Path(f"{name}.py").is_file() else ""
        raise ExportError(f"no block named {name!r}; {nearest(name, block_names())}{file}")
    try:
        block = point.load()
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ExportError(
            f"block {name!r}: its entry point {point.value} cannot be loaded: {reason}"
        ) from error
    if not isinstance(block, Block):
        raise ExportError(f"block {name!r}: its entry point {point.value} is {block!r}: expected a Block")
    if block.name != name:
        raise ExportError(f"entry point {name!r} loads a block named {block.name!r}: expected one name")
    return verified(block)


@contextmanager
def loaded(name_or_path: str) -> Iterator[tuple[Block, ...]]:
    """The installed block of a name, or the blocks of a Python file, until the context ends.

    Raises ExportError for a block that cannot become an FMU.
    """
    if name_or_path.endswith(".py"):
        with blocks_in(Path(name_or_path)) as blocks:
            yield tuple(map(verified, blocks))
    else:
        yield (load_block(name_or_path),)


def verified(block: Block) -> Block:
    """The block, if it takes a step at its start values."""
    name = block.name
    if keyword.iskeyword(name) or not re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name):
        raise ExportError(
            f"block {name!r}: expected ASCII letters, digits and single underscores, and no word of Python's"
        )
    traced(block)  # before a call with numbers, which a function could remember
    trial = Instance(block)
    try:
        trial.exit_initialization_mode()
        trial.do_step(0.0, block.step_size)
        trial.get(len(block.variables) - 1)
    except Exception as error:
        where = location(block.step)
        raise ExportError(
            f"block {name!r}: {where}cannot take a step at its start values: {error!r}"
        ) from error
    return block


def build(
    name: str,
    folder: Path | None = None,
    flavour: Flavour = Flavour.NATIVE,
    platforms: Sequence[str] = (),
    *,
    with_terminals: bool = False,
    reals_only: bool = False,
) -> Path:
    """Write `folder/NAME.fmu`, whatever stands there; by default where scenarios find it.

    platforms: of the libraries in a native FMU, by default this one; those in a python one are PythonFMU's.
    with_terminals: with terminalsAndIcons.xml, which some importers of FMI 2.0 cannot read
    reals_only: a native FMU whose every variable is a Real, for importers that know no other type
    """
    options = {"with_terminals": with_terminals, "reals_only": reals_only}
    return build_block(load_block(name), folder or fmu_folder(flavour), flavour, platforms, **options)


def build_block(
    block: Block,
    folder: Path,
    flavour: Flavour = Flavour.NATIVE,
    platforms: Sequence[str] = (),
    *,
    with_terminals: bool = False,
    reals_only: bool = False,
) -> Path:
    """As `build`, of a block that no entry point names."""
    if reals_only and flavour is not Flavour.NATIVE:
        raise ExportError("an FMU of Reals only: expected the native flavour")
    export = _EXPORTS[flavour]
    _, members = native_flavour.content(block, reals_only) if reals_only else export.content(block)
    check_faithful(block)
    libraries = export.libraries(block.name, members, platforms)
    shown = {"model.png": icon(block)} | reference_files.members(_reference_run(block), block.name)
    shown |= terminals(block) if with_terminals else {}
    return write_archive(folder / f"{block.name}.fmu", members | libraries | shown)


def _reference_run(block: Block) -> ReferenceRun:
    """As `reference_run`; ExportError names the line of the block that cannot go on."""
    try:
        return reference_run(block)
    except BlockError as error:
        own = own_line(error.__cause__) if isinstance(error.__cause__, Exception) else None
        where = f"{own[0]}:{own[1]}: {own[2]}: " if own else location(block.step)
        raise ExportError(f"block {block.name!r}: {where}the reference run ends: {error}") from error


def write_cross_check(block: Block, folder: Path) -> list[Path]:
    """Write what the FMI cross-check wants beside `folder/NAME.fmu`: inputs, results and options."""
    files = reference_files.cross_check_files(reference_run(block), block.name)
    for file, data in files.items():
        (folder / file).write_bytes(data)
    return [folder / file for file in sorted(files)]


def build_if_stale(name: str, folder: Path | None = None, flavour: Flavour = Flavour.NATIVE) -> Path:
    """`folder/NAME.fmu`, built if it is missing, not of the present sources, or of another platform.

    folder: by default the one where scenarios find it
    """
    return _built_if_stale(load_block(name), folder or fmu_folder(flavour), flavour)


def fmu_of_file(path: Path, flavour: Flavour = Flavour.NATIVE) -> Path:
    """The FMU of the only block that a Python file defines, in the user's cache, built if it is stale."""
    with loaded(str(path)) as blocks:
        block, *others = blocks
        if others:
            names = ", ".join(defined.name for defined in blocks)
            raise ExportError(f"{path} defines {names}: expected one block; build them, and choose an FMU")
        digest = hashlib.sha256(str(path.absolute()).encode()).hexdigest()[:12]
        return _built_if_stale(block, fmu_folder(flavour) / digest, flavour)


def _built_if_stale(block: Block, folder: Path, flavour: Flavour) -> Path:
    path = folder / f"{block.name}.fmu"
    guid, _ = _EXPORTS[flavour].content(block)
    needed = library_name(block.name, host_platform()) if flavour is Flavour.NATIVE else None
    return path if _is_present(path, guid, needed) else build_block(block, folder, flavour)


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
