"""Stamps of built FMUs, by which an unchanged FMU is recognised without tracing its block again.

A stamp names FMUs by their content and lists the files that decide it: files of the block and of its imports.
The files of this package, the libraries that build, and the options are in the key of the stamp in the store.
A block that may depend on anything else, such as a file that it reads when it is imported, gets no stamp: it
is traced each time.
"""

import json
import os
import platform
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial
from importlib.machinery import SourceFileLoader
from importlib.metadata import distributions
from pathlib import Path

import fmus
from fmus import store
from fmus.block.block_file import SourceLoader
from fmus.generate.imports import Import, ImpureError, Modules, may_take, pure_imports
from fmus.registry import BLOCKS, Flavour, block_fmus, fmu_folder, fmu_path, installed

# The version of l1-depth stands for the interfaces of its blocks, which the page of every FMU lists.
_LIBRARIES = ("casadi", "fmpy", "l1-depth", "pillow", "pint", "pythonfmu", "ziglang")
# folders of this package that no FMU is made from
_NOT_BUILDING = ("compliance",)
# no module of a name, or one of Python's or of this package's
_NO_FILE = "", ""
# A file that changed so shortly before the process began may have been loaded in its earlier form.
_RECENT_S = 2.0


@dataclass(frozen=True)
class BuildRequest:
    """A build order.

    source: name of an installed block, or path of a Python file; platforms: by default this one
    with_cross_check: with the files of the FMI cross-check beside each FMU
    fmi: the version of the standard, 2 or 3
    scalars: whether the elements of arrays are variables of FMI 3.0
    """

    source: str
    folder: Path
    flavour: Flavour = Flavour.NATIVE
    platforms: tuple[str, ...] = ()
    with_terminals: bool = False
    reals_only: bool = False
    with_cross_check: bool = False
    fmi: int = 2
    scalars: bool = False

    @property
    def file(self) -> str:
        """The absolute path of the Python file; "" for an installed block."""
        return str(Path(self.source).absolute()) if self.source.endswith(".py") else ""

    @property
    def beside(self) -> str:
        """The folder of the Python file, where its modules are found first; "" for an installed block."""
        return str(Path(self.file).parent) if self.file else ""


def order_of_file(path: Path, flavour: Flavour) -> BuildRequest:
    """Returns the build request of a Python file that a command runs, in a folder of the user's cache."""
    folder = store.digest(str(path.absolute()).encode())[:12]
    return BuildRequest(str(path), fmu_folder(flavour) / folder, flavour)


def stale(paths: Iterable[Path]) -> list[Path]:
    """Returns the paths of FMUs of installed blocks that may have to be built."""
    stamps = BuildCache()
    orders = {
        fmu_path(name, flavour): BuildRequest(name, fmu_folder(flavour), flavour)
        for name, flavour in block_fmus(paths)
    }
    return [path for path, order in orders.items() if not stamps.current(order, to_run=True)]


@dataclass(frozen=True)
class Sources:
    """Sources of an order.

    key: of its stamp, which follows from everything but the modules
    modules: name -> (file, digest), or `_NO_FILE`
    changed: when one of the files was changed last [s since the epoch]
    """

    key: str
    modules: dict[str, tuple[str, str]]
    changed: float

    @property
    def if_loaded(self) -> "Sources | None":
        """These, if this process has imported the modules from these files, and all after `fmus`."""
        modules = {name: module for name, module in self.modules.items() if module != _NO_FILE}
        are_loaded = all(_is_loaded(name, *module) for name, module in modules.items())
        return self if are_loaded and not fmus.IMPORTED_BEFORE.intersection(modules) else None


class BuildCache:
    """The stamps of this user, and files as they are while this object is used: each is read once.

    package: the folder of `fmus`; begun: when this process began to import modules [s since the epoch]
    """

    def __init__(self, package: Path = Path(fmus.__file__).parent, begun: float = fmus.IMPORTED_AT) -> None:
        self._package, self._begun = package, begun
        self._modules = Modules()
        store.keep_fmus()

    def current(self, order: BuildRequest, to_run: bool = False) -> list[Path] | None:
        """Returns the FMUs of an order if a build would give the same ones; None if this is uncertain.

        to_run: whether members that runs do not need, such as icons, may differ
        """
        with suppress(ImpureError, OSError):
            stamp = json.loads(store.get(store.BUILDS, self._key(order)) or b"null")
            if not stamp or not (to_run or stamp["was_built"]):
                return None
            if all([*self._module(name, order)] == module for name, module in stamp["modules"].items()):
                files = {order.folder / name: digest for name, digest in stamp["fmus"].items()}
                if all(store.digest(path.read_bytes()) == digest for path, digest in files.items()):
                    return [*files]
        return None

    def sources(self, order: BuildRequest) -> Sources | None:
        """Returns the present sources of an order; None if they cannot be known from files alone."""
        with suppress(ImpureError, ImportError, OSError, SyntaxError, ValueError):
            root = Path(order.file).stem if order.file else self._origin(order).partition(":")[0]
            names = self._modules.closure([root], partial(self._followed, order), order.beside)
            modules = {name: self._module(name, order) for name in names}
            key, (changed, _) = self._key(order), self._own_files
            return Sources(key, modules, max(changed, self._modules.changed))
        return None

    def write(self, sources: Sources | None, fmus: Mapping[str, bytes], was_built: bool = True) -> None:
        """Stamps FMUs, unless one of the sources may have changed since it was imported.

        sources: from before they were imported, and only if they were loaded
        fmus: content by the name of the file, where another process may have written since
        was_built: whether they were built now; else they were found with the GUID of the traced block
        """
        if sources and sources.changed <= self._begun - _RECENT_S:
            digests = {name: store.digest(fmu) for name, fmu in fmus.items()}
            content = {"modules": sources.modules, "fmus": digests, "was_built": was_built}
            store.put(store.BUILDS, sources.key, json.dumps(content).encode())

    def _key(self, order: BuildRequest) -> str:
        """Returns the digest of the folder, and of all but modules that decides about the FMUs in it."""
        options = order.flavour, order.platforms, order.with_terminals, order.reals_only, order.fmi
        host = sys.version, sys.flags.optimize, sys.platform, platform.machine()
        date = os.environ.get("SOURCE_DATE_EPOCH")
        parts = str(order.folder.absolute()), self._origin(order), *options, order.scalars, *host, date
        return store.digest(*parts, self._libraries, self._own_files[1])

    def _origin(self, order: BuildRequest) -> str:
        """Returns MODULE:NAME of an installed block, or the path of a file."""
        point = installed(BLOCKS).get(order.source)
        if not order.file and point is None:
            raise ImpureError(order.source)
        return order.file or getattr(point, "value", "")

    @cached_property
    def _libraries(self) -> list[tuple[str, ...]]:
        """Metadata and licence of the libraries that build; an editable one may be found more than once."""
        files = "METADATA", "PKG-INFO", "licenses/LICENSE"
        found = ((name, distribution) for name in _LIBRARIES for distribution in distributions(name=name))
        return sorted({(name, *(one.read_text(file) or "" for file in files)) for name, one in found})

    @cached_property
    def _own_files(self) -> tuple[float, list[tuple[str, str]]]:
        """The last change [s] and the digests by path of the files of this package that decide about FMUs."""
        files = [*store.digests(self._package, _NOT_BUILDING)]
        return max(changed for *_, changed in files), [(path, digest) for path, digest, _ in files]

    def _followed(self, order: BuildRequest, name: str, file: str) -> Iterator[Import]:
        """Yields the imports of a pure module; of Python, the names that no file of the user's may hide."""
        for base, members in pure_imports(self._modules.read(file), name, file):
            top = base.partition(".")[0]
            found = self._modules.file(top, order.beside)
            if top == "fmus" or (found is None and top in sys.stdlib_module_names):
                if not may_take(base, members):
                    raise ImpureError(base)
                if top != "fmus":
                    yield top, ()
            elif self._modules.file(base, order.beside) is None:
                raise ImpureError(base)
            else:
                yield base, members

    def _module(self, name: str, order: BuildRequest) -> tuple[str, str]:
        """Returns file and digest of the module that an import of this name loads; `_NO_FILE` if none."""
        file = self._modules.file(name, order.beside)
        return (
            (file, store.digest(self._modules.read(file) if file else b"")) if file is not None else _NO_FILE
        )


def _is_loaded(name: str, file: str, digest: str) -> bool:
    """Whether a module is loaded from a file, and from the source that has this digest."""
    module = sys.modules.get(name)
    if getattr(module, "__file__", "") != file:
        return False
    loader = getattr(module, "__loader__", None)
    if isinstance(loader, SourceLoader):
        return loader.digest == digest
    # It was imported before the build: a compiled file may stand for a source of the same size and second.
    # pytest loads modules by another loader than Python's, which could not be asked.
    loader = SourceFileLoader(name, file)
    # the file may have been changed or removed meanwhile
    with suppress(OSError, SyntaxError, ValueError, ImportError):
        return loader.get_code(name) == loader.source_to_code(loader.get_data(file), file)
    return False
