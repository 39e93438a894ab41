"""Building the FMUs of the installed blocks, which `fmus.registry` names, and of the blocks of a file."""

import io
import keyword
import os
import re
import zipfile
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

from fmus import store
from fmus.block import Block
from fmus.block.block_file import DEVICES, blocks_in, from_sources
from fmus.block.instance import BlockError, BlockInstance
from fmus.errors import ExportError, nearest
from fmus.files import packed, write_bytes_atomically
from fmus.fmi.binding import library_member
from fmus.generate.archive import bill_of_materials, native_members, python_members
from fmus.generate.cache import BuildCache, BuildRequest, order_of_file
from fmus.generate.describe import variable_names
from fmus.generate.documentation import reference_results
from fmus.generate.documentation.reference_results import ReferenceRun, reference_run
from fmus.generate.documentation.terminals_and_icon import icon, terminals
from fmus.generate.guard import location, own_line
from fmus.generate.native import COMPILED, ShippedLibrary, compiled_libraries
from fmus.generate.trace import Traced, trace
from fmus.generate.verify import Comparison, check_sampling, check_shipped, check_trace
from fmus.operating_system import usable_processors
from fmus.platforms import host_platform, library_name
from fmus.registry import BLOCKS, Flavour, block_fmus, block_names, fmu_folder, installed, load, unwritable

# build requests that are compiled at the same time: one compiler keeps one processor busy
_AT_ONCE = usable_processors()
_ICONS = {2: "model.png", 3: "terminalsAndIcons/icon.png"}


def load_block(name: str) -> Block:
    """Returns the block of that name; ExportError offers the nearest one."""
    point = installed(BLOCKS).get(name)
    if point is None:
        file = f"; the file is {name}.py" if Path(f"{name}.py").is_file() else ""
        raise ExportError(f"no block named {name!r}; {nearest(name, block_names())}{file}")
    with from_sources():
        block = load(point, "block")
    if not isinstance(block, Block):
        raise ExportError(f"block {name!r}: its entry point {point.value} is {block!r}: expected a Block")
    if block.name != name:
        raise ExportError(f"entry point {name!r} loads a block named {block.name!r}: expected one name")
    return block


@contextmanager
def loaded(name_or_path: str) -> Iterator[tuple[Traced, ...]]:
    """Yields the traced installed block of a name, or the traced blocks of a Python file.

    The modules of the file stay loaded until the context ends.
    Raises ExportError for a block that cannot become an FMU.
    """
    try:
        if name_or_path.endswith(".py"):
            with blocks_in(Path(name_or_path)) as blocks:
                yield tuple(map(verified, blocks))
        else:
            yield (verified(load_block(name_or_path)),)
    except SystemExit as error:
        file, line, expression = own_line(error) or (name_or_path, 1, "a function")
        raise ExportError(f"{file}:{line}: {expression}: ends Python: expected a returned value") from error


def verified(block: Block) -> Traced:
    """Returns the traced block; ExportError if it cannot take a step at its start values."""
    name = block.name
    is_word = re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", name)
    if not is_word or keyword.iskeyword(name) or name.lower() in DEVICES:
        raise ExportError(
            f"block {name!r}: expected ASCII letters, digits and single underscores, and no word of Python's "
            "or device of Windows"
        )
    # Tracing comes before the first call with numbers: a function could keep numbers from that call.
    traced = trace(block)
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
    return traced


def build_block(
    block: Block | str,
    folder: Path,
    flavour: Flavour = Flavour.NATIVE,
    platforms: Sequence[str] = (),
    *,
    with_terminals: bool = False,
    reals_only: bool = False,
    fmi: int = 2,
    scalars: bool = False,
) -> Path:
    """Writes `folder/NAME.fmu` of a block, in place of a file that is there, and returns its path.

    Parameters
    ----------
    block : Block or str
        A block, or the name of an installed one.
    folder : Path
        Folder of the FMU.
    flavour : Flavour
        Compiled (native), or run by Python.
    platforms : sequence of str
        Platforms of the libraries in a native FMU, by default this one; none for a python FMU.
    with_terminals : bool
        Whether to add terminalsAndIcons.xml, which some importers of FMI 2.0 cannot read.
    reals_only : bool
        Whether every variable is a Real, for importers that support no other type; native flavour alone.
    fmi : int
        Version of the standard, 2 or 3; 3 in the native flavour alone.
    scalars : bool
        Whether the elements of arrays are variables, for importers of FMI 3.0 without arrays.

    Raises
    ------
    ExportError
        If the block cannot become such an FMU. The message names the file and line.
    """
    traced = verified(load_block(block)) if isinstance(block, str) else trace(block)
    name = traced.block.name
    order = BuildRequest(
        name, folder, flavour, tuple(platforms), with_terminals, reals_only, fmi=fmi, scalars=scalars
    )
    with ExitStack() as stack:
        return next(iter(_written(_compiling(_content(traced, order), stack))))


@dataclass(frozen=True)
class _Content:
    """The members of an FMU that decide its GUID; the libraries are not among them."""

    traced: Traced
    order: BuildRequest
    guid: str
    members: dict[str, bytes]


@dataclass(frozen=True)
class _Compiling:
    """An FMU whose libraries are compiled beside this process.

    compared: the calls that the compiled library must repeat
    shown: members that do not decide the GUID: icon, terminals, reference results
    libraries: waits for the compiler; returns path inside the FMU -> library
    """

    content: _Content
    compared: dict[str, Comparison]
    reference: ReferenceRun
    shown: dict[str, bytes]
    libraries: Callable[[], dict[str, bytes]]


def _content(traced: Traced, order: BuildRequest) -> _Content:
    """Returns the content of a build request; ExportError for options that the flavour does not have."""
    is_native = order.flavour is Flavour.NATIVE
    if order.reals_only and (not is_native or order.fmi != 2):
        raise ExportError("an FMU of Reals only: expected the native flavour and FMI 2.0")
    if order.fmi not in COMPILED or (order.fmi == 3 and not is_native):
        raise ExportError(
            f"FMI {order.fmi}.0 in the {order.flavour} flavour: expected FMI 2.0, or 3.0 in native"
        )
    if order.scalars and order.fmi != 3:
        raise ExportError("an FMU of scalars: expected FMI 3.0; FMI 2.0 has no arrays")
    if order.platforms and not is_native:
        raise ExportError(
            "platforms of the python flavour: expected none, its libraries are PythonFMU's; "
            "the native flavour is compiled for each"
        )
    if not is_native:
        return _Content(traced, order, *python_members(traced))
    return _Content(traced, order, *native_members(traced, order.reals_only, order.fmi, order.scalars))


def _compiling(content: _Content, stack: ExitStack) -> _Compiling:
    """Starts the compiler, which does not outlive the stack, and checks the block meanwhile."""
    block, order = content.traced.block, content.order
    libraries: Callable[[], dict[str, bytes]] = dict
    if order.flavour is Flavour.NATIVE:
        started = compiled_libraries(block.name, content.members, order.platforms, order.fmi)
        libraries = stack.enter_context(started)
    compared = check_trace(content.traced)
    check_sampling(block)
    reference = _reference_run(block)
    shown = {_ICONS[order.fmi]: icon(block)} | reference_results.members(reference, block.name)
    if order.with_terminals or order.fmi == 3:
        has_arrays = order.fmi == 3 and not order.scalars
        shown |= terminals(block, variable_names) if has_arrays else terminals(block)
    return _Compiling(content, compared, reference, shown, libraries)


def _written(compiling: _Compiling) -> dict[Path, bytes]:
    """Writes an FMU once its libraries are compiled; returns the FMU, then the files beside it."""
    content, order, block = compiling.content, compiling.content.order, compiling.content.traced.block
    built = compiling.libraries()
    if path := library_member(built, block.name, order.fmi):
        # Without the check where no library can be loaded from the folder of temporary files: OSError.
        shipped = content.traced, content.guid, built[path], order.fmi
        with suppress(OSError), closing(ShippedLibrary(*shipped)) as library:
            check_shipped(compiling.compared, library)
    built |= compiling.shown
    if order.flavour is Flavour.NATIVE:
        built |= bill_of_materials(block, built, order.fmi)
    files = {order.folder / f"{block.name}.fmu": packed(content.members | built)}
    if order.with_cross_check:
        beside = reference_results.cross_check_files(compiling.reference, block.name)
        files |= {order.folder / name: beside[name] for name in sorted(beside)}
    is_cached = order.folder.is_relative_to(fmu_folder(order.flavour))
    write_file = store.write if is_cached else write_bytes_atomically
    store.record_build(next(iter(files.values())))
    for path, data in files.items():
        write_file(path, data)
    return files


def _reference_run(block: Block) -> ReferenceRun:
    """Returns the reference run; ExportError names the line of the block that fails."""
    try:
        return reference_run(block)
    except BlockError as error:
        own = own_line(error.__cause__) if isinstance(error.__cause__, Exception) else None
        where = f"{own[0]}:{own[1]}: {own[2]}: " if own else location(block.step)
        raise ExportError(f"block {block.name!r}: {where}the reference run ends: {error}") from error


def build_orders(orders: Iterable[BuildRequest]) -> Iterator[list[Path] | ExportError]:
    """Writes the FMUs of each build request, in place of present files, and stamps them.

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
            self._compiling = [_compiling(_content(traced, order), stack) for traced in blocks]
            self._sources = sources and sources.if_loaded

    def written(self) -> list[Path]:
        files = {path: content for one in self._compiling for path, content in _written(one).items()}
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
        traced, *others = blocks
        if others:
            names = ", ".join(defined.block.name for defined in blocks)
            raise ExportError(
                f"{order.source} defines {names}: expected one block; build them, and choose an FMU"
            )
        name, content = traced.block.name, _content(traced, order)
        path = order.folder / f"{name}.fmu"
        needed = library_name(name, host_platform()) if order.flavour is Flavour.NATIVE else None
        found = path.read_bytes() if path.is_file() else b""
        fits = _fits(found, content.guid, needed)
        # Without a record of its build, an FMU runs with the precautions for FMUs of other tools.
        fits = fits and (store.is_own_build(found) or not os.access(path.parent, os.W_OK))
        if not fits:
            with ExitStack() as stack:
                found = _written(_compiling(content, stack))[path]
        stamps.write(sources and sources.if_loaded, {path.name: found}, was_built=not fits)
    return path


def build_missing(paths: Iterable[Path]) -> None:
    """Builds missing and stale FMUs of blocks; paths: of FMUs that a scenario needs."""
    for name, flavour in block_fmus(paths):
        try:
            build_if_stale(name, flavour=flavour)
        except OSError as error:
            raise unwritable(fmu_folder(flavour), error) from error


def _fits(fmu: bytes, guid: str, library: str | None) -> bool:
    """Whether an FMU is complete and has this GUID; members that do not decide the GUID may differ."""
    try:
        with zipfile.ZipFile(io.BytesIO(fmu)) as archive:
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            is_complete = not archive.testzip() and (library is None or library in archive.namelist())
    except (zipfile.BadZipFile, zlib.error, KeyError, ElementTree.ParseError):
        return False
    return is_complete and root.get("guid") == guid
