"""The Python source that a block needs, under a package name that no other FMU shares.

Two FMUs in one process share `sys.modules`. Each FMU therefore carries its sources in a package
named after its own content; absolute imports between them are rewritten to that package.
"""

import ast
import re
import sys
import tokenize
from collections.abc import Iterator
from pathlib import Path

from fmus.block import Block
from fmus.errors import ExportError
from fmus.generate.imports import Import, ImpureError, Modules, imports_in

_CODING = re.compile(r"^([ \t\f]*#.*?coding[:=][ \t]*)[-\w.]+", re.MULTILINE)  # PEP 263

SHARED_BY_EVERY_FMU = ("fmus.generate.slave",)


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
        files = modules.closure([module, *SHARED_BY_EVERY_FMU], imports)
    except ImpureError as error:
        raise ExportError(f"{error}: expected a module of plain Python") from None
    return {
        name: _text(file) if file and name != "pythonfmu" else ""
        for name, file in sorted(files.items())
        if file is not None
    }


def sources_beside(file: Path) -> dict[str, str]:
    """Returns module -> source, of a Python file and of what it imports of its folder and of `fmus`.

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
            except ImportError:  # of a relative import
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
