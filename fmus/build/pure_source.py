"""The part of Python whose modules are the same at every import, as long as their texts are the same.

It has names and attributes that are known to lead to nothing else: no file, clock, environment, address or
order of a set, which the seed of Python's hashes decides. Everything that is not listed here is refused.
"""

import ast
import builtins
from functools import cache
from importlib.util import resolve_name
from pathlib import Path

_NUMERICS = "fmus.numerics"
_WHOLE = {"cmath", "math"}  # modules that hold nothing but functions of numbers
_TAKEN = {  # module -> names that may be taken from it
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
_PREFIXES = ("__", "ag_", "cr_", "gi_")  # the last three: of generators, whose frames lead to all modules
_NO_NAMES = {*dir(builtins)} - {*_TAKEN["builtins"].split()}
# attributes that read others by their names, or make sets; the modules of `fmus.numerics` import more
_NO_ATTRIBUTES = {"*", "format", "format_map", "items", "keys"} | {
    path.stem for path in Path(__file__).parent.with_name("numerics").glob("*.py")
}


class ImpureError(Exception):
    """A module that may depend on more than texts of Python."""


def may_take(module: str, names: tuple[str, ...]) -> bool:
    """Whether a pure module may take these names from a module of Python or of this package.

    names: empty for an import of the module itself, which leads to all that the module imports
    """
    may_take_all = module in _WHOLE or (module == _NUMERICS and bool(names))
    return may_take_all or (bool(names) and {*names} <= {*_TAKEN.get(module, "").split()})


@cache
def imports_of(content: bytes, module: str, is_package: bool) -> list[tuple[str, tuple[str, ...]]]:
    """Returns (module, names taken from it) for each import in a module.

    Raises ImpureError for a module that may depend on more than on these and its text.
    """
    imported: list[tuple[str, tuple[str, ...]]] = []
    for node in ast.walk(ast.parse(content)):
        names, refused = (), _NO_ATTRIBUTES
        if isinstance(node, ast.Import):
            imported += [(alias.name, ()) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            package = module if is_package else module.rpartition(".")[0]
            names = tuple(alias.name for alias in node.names)
            imported.append((resolve_name("." * node.level + (node.module or ""), package), names))
        elif isinstance(node, ast.Attribute):
            names = (node.attr,)
        elif isinstance(node, ast.Name):
            names, refused = (node.id,), _NO_NAMES
        hidden = {name for name in names if name.startswith(_PREFIXES) or name in refused} - _SPECIAL
        if hidden or isinstance(node, ast.Set | ast.SetComp | ast.MatchClass):  # a class reads attributes
            raise ImpureError(module)
    return imported
