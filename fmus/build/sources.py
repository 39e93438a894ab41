"""The Python source that a block needs, under a package name that no other FMU shares.

Two FMUs in one process share `sys.modules`. Each FMU therefore carries its sources in a package
named after its own content; absolute imports between them are rewritten to that package.
"""

import ast
import importlib.util
import re
import sys
import tokenize
from pathlib import Path

from fmus.block import Block
from fmus.errors import ExportError

_CODING = re.compile(r"^([ \t\f]*#.*?coding[:=][ \t]*)[-\w.]+", re.MULTILINE)  # PEP 263

SHARED_BY_EVERY_FMU = ("fmus.build.slave",)


def defined_as(block: Block) -> tuple[str, str]:
    """(module, name) under which a block can be imported, first in the module of its `step`.

    Raises ExportError for a block that no loaded module holds at its top level.
    """
    for module in [block.step.__module__, *sys.modules]:
        for name, value in getattr(sys.modules[module], "__dict__", {}).items():
            if value is block:
                return module, name
    raise ExportError(
        f"block {block.name!r}: expected a name at the top level of a module, BLOCK = Block(...)"
    )


def source_closure(module: str) -> dict[str, str]:
    """Module name -> source of every module that `module` imports at import time, itself included.

    Raises ExportError for a module beyond the standard library that is not plain Python
    beside the block or PythonFMU's own.
    """
    sources: dict[str, str] = {}
    waiting = [module, *SHARED_BY_EVERY_FMU]
    folder = None if "." in module else _file(module).parent
    while waiting:
        name = waiting.pop()
        if name in sources:
            continue
        sources[name] = _read(name)
        parts = name.split(".")
        if parts[0] == "pythonfmu":
            sources["pythonfmu"] = ""
        else:
            waiting.extend(".".join(parts[:i]) for i in range(1, len(parts)))
        waiting.extend(_imported(name, sources[name], folder))
    return dict(sorted(sources.items()))


def in_package(sources: dict[str, str], package: str) -> dict[str, str]:
    """Path inside the FMU's resources -> source, every module moved into `package`."""
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


def _file(name: str) -> Path:
    spec = importlib.util.find_spec(name)
    if spec is None or not spec.origin or not spec.origin.endswith(".py"):
        raise ExportError(f"{name}: expected a module of plain Python")
    return Path(spec.origin)


def _read(name: str) -> str:
    spec = importlib.util.find_spec(name)
    if spec and spec.submodule_search_locations and spec.origin is None:  # a folder without __init__.py
        return ""
    with tokenize.open(_file(name)) as file:
        source = file.read()
        return source if file.encoding.startswith("utf-8") else _CODING.sub(r"\1utf-8", source, count=1)


def _imported(name: str, source: str, folder: Path | None) -> list[str]:
    """The modules that a module imports, but for those of the standard library.

    folder: in which modules may be imported that are in no package
    """
    imported = []
    for statement in ast.parse(source).body:
        if isinstance(statement, ast.Import):
            for alias in statement.names:
                if alias.name.partition(".")[0] in sys.stdlib_module_names:
                    continue
                _refuse_foreign(name, alias.name, folder)
                if len(statement.names) > 1 or ("." in alias.name and not alias.asname):
                    raise ExportError(
                        f"{name} imports {alias.name}: expected a line import NAME, or from NAME import"
                    )
                imported.append(alias.name)
        elif isinstance(statement, ast.ImportFrom):
            base = _absolute(name, statement)
            if base.partition(".")[0] in sys.stdlib_module_names:
                continue
            _refuse_foreign(name, base, folder)
            submodules = [f"{base}.{alias.name}" for alias in statement.names]
            modules = [submodule for submodule in submodules if _is_module(submodule)]
            imported.extend(modules if len(modules) == len(submodules) else [base, *modules])
    return imported


def _absolute(name: str, statement: ast.ImportFrom) -> str:
    if not statement.level:
        return statement.module or ""
    package = name.rsplit(".", statement.level)[0]
    return f"{package}.{statement.module}" if statement.module else package


def _is_module(name: str) -> bool:
    try:
        return importlib.util.find_spec(name) is not None
    except ModuleNotFoundError:
        return False


def _refuse_foreign(importer: str, name: str, folder: Path | None) -> None:
    top = name.partition(".")[0]
    if top not in (importer.partition(".")[0], "fmus", "pythonfmu") and not _is_beside(top, folder):
        raise ExportError(
            f"{importer} imports {name}: expected the standard library, fmus or its own package or folder"
        )


def _is_beside(module: str, folder: Path | None) -> bool:
    """Whether a module is a Python file or a package in the folder."""
    return folder is not None and ((folder / f"{module}.py").is_file() or (folder / module).is_dir())
