"""A TOML file: its content, and the line of each key."""

import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from fmus.errors import nearest
from orchestration.errors import InputError, Key, ScenarioError

KeyPath = tuple[str | int, ...]
_VALUES = ("parameters", "inputs", "signals")
_KEY = r"""(?:[\w-]+|"(?:[^"\\]|\\.)*"|'[^']*')"""
_KEYS = rf"{_KEY}(?:\s*\.\s*{_KEY})*"
_ENTRY = re.compile(rf"\s*({_KEYS})\s*=")
_HEADER = re.compile(rf"\s*(\[\[?)\s*({_KEYS})\s*\]\]?\s*(?:#.*)?$")


@dataclass(frozen=True)
class TomlFile:
    """A file that was read; `at` says where in it a key stands."""

    path: Path
    text: str
    data: dict[str, Any]

    @cached_property
    def lines(self) -> dict[KeyPath, int]:
        """Keys -> line, from 1, of the key or of the header of a table; the second [[a]] is ("a", 1)."""
        # tomllib does not report the lines of keys
        lines: dict[KeyPath, int] = {}
        table: KeyPath = ()
        count: Counter[KeyPath] = Counter()
        for number, line in enumerate(self.text.splitlines(), start=1):
            header, entry = _HEADER.match(line), _ENTRY.match(line)
            if header:
                table = ()
                names = _names(header[2])
                for depth, name in enumerate(names, start=1):
                    table = (*table, name)
                    count[table] += header[1] == "[[" and depth == len(names)
                    table = (*table, count[table] - 1) if count[table] else table
                lines.setdefault(table, number)
            elif entry:
                lines.setdefault((*table, *_names(entry[1])), number)
        return lines

    def at(self, keys: KeyPath) -> str:
        """Returns the path, with the line of these keys or of the table that they would stand in."""
        for length in range(len(keys), 0, -1):
            if keys[:length] in self.lines:
                return f"{self.path}:{self.lines[keys[:length]]}"
        return str(self.path)

    def line_of(self, key: Key) -> int | None:
        """Returns the line of the keys of an entry, or the first, not of a comment, that names a variable."""
        if isinstance(key, tuple):
            return self.lines.get(key)
        name = key
        # values before what only names the variable, such as `record`
        if line := next((self.lines[t, name] for t in _VALUES if (t, name) in self.lines), None):
            return line
        named = re.compile(rf"(?<![\w.]){re.escape(name)}(?![\w\[])")
        for number, line in enumerate(self.text.splitlines(), start=1):
            if named.search(line) and not line.lstrip().startswith("#"):
                return number
        return None


def _names(keys: str) -> tuple[str, ...]:
    """Returns the names in dotted keys, without their quotes."""
    table: Any = tomllib.loads(f"{keys} = 0")
    names: list[str] = []
    while isinstance(table, dict):
        ((name, table),) = table.items()
        names.append(name)
    return tuple(names)


@contextmanager
def placed(files: Sequence[TomlFile]) -> Iterator[None]:
    """Puts the file, and the line of their keys (`InputError.about`), before errors that are raised inside.

    files: of a scenario, the uppermost first; a line of another file stands at the end
    """
    try:
        yield
    except InputError as error:
        if error.is_placed:
            raise ScenarioError(str(error)) from error
        places = ((file, line) for file in files for key in error.about if (line := file.line_of(key)))
        file, line = next(places, (files[0], 0))
        if file is not files[0]:
            message = f"{files[0].path}: {error} ({file.path}:{line})"
        else:
            message = f"{file.path}{f':{line}' * bool(line)}: {error}"
        raise ScenarioError(message) from error


def read_toml(path: Path) -> TomlFile:
    """Reads a file; ScenarioError for one that is missing or no TOML."""
    try:
        text = path.read_text(encoding="utf-8")
        return TomlFile(path, text, tomllib.loads(text))
    except FileNotFoundError:
        beside = (file.name for file in path.parent.glob("*.toml"))
        raise ScenarioError(f"no file {path}; beside it, {nearest(path.name, beside)}") from None
    except RecursionError:
        raise ScenarioError(f"{path}: brackets nested too deeply: expected a few levels") from None
    except ValueError as error:
        raise ScenarioError(_complaint(path, error)) from error


def _complaint(path: Path, error: ValueError) -> str:
    if isinstance(error, tomllib.TOMLDecodeError | UnicodeDecodeError):
        if path.read_bytes().startswith(b"\xef\xbb\xbf"):
            return f"{path}: a byte order mark at its start: expected UTF-8 without one"
        # as in "C:\users" and "C:\mine"
        is_backslash = "hex value" in str(error) or "Unescaped" in str(error)
        hint = "; a path with \\ needs single quotes" if is_backslash else ""
        return f"{path}: expected TOML: {error}{hint}"
    lines = enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
    longest = {number: max(map(len, re.findall(r"\d+", line)), default=0) for number, line in lines}
    number = next(n for n, digits in longest.items() if digits > sys.get_int_max_str_digits())
    return f"{path}:{number}: an integer of {longest[number]} digits: expected at most 19"
