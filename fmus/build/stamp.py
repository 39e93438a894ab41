"""What a built FMU was made from, so that an unchanged one is known without tracing its block again.

A stamp names FMUs by their content and lists what decided about it: the files of the block and of what it
imports, the files of this package, the libraries that build, and the options. It is in the user's cache. A
block that may depend on anything else, such as a file that it reads when it is imported, gets no stamp: what
is traced of it decides, as for an FMU without a stamp.
"""

import hashlib
import json
import os
import platform
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.metadata import EntryPoint, distributions
from pathlib import Path

import fmus
from fmus.block.block_file import SourceLoader
from fmus.build.pure_source import ImpureError, imports_of, may_take
from fmus.registry import Flavour, block_entry_points, block_fmus, fmu_folder, fmu_path
from fmus.user_cache import cache_folder, reason_for_distrust, write_cached

_LIBRARIES = ("casadi", "fmpy", "l1-depth", "pillow", "pint", "pythonfmu", "ziglang")
_NOT_BUILDING = {"compliance", "__pycache__"}  # folders of this package that no FMU is made from
_NO_FILE = "", ""  # no module of a name, or one of Python's or of this package's
_RECENT_S = 2.0  # a file that changed so shortly before the process began may have been loaded before that


@dataclass(frozen=True)
class Order:
    """What is to be built.

    source: name of an installed block, or path of a Python file; platforms: by default this one
    with_cross_check: with the files of the FMI cross-check beside each FMU
    """

    source: str
    folder: Path
    flavour: Flavour = Flavour.NATIVE
    platforms: tuple[str, ...] = ()
    with_terminals: bool = False
    reals_only: bool = False
    with_cross_check: bool = False

    @property
    def file(self) -> str:
        """The absolute path of the Python file; "" for an installed block."""
        return str(Path(self.source).absolute()) if self.source.endswith(".py") else ""


def order_of_file(path: Path, flavour: Flavour) -> Order:
    """The FMU of a Python file's block that a command runs, in a folder of the user's cache."""
    folder = hashlib.sha256(str(path.absolute()).encode()).hexdigest()[:12]
    return Order(str(path), fmu_folder(flavour) / folder, flavour)


def stale(paths: Iterable[Path]) -> list[Path]:
    """Those of the paths at which scenarios find FMUs of blocks that may have to be built."""
    stamps = Stamps()
    orders = {
        fmu_path(name, flavour): Order(name, fmu_folder(flavour), flavour)
        for name, flavour in block_fmus(paths)
    }
    return [path for path, order in orders.items() if not stamps.current(order, to_run=True)]


@dataclass(frozen=True)
class Sources:
    """What an order depends on.

    modules: name -> (file, digest), or `_NO_FILE`
    changed: when one of the files was changed last [s since the epoch]
    """

    recipe: str
    modules: dict[str, tuple[str, str]]
    changed: float

    @property
    def if_loaded(self) -> "Sources | None":
        """These, if this process has imported the modules from these files, and all after `fmus`."""
        modules = {name: module for name, module in self.modules.items() if module != _NO_FILE}
        are_loaded = all(_is_loaded(name, *module) for name, module in modules.items())
        return self if are_loaded and not fmus.IMPORTED_BEFORE.intersection(modules) else None


class Stamps:
    """The stamps of this user, and files as they are while this object is used: each is read once.

    package: the folder of `fmus`; begun: when this process began to import modules [s since the epoch]
    """

    def __init__(self, package: Path = Path(fmus.__file__).parent, begun: float = fmus.IMPORTED_AT) -> None:
        self._package, self._begun = package, begun
        self._files: dict[str, tuple[bytes, float]] = {}
        self._specs: dict[tuple[str, str], ModuleSpec | None] = {}

    def current(self, order: Order, to_run: bool = False) -> list[Path] | None:
        """The FMUs of an order, if they are what would be built now; None if that is not known.

        to_run: whether they may differ in what runs do not need, such as their icons
        """
        damaged = ValueError, TypeError, KeyError, AttributeError
        with suppress(ImpureError, OSError, *damaged):
            stamp = json.loads((path := _stamp_file(order)).read_text(encoding="utf-8"))
            files = {order.folder / name: digest for name, digest in stamp["fmus"].items()}
            modules = {name: (file, digest) for name, (file, digest) in stamp["modules"].items()}
            unchanged = (
                not reason_for_distrust(path)
                and (to_run or stamp["was_built"])
                and stamp["recipe"] == self._recipe(order)
                and all(self._module(name, order) == modules[name] for name in modules)
                and all(_digest(path.read_bytes()) == digest for path, digest in files.items())
            )
            return [*files] if unchanged else None
        return None

    def sources(self, order: Order) -> Sources | None:
        """What an order depends on, as it is now; None if that cannot be known from files alone."""
        try:
            modules = dict(self._closure(order))
            recipe = self._recipe(order)
        except (ImpureError, ImportError, OSError, SyntaxError, ValueError):
            return None
        return Sources(recipe, modules, max(changed for _, changed in self._files.values()))

    def write(
        self, order: Order, sources: Sources | None, fmus: Mapping[str, bytes], was_built: bool = True
    ) -> None:
        """Stamp FMUs, unless one of the sources may have changed since it was imported.

        sources: from before they were imported, and only if they were loaded
        fmus: content by the name of the file, where another process may have written since
        was_built: otherwise they were found, and run as what was traced
        """
        if sources is None or sources.changed > self._begun - _RECENT_S:
            return
        if Stamps(self._package, self._begun).sources(order) != sources:
            return
        digests = {name: _digest(fmu) for name, fmu in fmus.items()}
        content = {"recipe": sources.recipe, "modules": sources.modules, "fmus": digests}
        content["was_built"] = was_built
        with suppress(OSError):  # without a cache that can be written, the next build traces again
            write_cached(_stamp_file(order), json.dumps(content, indent=2).encode())

    def _recipe(self, order: Order) -> str:
        """Digest of everything but the modules of the block."""
        options = order.flavour, order.platforms, order.with_terminals, order.reals_only
        host = sys.version, sys.flags.optimize, sys.platform, platform.machine()
        date = os.environ.get("SOURCE_DATE_EPOCH")
        parts = self._origin(order), *options, *host, date, self._libraries, self._own_files
        return _digest(repr(parts).encode())

    def _origin(self, order: Order) -> str:
        """MODULE:NAME of an installed block, or the path of a file."""
        if not order.file and order.source not in self._entry_points:
            raise ImpureError(order.source)
        return order.file or self._entry_points[order.source].value

    @cached_property
    def _entry_points(self) -> dict[str, EntryPoint]:
        return block_entry_points()

    @cached_property
    def _libraries(self) -> list[tuple[str, ...]]:
        """Metadata and licence of the libraries that build; an editable one may be found more than once."""
        files = "METADATA", "PKG-INFO", "licenses/LICENSE"
        found = ((name, distribution) for name in _LIBRARIES for distribution in distributions(name=name))
        return sorted({(name, *(one.read_text(file) or "" for file in files)) for name, one in found})

    @cached_property
    def _own_files(self) -> list[tuple[str, str]]:
        """(path, digest) of each file of this package that may decide about an FMU."""
        files = []
        for folder, names, members in os.walk(self._package):
            names[:] = sorted(set(names) - _NOT_BUILDING)
            files += [os.path.join(folder, member) for member in sorted(members)]  # noqa: PTH118
        return [(os.path.relpath(file, self._package), self._digest_of(file)) for file in files]

    def _closure(self, order: Order) -> Iterator[tuple[str, tuple[str, str]]]:
        """Each module that the block's module imports, itself included, with its file and digest."""
        waiting = [Path(order.file).stem if order.file else self._entry_points[order.source].module]
        known: set[str] = set()
        while waiting:
            name = waiting.pop()
            if name in known:
                continue
            known.add(name)
            file, digest = self._module(name, order)
            if not file:
                raise ImpureError(name)
            yield name, (file, digest)
            waiting.append(name.rpartition(".")[0] or name)
            for base, members in imports_of(self._files[file][0], name, _is_package(file)):
                top = base.partition(".")[0]
                if top == "fmus" or (top in sys.stdlib_module_names and self._module(top, order) == _NO_FILE):
                    if not may_take(base, members):
                        raise ImpureError(base)
                    if top != "fmus":
                        yield top, _NO_FILE  # as long as no file of the user's hides it
                    continue
                waiting.append(base)
                for submodule in (f"{base}.{member}" for member in members):
                    if self._spec(submodule, order):
                        waiting.append(submodule)
                    else:
                        yield submodule, _NO_FILE  # a name in a module, as long as there is no such file

    def _module(self, name: str, order: Order) -> tuple[str, str]:
        """File and digest of the module that an import of this name loads; `_NO_FILE` if there is none."""
        spec = self._spec(name, order)
        if spec is None or (name in sys.stdlib_module_names and _is_of_python(spec)):
            return _NO_FILE
        if not spec.has_location or not str(spec.origin).endswith(".py"):
            raise ImpureError(name)
        return str(spec.origin), self._digest_of(str(spec.origin))

    def _spec(self, name: str, order: Order) -> ModuleSpec | None:
        """What an import of this name finds, without importing its package."""
        key = name, order.file
        if key not in self._specs:
            self._specs[key] = None
            package = name.rpartition(".")[0]
            parent = self._spec(package, order) if package else None
            if parent is not None or not package:
                path = parent.submodule_search_locations if parent else None
                own = None if package else self._beside(name, order)
                specs = (finder.find_spec(name, path) for finder in sys.meta_path)
                no_path = package and not path
                self._specs[key] = own or (None if no_path else next(filter(None, specs), None))
        return self._specs[key]

    def _beside(self, name: str, order: Order) -> ModuleSpec | None:
        """What an import finds in the folder of the order's file."""
        return PathFinder.find_spec(name, [str(Path(order.file).parent)]) if order.file else None

    def _digest_of(self, file: str) -> str:
        if file not in self._files:
            status = os.stat(file)  # noqa: PTH116
            with open(file, "rb") as stream:  # noqa: PTH123
                self._files[file] = stream.read(), max(status.st_mtime, status.st_ctime)
        return _digest(self._files[file][0])


def _is_loaded(name: str, file: str, digest: str) -> bool:
    """Whether a module is loaded from a file, and from the source that has this digest."""
    module = sys.modules.get(name)
    if getattr(module, "__file__", "") != file:
        return False
    loader = getattr(module, "__loader__", None)
    if isinstance(loader, SourceLoader):
        return loader.digest == digest
    # it was imported before the build: a compiled file may stand for a source of the same size and second
    loader = SourceFileLoader(name, file)  # pytest may have loaded it by one of its own
    with suppress(OSError, SyntaxError, ValueError, ImportError):  # it was changed meanwhile
        return loader.get_code(name) == loader.source_to_code(loader.get_data(file), file)
    return False


def _stamp_file(order: Order) -> Path:
    key = _digest(repr((order.file or order.source, str(order.folder.absolute()))).encode())
    return cache_folder("stamps") / f"{key}.json"


def _is_of_python(spec: ModuleSpec) -> bool:
    """Whether a module is that of the standard library, and none of the user's that hides it."""
    return not spec.has_location or Path(str(spec.origin)).is_relative_to(sysconfig.get_path("stdlib"))


def _is_package(file: str) -> bool:
    return Path(file).name == "__init__.py"


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
