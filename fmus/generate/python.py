"""Block -> the Python modules that an FMU of the python flavour carries; the modules of a Python file.

Two FMUs in one process share `sys.modules`. So each FMU carries its sources in a package that is named after
its content, and absolute imports between them are rewritten to this package.
"""

import ast
import re
import subprocess
import sys
import tempfile
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path

from fmus.block import Block
from fmus.errors import ExportError
from fmus.generate.imports import Import, ImpureError, Modules, imports_in
from fmus.guid import GUID, GUID_IN_NAMES

_CODING = re.compile(r"^([ \t\f]*#.*?coding[:=][ \t]*)[-\w.]+", re.MULTILINE)  # PEP 263
# every FMU carries it
_SLAVE = "fmus.block.slave"
# for an import, which takes less than 1 s
_PATIENCE_S = 60
# The tests show that these need their modules alone: a build saves the time of another process.
_OURS = {"controller_fmu", "plant_fmu", "fmus"}

# of PythonFMU 0.7, at the place where its binary has run this file and is about to make an instance
REMEDIES = """
# PythonFMU drops one reference to this dictionary too many whenever it has run this file
ctypes.pythonapi.Py_IncRef(ctypes.py_object(globals()))
# It starts a thread, for whose end it waits when Windows unloads it: for ever if that end has to wait for the
# unloading. So this waits now, unless PythonFMU has begun Python, which then has no arguments and would end.
if sys.platform == "win32" and sys.orig_argv:
    for path in Path(sys.path[0]).parent.glob("binaries/win64/*.dll"):
        library = ctypes.CDLL(str(path))
        if hasattr(library, "finalizePythonInterpreter"):
            library.finalizePythonInterpreter()
        ctypes.windll.kernel32.FreeLibrary(ctypes.c_void_p(library._handle))
"""

_ENTRY = '''"""Entry point of the FMU {name}: the class that PythonFMU's binary instantiates."""

import ctypes
import sys
from pathlib import Path

{imports}
{remedies}

class {name}({base}):
    {member}
    fingerprint = "{guid}"
'''


def python_modules(block: Block) -> dict[str, str]:
    """Returns path inside the FMU's resources -> text of the block's modules and of the entry point.

    Raises ExportError for a block whose modules cannot be carried.
    """
    module, attribute = defined_as(block)
    package = package_of(block.name)
    imports = (f"from {package}.{module} import {attribute}", f"from {package}.{_SLAVE} import BlockSlave")
    entry = entry_point(block.name, "BlockSlave", imports, f"block = {attribute}")
    texts = in_package(source_closure(module), package) | entry
    if module.partition(".")[0] not in _OURS:
        _check_import(block.name, texts, entry["slavemodule.txt"])
    return texts


def package_of(name: str) -> str:
    """Returns the package that holds the sources of an FMU, which no other FMU shares."""
    return f"{name.lower()}_{GUID_IN_NAMES}_sources"


def entry_point(name: str, base: str, imports: Iterable[str], member: str) -> dict[str, str]:
    """Returns path -> text of the files that PythonFMU's binary loads: a class with this base and member."""
    entry = package_of(name).removesuffix("_sources")
    text = _ENTRY.format(
        name=name, base=base, imports="\n".join(imports), remedies=REMEDIES, member=member, guid=GUID
    )
    return {f"{entry}.py": text, "slavemodule.txt": entry}


def _check_import(name: str, text: dict[str, str], entry: str) -> None:
    """Raises ExportError for sources that need a file that the FMU does not carry, such as a table.

    The packages that are installed here can be imported: a block that needs one passes.
    """
    with tempfile.TemporaryDirectory() as folder:
        for path, source in text.items():
            (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
            (Path(folder) / path).write_text(source, encoding="utf-8")
        code = f"import sys; sys.path.insert(0, {folder!r}); import {entry}"
        command = [sys.executable, "-I", "-c", code]
        try:
            run = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, check=False, timeout=_PATIENCE_S
            )
        except subprocess.TimeoutExpired:
            raise ExportError(
                f"block {name!r}: its modules were not imported within {_PATIENCE_S} s: "
                "expected modules that only define it"
            ) from None
    if run.returncode:
        reason = (run.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise ExportError(
            f"block {name!r}: an FMU of the python flavour carries Python modules alone, which cannot "
            f"be imported: {reason}; write what they need into them, or build the native flavour"
        )


def defined_as(block: Block) -> tuple[str, str]:
    """Returns (module, name) under which a block can be imported, first in the module that defines it.

    Raises ExportError for a block that no loaded module holds at its top level.
    """
    for module in [block.output.__module__, block.parameters.__module__, *sys.modules]:
        for name, value in getattr(sys.modules[module], "__dict__", {}).items():
            if value is block:
                return module, name
    raise ExportError(
        f"block {block.name!r}: expected a name at the top level of a module, BLOCK = Block(...)"
    )


def source_closure(module: str) -> dict[str, str]:
    """Returns the source of every module that `module` imports at import time, itself included, by name.

    Raises ExportError for a module beyond the standard library that is not plain Python
    beside the block or PythonFMU's own.
    """
    modules, folder = Modules(), None

    def imports(name: str, file: str) -> Iterator[Import]:
        for statement in ast.parse(modules.read(file)).body if name != "pythonfmu" else ():
            for base, members in imports_in([statement], name, file):
                if base.partition(".")[0] not in sys.stdlib_module_names:
                    _refuse_foreign(name, base, folder)
                    _refuse_unmoved(name, statement)
                    if modules.file(base) is None:
                        raise ImpureError(base)
                    yield base, members

    try:
        folder = None if "." in module else Path(modules.file(module) or "").parent
        files = modules.closure([module, _SLAVE], imports)
    except ImpureError as error:
        raise ExportError(f"{error}: expected a module of plain Python") from None
    return {
        name: _text(file) if file and name != "pythonfmu" else ""
        for name, file in sorted(files.items())
        if file is not None
    }


def sources_beside(file: Path) -> dict[str, str]:
    """Returns module -> source of a Python file and of its imports from its folder and from `fmus`.

    Imports in functions count. Other modules stay where they are installed.
    Raises ExportError for a file that cannot be read as Python.
    """
    modules, folder = Modules(), file.parent

    def is_carried(name: str) -> bool:
        top = name.partition(".")[0]
        files = folder / f"{top}.py", folder / top / "__init__.py"
        return top == "fmus" or any(map(Path.is_file, files))

    def imports(name: str, path: str) -> Iterator[Import]:
        for node in ast.walk(ast.parse(modules.read(path), path)):
            try:
                found = [
                    (base, members) for base, members in imports_in([node], name, path) if is_carried(base)
                ]
            # a relative import leaves the folder
            except ImportError:
                line = getattr(node, "lineno", 1)
                raise ExportError(f"{path}:{line}: an import with dots: expected one without") from None
            if found and isinstance(node, ast.stmt):
                _refuse_unmoved(name, node)
            yield from found

    try:
        files = modules.closure([file.stem], imports, str(folder))
    except ImpureError as error:
        raise ExportError(f"{file}: imports {error}: expected a module of plain Python") from None
    except SyntaxError as error:
        raise ExportError(f"{error.filename}:{error.lineno}: {error.msg}") from None
    return {name: _text(path) if path else "" for name, path in sorted(files.items()) if path is not None}


def in_package(sources: dict[str, str], package: str) -> dict[str, str]:
    """Returns path inside the FMU's resources -> source, every module moved into `package`."""
    tops = "|".join(sorted({name.partition(".")[0] for name in sources}))
    members = re.compile(rf"^(\s*from\s+)({tops})(?=[.\s])", re.MULTILINE)
    modules = re.compile(rf"^(\s*import\s+)((?:{tops})(?:\.\w+)*)(?![.\w,])(\s+as\s+\w+)?", re.MULTILINE)
    moved = {f"{package}/__init__.py": ""}
    for name, source in sources.items():
        is_package = any(other.startswith(name + ".") for other in sources)
        path = f"{package}/{name.replace('.', '/')}{'/__init__' if is_package else ''}.py"
        moved[path] = modules.sub(
            lambda m: f"{m[1]}{package}.{m[2]}{m[3] or ' as ' + m[2]}",
            members.sub(rf"\g<1>{package}.\g<2>", source),
        )
    return moved


def _text(file: str) -> str:
    with tokenize.open(file) as stream:
        source = stream.read()
        return source if stream.encoding.startswith("utf-8") else _CODING.sub(r"\1utf-8", source, count=1)


def _refuse_unmoved(importer: str, statement: ast.stmt) -> None:
    """Refuses an import that `in_package` cannot rewrite."""
    match statement:
        case ast.Import(names=[ast.alias(name=name, asname=asname), *others]):
            if others or ("." in name and not asname):
                raise ExportError(
                    f"{importer} imports {name}: expected a line import NAME, or from NAME import"
                )


def _refuse_foreign(importer: str, name: str, folder: Path | None) -> None:
    top = name.partition(".")[0]
    if top not in (importer.partition(".")[0], "fmus", "pythonfmu") and not _is_beside(top, folder):
        raise ExportError(
            f"{importer} imports {name}: expected the standard library, fmus or its own package or folder; "
            "the native flavour, which is compiled, takes any module"
        )


def _is_beside(module: str, folder: Path | None) -> bool:
    """Whether a module is a Python file or a package in the folder."""
    return folder is not None and ((folder / f"{module}.py").is_file() or (folder / module).is_dir())
