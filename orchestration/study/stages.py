"""Stages of a long study, each kept in a file when it is done; what has become out of date is not read.

The files lie in a folder that is named after the content of all that they follow from: sources of this room,
and what other rooms gave them as data.
"""

import ast
import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from fmus.files import open_atomically, write_json_atomically
from orchestration.study.open_numbers import Columns

_DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef)
Progress = Callable[[str], None]


class Stages:
    """Results of stages in a folder, below it in one of the key: what is there is not computed again."""

    def __init__(self, folder: Path, key: str, progress: Progress = lambda name: None) -> None:
        self._folder, self._progress = folder / key[:16], progress

    def arrays(self, name: str, compute: Callable[[], Mapping[str, Any]]) -> Columns:
        """Named arrays."""
        path = self._folder / f"{name}.npz"
        if not path.exists():
            computed = {key: np.asarray(value) for key, value in compute().items()}
            path.parent.mkdir(parents=True, exist_ok=True)
            with open_atomically(path) as stream:
                np.savez(stream, **computed)  # type: ignore[arg-type]
        self._progress(name)
        with np.load(path) as file:
            return dict(file)

    def document(self, name: str, compute: Callable[[], Any]) -> Any:
        """Plain data."""
        path = self._folder / f"{name}.json"
        if not path.exists():
            computed = compute()
            path.parent.mkdir(parents=True, exist_ok=True)
            write_json_atomically(path, computed)
        self._progress(name)
        return json.loads(path.read_text(encoding="utf-8"))


def content_key(files: Iterable[Path], *data: Any) -> str:
    """A name of the content of these files and of data whose `repr` is their content.

    Of a Python file, comments, docstrings and layout are no content: no result follows from them.
    """
    digests = [hashlib.sha256(_content(file)).hexdigest() for file in sorted(files)]
    return hashlib.sha256("".join([*digests, *map(repr, data)]).encode()).hexdigest()


def imported_sources(source: Path) -> set[Path]:
    """A source file and every one of its folder that it imports, directly or not."""
    sources, new = set[Path](), {source.resolve()}
    while new:
        sources |= new
        new = {path for file in new for path in _imported(file)} - sources
    return sources


def _content(file: Path) -> bytes:
    if file.suffix != ".py":
        return file.read_bytes()
    tree = ast.parse(file.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, _DOCUMENTED) and ast.get_docstring(node) is not None:
            del node.body[0]
    return ast.dump(tree).encode()


def _imported(source: Path) -> Iterable[Path]:
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            package, _, module = node.module.rpartition(".")
            is_package = module == source.parent.name
            is_neighbour = package.rpartition(".")[2] == source.parent.name
            names = [alias.name for alias in node.names] if is_package else [module] if is_neighbour else []
            yield from (file for name in names if (file := source.with_name(f"{name}.py")).is_file())
