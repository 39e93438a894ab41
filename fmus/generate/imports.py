"""The modules that a module imports, found without importing any; and whether they are pure.

A pure module is the same at every import, as long as its text and the texts of its imports are the same. Its
names and attributes lead to no file, clock, environment or order of a set, which the seed of Python's hashes
decides. Everything that is not listed here is refused. One case is not found: the text of an object,
`str(object())`, has an address.
"""

import ast
import builtins
import sys
import sysconfig
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import resolve_name
from pathlib import Path

from fmus.store import read_with_time

Import = tuple[str, tuple[str, ...]]
"""(module, the names that are taken from it)."""

_NUMERICS = "fmus.numerics"
# modules with functions of numbers alone: all their names may be taken
_WHOLE = {"cmath", "math"}
# module -> names that may be taken from it
_TAKEN = {
    "__future__": "annotations",
    "builtins": "abs all any bool callable chr classmethod complex dict divmod enumerate filter float int "
    "isinstance issubclass iter len list map max min next object ord pow property range reversed round slice "
    "sorted staticmethod str sum super tuple type zip Ellipsis NotImplemented ArithmeticError AssertionError "
    "Exception ImportError IndexError KeyError NotImplementedError TypeError ValueError ZeroDivisionError",
    "collections.abc": "Callable Iterable Iterator Mapping Sequence",
    "dataclasses": "KW_ONLY asdict astuple dataclass field fields is_dataclass replace",
    "enum": "Enum IntEnum auto unique",
    "fmus": "numerics",
    "fmus.block": "Block NoValues variable",
    "fmus.block.guide": "Experiment Guide Source",
    "functools": "cache cached_property lru_cache partial reduce wraps",
    "itertools": "accumulate chain count cycle islice pairwise product repeat starmap takewhile zip_longest",
    "typing": "Any Final Literal NamedTuple Protocol TYPE_CHECKING TypeAlias TypeVar",
}
_SPECIAL = {"__all__", "__debug__", "__doc__", "__init__", "__name__", "__post_init__", "__setattr__"}
# The last three begin attributes of generators, whose frames lead to all modules.
_PREFIXES = ("__", "ag_", "cr_", "gi_")
_NO_NAMES = {*dir(builtins)} - {*_TAKEN["builtins"].split()}
# attributes that read others by their names, or make sets; the modules of `fmus.numerics` import more
_NO_ATTRIBUTES = {"*", "format", "format_map", "items", "keys"} | {
    path.stem for path in Path(__file__).parent.with_name("numerics").glob("*.py")
}


class ImpureError(Exception):
    """A module that may depend on more than the texts of Python modules."""


def may_take(module: str, names: tuple[str, ...]) -> bool:
    """Whether a pure module may take these names from a module of Python or of this package.

    names: empty for an import of the module itself, which leads to all that the module imports
    """
    may_take_all = module in _WHOLE or (module == _NUMERICS and bool(names))
    return may_take_all or (bool(names) and {*names} <= {*_TAKEN.get(module, "").split()})


def is_package(file: str) -> bool:
    """Whether a file defines a package."""
    return Path(file).name == "__init__.py"


def imports_in(nodes: Iterable[ast.AST], module: str, file: str) -> Iterator[Import]:
    """Yields the imports among the nodes of a module, with absolute names."""
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from ((alias.name, ()) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            package = module if is_package(file) else module.rpartition(".")[0]
            base = resolve_name("." * node.level + (node.module or ""), package)
            yield base, tuple(alias.name for alias in node.names)


@cache
def pure_imports(content: bytes, module: str, file: str) -> list[Import]:
    """Returns the imports of a module; ImpureError if it may depend on more than on these and its text."""
    nodes = [*ast.walk(ast.parse(content))]
    for node in nodes:
        names, refused = (), _NO_ATTRIBUTES
        if isinstance(node, ast.ImportFrom):
            names = tuple(alias.name for alias in node.names)
        elif isinstance(node, ast.Attribute):
            names = (node.attr,)
        elif isinstance(node, ast.Name):
            names, refused = (node.id,), _NO_NAMES
        hidden = {name for name in names if name.startswith(_PREFIXES) or name in refused} - _SPECIAL
        # sets have no fixed order; a class pattern of `match` reads attributes
        if hidden or isinstance(node, ast.Set | ast.SetComp | ast.MatchClass):
            raise ImpureError(module)
    return [*imports_in(nodes, module, file)]


class Modules:
    """The modules that imports find now, each looked for and read once; a folder comes before all others."""

    def __init__(self) -> None:
        self._specs: dict[tuple[str, str], ModuleSpec | None] = {}
        self._read: dict[str, tuple[bytes, float]] = {}

    def closure(
        self, roots: Sequence[str], imports: Callable[[str, str], Iterable[Import]], folder: str = ""
    ) -> dict[str, str | None]:
        """Returns module -> result of `file`, for the roots, their imports, and the packages of all these.

        A name that is taken from a module may be a module itself: then it has a file.
        imports: module and file -> the imports that are followed
        """
        # "" stands for the package of modules outside of packages
        files: dict[str, str | None] = {"": None}
        waiting = [*roots]
        while waiting:
            if (name := waiting.pop()) not in files:
                file = files[name] = self.file(name, folder)
                if file is None and name in roots:
                    raise ImpureError(name)
                for base, members in imports(name, file) if file else ():
                    waiting += [base, *(f"{base}.{member}" for member in members)]
                waiting += [name.rpartition(".")[0]] if file is not None else []
        del files[""]
        return files

    def file(self, name: str, folder: str = "") -> str | None:
        """Returns the path of a module, "" for a folder without code, None if it is missing or Python's own.

        Raises ImpureError for a module that is not a text of Python.
        """
        spec = self._spec(name, folder)
        if spec is None or (name in sys.stdlib_module_names and _is_of_python(spec)):
            return None
        if spec.origin is None and spec.submodule_search_locations:
            return ""
        if not spec.has_location or not str(spec.origin).endswith(".py"):
            raise ImpureError(name)
        return str(spec.origin)

    def read(self, file: str) -> bytes:
        """Returns the content of a file as it was when it was first read."""
        if file not in self._read:
            self._read[file] = read_with_time(file)
        return self._read[file][0]

    @property
    def changed(self) -> float:
        """The time of the last change of a file that was read [s since the epoch]."""
        return max((changed for _, changed in self._read.values()), default=0.0)

    def _spec(self, name: str, folder: str) -> ModuleSpec | None:
        """Returns the module that an import of this name finds, without importing its package."""
        if (name, folder) not in self._specs:
            package, path = name.rpartition(".")[0], None
            spec = PathFinder.find_spec(name, [folder]) if folder and not package else None
            if package:
                parent = self._spec(package, folder)
                path = parent.submodule_search_locations if parent else None
            if not package or path:
                specs = (finder.find_spec(name, path) for finder in sys.meta_path)
                spec = spec or next(filter(None, specs), None)
            self._specs[name, folder] = spec
        return self._specs[name, folder]


def _is_of_python(spec: ModuleSpec) -> bool:
    """Whether a module is in the standard library, not a user's module that hides it."""
    return not spec.has_location or Path(str(spec.origin)).is_relative_to(sysconfig.get_path("stdlib"))
