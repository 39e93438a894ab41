"""The blocks of a Python file that belongs to no package; a new one to start from."""

import ast
import hashlib
import importlib.util
import keyword
import linecache
import re
import sys
import sysconfig
import traceback
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from pathlib import Path
from string import Template
from types import CodeType, ModuleType

from fmus.block import Block
from fmus.errors import ExportError, nearest
from fmus.files import write_text_atomically

_RELATIVE = "; import it without dots, or name the block in an entry point of its package"
# files with these names, whatever their ending, are devices in Windows
DEVICES = {"con", "prn", "aux", "nul", *(f"{port}{i}" for port in ("com", "lpt") for i in range(10))}
# kind of a new block -> the templates of its file and of its test
_TEMPLATES = {
    "controller": ("block.py.in", "test.py.in"),
    "vehicle": ("vehicle.py.in", "test_vehicle.py.in"),
    "plain": ("plain.py.in", "test_plain.py.in"),
}
_OWN = {"fmus", "controller_fmu", "plant_fmu", "orchestration"}


class SourceLoader(SourceFileLoader):
    """A loader of a module from its source, whose digest it keeps, and a finder of modules for it."""

    # Python's own loader takes the compiled file of a changed source, if size and second are the same.

    @staticmethod
    def find_spec(name: str, path: Sequence[str] | None = None, target: object = None) -> ModuleSpec | None:
        """Finds a module as Python does; gives it this loader unless it is installed."""
        spec = PathFinder.find_spec(name, path)
        if spec and type(spec.loader) is SourceFileLoader and "site-packages" not in spec.loader.path:
            spec.loader = SourceLoader(name, spec.loader.path)
        return spec

    def get_code(self, fullname: str) -> CodeType:
        source = self.get_data(self.path)
        self.digest = hashlib.sha256(source).hexdigest()
        return self.source_to_code(source, self.path)


@contextmanager
def from_sources() -> Iterator[None]:
    """Makes imports in this context read the present sources."""
    sys.meta_path.insert(sys.meta_path.index(PathFinder), SourceLoader)
    try:
        yield
    finally:
        sys.meta_path.remove(SourceLoader)


@contextmanager
def blocks_in(path: Path) -> Iterator[tuple[Block, ...]]:
    """Yields the blocks that a file defines at its top level, in order. Building them ends with the context.

    The file imports modules beside it as a script does. Whatever it has loaded is forgotten at the end, so
    that a changed file is read again.

    Raises ExportError for a file that cannot be imported, or that defines no block.
    """
    given, path = path, path.absolute()
    check_file(path)
    before, paths = dict(sys.modules), list(sys.path)
    sys.path.insert(0, str(path.parent))
    loaded = {path.stem}
    try:
        with from_sources():
            module = _imported(path)
        loaded |= {name for name in sys.modules.keys() - before.keys() if _lies_in(path.parent, name)}
        yield _defined(module, given)
    finally:
        sys.path[:] = paths
        for name in loaded:
            sys.modules.pop(name, None)
        sys.modules.update({name: before[name] for name in loaded & before.keys()})


def check_file(path: Path) -> None:
    """Raises ExportError for a Python file that is missing, or whose name no module of a user's can have."""
    if not path.is_file():
        files = [file.name for file in path.parent.glob("*.py")]
        known = nearest(path.name, files) if files else f"{path.parent} has no Python file"
        raise ExportError(f"{path}: no such file; {known}")
    if not is_free_module_name(path.stem):
        raise ExportError(f"{path}: {path.stem!r} is no name for a module of yours: rename the file")


def is_free_module_name(name: str) -> bool:
    """Whether a module can have this name and hides none of Python's, of ours, or of an installed package.

    Windows must be able to store its file, too.
    """
    if not name.isidentifier() or keyword.iskeyword(name) or name in sys.stdlib_module_names | _OWN | DEVICES:
        return False
    return PathFinder.find_spec(name, [sysconfig.get_path(key) for key in ("purelib", "platlib")]) is None


def _imported(path: Path) -> ModuleType:
    linecache.checkcache(str(path))
    spec = importlib.util.spec_from_file_location(path.stem, path, loader=SourceLoader(path.stem, str(path)))
    if spec is None or spec.loader is None:
        raise ExportError(f"{path}: expected a Python file, NAME.py")
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        where = f"{origin(error, path.parent)}: {type(error).__name__}: {error}"
        raise ExportError(where + (_RELATIVE if "relative import" in str(error) else "")) from error
    return module


def origin(error: BaseException, folder: Path) -> str:
    """Returns FILE:LINE of the deepest line of an error that lies in a folder of the user's."""
    if isinstance(error, SyntaxError) and error.filename:
        return f"{error.filename}:{error.lineno}"
    lines = traceback.extract_tb(error.__traceback__)
    own = [line for line in lines if Path(line.filename).is_relative_to(folder)]
    return f"{own[-1].filename}:{own[-1].lineno}" if own else str(folder)


def _lies_in(folder: Path, name: str) -> bool:
    """Whether a loaded module is a file of the user's beside the one that is built."""
    file = getattr(sys.modules.get(name), "__file__", None)
    is_own = name.partition(".")[0] in _OWN
    return file is not None and not is_own and Path(file).is_relative_to(folder)


def _defined(module: ModuleType, path: Path) -> tuple[Block, ...]:
    """Returns the blocks of a module, without those that it imports."""
    statements = ast.parse(path.read_bytes()).body
    imports = [statement for statement in statements if isinstance(statement, ast.ImportFrom)]
    imported = {alias.asname or alias.name for statement in imports for alias in statement.names}
    named = {name: value for name, value in vars(module).items() if isinstance(value, Block)}
    blocks = tuple(dict.fromkeys(block for name, block in named.items() if name not in imported))
    if not blocks:
        own = [cls for cls in vars(module).values() if getattr(cls, "__module__", "") == module.__name__]
        policies = [cls.__name__ for cls in own if hasattr(cls, "reset") and hasattr(cls, "step")]
        hint = "".join(f", or {path}:{name} for its class {name}" for name in dict.fromkeys(policies))
        # classes of PythonFMU have this method
        slaves = [cls.__name__ for cls in own if hasattr(cls, "register_variable")]
        hint += "".join(f"; pythonfmu build -f {path} makes {name}.fmu of {name}" for name in slaves)
        raise ExportError(f"{path}: no block at the top level of the file; expected BLOCK = Block(...){hint}")
    # On some file systems, Pid.fmu and PID.fmu are the same file.
    names = [block.name.casefold() for block in blocks]
    if twice := next((block.name for block in blocks if names.count(block.name.casefold()) > 1), None):
        raise ExportError(
            f"{path}: two blocks named {twice!r}: expected names that differ, in upper case too"
        )
    return blocks


def write_new_block(name: str, folder: Path, kind: str = "controller") -> list[Path]:
    """Writes `folder/NAME.py` and `folder/test_NAME.py`; raises ExportError if one of them is there already.

    name: of the module, such as depth_pid; its block is called DepthPid
    kind: "controller" of depth, "vehicle", or "plain": a room with a thermostat
    """
    values = {"module": name, "name": "".join(map(str.capitalize, name.split("_")))}
    is_taken = not is_free_module_name(name) or keyword.iskeyword(values["name"])
    if is_taken or not re.fullmatch(r"[a-z](_?[a-z0-9])*", name):
        raise ExportError(
            f"{name!r}: expected lower-case letters, digits and single underscores, and no name of Python's, "
            "of an installed package or of a device of Windows"
        )
    templates = Path(__file__).with_name("templates")
    texts = {
        folder / file: Template((templates / template).read_text("utf-8")).substitute(values)
        for file, template in zip((f"{name}.py", f"test_{name}.py"), _TEMPLATES[kind], strict=True)
    }
    if present := next((path for path in texts if path.exists()), None):
        raise ExportError(f"{present}: is there already; expected another name than {name!r}")
    for path, text in texts.items():
        write_text_atomically(path, text)
    return list(texts)
