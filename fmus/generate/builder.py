"""Building the FMUs of the installed blocks, which `fmus.registry` names, and of the blocks of a file."""

import io
import keyword
import os
import re
import zipfile
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, nullcontext, suppress
from pathlib import Path
from xml.etree import ElementTree

from fmus import store
from fmus.block import Block
from fmus.block.block_file import DEVICES, blocks_in, from_sources
from fmus.block.instance import BlockError, BlockInstance
from fmus.errors import ExportError, nearest
from fmus.files import packed, write_bytes_atomically
from fmus.fmi.binding import library_member
from fmus.generate import native as native_flavour
from fmus.generate import python as python_flavour
from fmus.generate.check_sampling import check_sampling
from fmus.generate.check_trace import check_shipped, check_trace
from fmus.generate.documentation import reference_results
from fmus.generate.documentation.reference_results import ReferenceRun, reference_run
from fmus.generate.documentation.terminals_and_icon import icon, terminals
from fmus.generate.fmi3 import variable_names
from fmus.generate.guard import location, own_line
from fmus.generate.shipped import ShippedLibrary
from fmus.generate.stamp import BuildCache, BuildRequest, order_of_file
from fmus.generate.symbolic import traced
from fmus.operating_system import usable_processors
from fmus.platforms import host_platform, library_name
from fmus.registry import BLOCKS, Flavour, block_fmus, block_names, fmu_folder, installed, unwritable

_AT_ONCE = usable_processors()  # orders that are compiled
_ICONS = {2: "model.png", 3: "terminalsAndIcons/icon.png"}


def load_block(name: str) -> Block:
    """Returns the block of that name; ExportError offers the nearest one."""
    point = installed(BLOCKS).get(name)
    if point is None:
        file = f"; the file is {name}.py" if Path(f"{name}.py").is_file() else ""
        raise ExportError(f"no block named {name!r}; {nearest(name, block_names())}{file}")
    try:
        with from_sources():
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
    """Yields the installed block of a name, or the blocks of a Python file, until the context ends.

    Raises ExportError for a block that cannot become an FMU.
    """
    try:
        if name_or_path.endswith(".py"):
            with blocks_in(Path(name_or_path)) as blocks:
                yield tuple(map(verified, blocks))
        else:
            yield (load_block(name_or_path),)
    except SystemExit as error:
        file, line, expression = own_line(error) or (name_or_path, 1, "a function")
        raise ExportError(f"{file}:{line}: {expression}: ends Python: expected a returned value") from error


def verified(block: Block) -> Block:
    """Returns the block, if it takes a step at its start values."""
    name = block.name
    is_word = re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name)
    if not is_word or keyword.iskeyword(name) or name.lower() in DEVICES:
        raise ExportError(
            f"block {name!r}: expected ASCII letters, digits and single underscores, and no word of Python's "
            "or device of Windows"
        )
    traced(block)  # before a call with numbers, which a function could remember
    trial = BlockInstance(block)
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


def build_block(
    block: Block | str,
    folder: Path,
    flavour: Flavour = Flavour.NATIVE,
    platforms: Sequence[str] = (),
    *,
    with_terminals: bool = False,
    reals_only: bool = False,
    fmi: int = 2,
) -> Path:
    """Writes `folder/NAME.fmu` of a block, or of the installed block of a name, whatever stands there.

    platforms: of the libraries in a native FMU, by default this one; those in a python one are PythonFMU's.
    with_terminals: with terminalsAndIcons.xml, which some importers of FMI 2.0 cannot read
    reals_only: a native FMU whose every variable is a Real, for importers that know no other type
    fmi: the version of the standard, 2 or 3; 3 in the native flavour alone
    """
    block = load_block(block) if isinstance(block, str) else block
    order = BuildRequest(block.name, folder, flavour, tuple(platforms), with_terminals, reals_only, fmi=fmi)
    with _building(block, order) as write:
        return next(iter(write()))


@contextmanager
def _building(block: Block, order: BuildRequest) -> Iterator[Callable[[], dict[Path, bytes]]]:
    """Yields a function that writes the FMU of a block, whose libraries are compiled meanwhile.

    The function returns the files that it wrote: the FMU, then what belongs to it.
    """
    if order.reals_only and (order.flavour is not Flavour.NATIVE or order.fmi != 2):
        raise ExportError("an FMU of Reals only: expected the native flavour and FMI 2.0")
    if order.fmi not in native_flavour.COMPILED or (order.fmi == 3 and order.flavour is not Flavour.NATIVE):
        raise ExportError(
            f"FMI {order.fmi}.0 in the {order.flavour} flavour: expected FMI 2.0, or 3.0 in native"
        )
    if order.platforms and order.flavour is not Flavour.NATIVE:
        raise ExportError(
            "platforms of the python flavour: expected none, its libraries are PythonFMU's; "
            "the native flavour is compiled for each"
        )
    guid, members = _content(block, order)
    compiling = nullcontext(dict[str, bytes])
    if order.flavour is Flavour.NATIVE:
        compiling = native_flavour.compiled_libraries(block.name, members, order.platforms, order.fmi)
    with compiling as libraries:
        compared = check_trace(block)
        check_sampling(block)
        reference = _reference_run(block)
        shown = {_ICONS[order.fmi]: icon(block)} | reference_results.members(reference, block.name)
        if order.with_terminals or order.fmi == 3:
            shown |= terminals(block, variable_names) if order.fmi == 3 else terminals(block)

        def write() -> dict[Path, bytes]:
            built = libraries()
            if path := library_member(built, block.name, order.fmi):
                # OSError: no library can be loaded from where temporary files are
                shipped = block, guid, built[path], order.fmi
                with suppress(OSError), closing(ShippedLibrary(*shipped)) as library:
                    check_shipped(compared, library)
            if order.flavour is Flavour.NATIVE:
                built |= native_flavour.bill_of_materials(block, built | shown, order.fmi)
            files = {order.folder / f"{block.name}.fmu": packed(members | built | shown)}
            if order.with_cross_check:
                beside = reference_results.cross_check_files(reference, block.name)
                files |= {order.folder / name: beside[name] for name in sorted(beside)}
            is_cached = order.folder.is_relative_to(fmu_folder(order.flavour))
            write_file = store.write if is_cached else write_bytes_atomically
            store.record_build(next(iter(files.values())))
            for path, content in files.items():
                write_file(path, content)
            return files

        yield write


def _content(block: Block, order: BuildRequest) -> tuple[str, dict[str, bytes]]:
    """Returns (GUID, path -> content) of the FMU without libraries that are compiled."""
    if order.flavour is Flavour.NATIVE:
        return native_flavour.content(block, order.reals_only, order.fmi)
    return python_flavour.content(block)


def _reference_run(block: Block) -> ReferenceRun:
    """Returns the reference run; ExportError names the line of the block that cannot go on."""
    try:
        return reference_run(block)
    except BlockError as error:
        own = own_line(error.__cause__) if isinstance(error.__cause__, Exception) else None
        where = f"{own[0]}:{own[1]}: {own[2]}: " if own else location(block.step)
        raise ExportError(f"block {block.name!r}: {where}the reference run ends: {error}") from error


def build_orders(orders: Iterable[BuildRequest]) -> Iterator[list[Path] | ExportError]:
    """Writes the FMUs of each order, whatever stands there, and stamps them.

    Yields the files of each, or the error that prevents it. Some are compiled while the next are traced.
    """
    compiling: deque[_CompilingOrder | ExportError] = deque()
    with ExitStack() as stack:
        for order in orders:
            try:
                compiling.append(_CompilingOrder(order, stack))
            except ExportError as error:
                compiling.append(error)
            if len(compiling) > _AT_ONCE:
                yield _ended(compiling.popleft())
        yield from map(_ended, compiling)


def _ended(order: "_CompilingOrder | ExportError") -> list[Path] | ExportError:
    try:
        return order if isinstance(order, ExportError) else order.written()
    except ExportError as error:
        return error


class _CompilingOrder:
    """An order whose FMUs are being compiled; it does not outlive the stack."""

    def __init__(self, order: BuildRequest, stack: ExitStack) -> None:
        self._stamps = BuildCache()
        sources = self._stamps.sources(order)
        with loaded(order.source) as blocks:
            self._writers = [stack.enter_context(_building(block, order)) for block in blocks]
            self._sources = sources and sources.if_loaded

    def written(self) -> list[Path]:
        files = {path: content for write in self._writers for path, content in write().items()}
        fmus = {path.name: content for path, content in files.items() if path.suffix == ".fmu"}
        self._stamps.write(self._sources, fmus)
        return [*files]


def build_if_stale(name: str, folder: Path | None = None, flavour: Flavour = Flavour.NATIVE) -> Path:
    """Returns `folder/NAME.fmu`, built if missing, not of the present sources, or of another platform.

    folder: by default the one where scenarios find it
    """
    return _built_if_stale(BuildRequest(name, folder or fmu_folder(flavour), flavour))


def fmu_of_file(path: Path, flavour: Flavour = Flavour.NATIVE) -> Path:
    """Returns the FMU of the only block of a Python file, in the user's cache, built if it is stale."""
    return _built_if_stale(order_of_file(path, flavour))


def _built_if_stale(order: BuildRequest) -> Path:
    """Returns the FMU of the only block of an order."""
    stamps = BuildCache()
    if current := stamps.current(order, to_run=True):
        return current[0]
    sources = stamps.sources(order)
    with loaded(order.source) as blocks:
        block, *others = blocks
        if others:
            names = ", ".join(defined.name for defined in blocks)
            raise ExportError(
                f"{order.source} defines {names}: expected one block; build them, and choose an FMU"
            )
        path = order.folder / f"{block.name}.fmu"
        guid, _ = _content(block, order)
        native = order.flavour is Flavour.NATIVE
        needed = library_name(block.name, host_platform()) if native else None
        found = path.read_bytes() if path.is_file() else b""
        fits = _fits(found, guid, needed)
        # without a record of its build, it would run like one of another tool
        fits = fits and (store.is_own_build(found) or not os.access(path.parent, os.W_OK))
        if not fits:
            with _building(block, order) as write:
                found = write()[path]
        stamps.write(sources and sources.if_loaded, {path.name: found}, was_built=not fits)
    return path


def build_missing(paths: Iterable[Path]) -> None:
    """Builds those of the paths that scenarios find the FMUs of blocks at, where missing or stale."""
    for name, flavour in block_fmus(paths):
        try:
            build_if_stale(name, flavour=flavour)
        except OSError as error:
            raise unwritable(fmu_folder(flavour), error) from error


def _fits(fmu: bytes, guid: str, library: str | None) -> bool:
    """Whether an FMU runs as what was traced; its GUID does not tell its icon, for one."""
    try:
        with zipfile.ZipFile(io.BytesIO(fmu)) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            is_complete = not archive.testzip() and (library is None or library in archive.namelist())
    except (zipfile.BadZipFile, zlib.error, KeyError, ElementTree.ParseError):
        return False
    return is_complete and root.get("guid") == guid
