"""Columns of numbers in a CSV file as other programs write it.

Delimiters are commas, semicolons, tabs or bars. Numbers may have decimal commas. Times may be those of ISO
8601, as 2026-05-04T12:00:00.25. A first line of titles may have units, "depth [m]". Empty lines and lines
that begin with # are left out.
"""

import csv
import math
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from fmus.errors import nearest
from fmus.units import UnitDefinition
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.system.quantities import Conversion, conversion

_DELIMITERS = "\t;|"
_ABSENT = ("", "-", "na", "n/a", "nan", "null", "none")
_TITLE = re.compile(r"(.+?)\s+[\[(]([^\[\]()]*)[\])]", re.DOTALL)  # with its unit


@dataclass(frozen=True)
class DataFile:
    """The rows of a file: the line number and the cells of each; and its titles, if the first line has any.

    units: "" where a title has none
    """

    path: Path
    titles: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[int, list[str]], ...]

    def index(self, title: str) -> int:
        """Returns the index of a column; ScenarioError offers the nearest title."""
        if title not in self.titles:
            raise ScenarioError(f"{self.path}:1: no column {title!r}; {nearest(title, self.titles)}")
        return self.titles.index(title)

    def conversion(self, index: int, expected: str, own: Mapping[str, UnitDefinition] = {}) -> Conversion:
        """Returns the change of a column to a unit; a title without a unit has the expected one.

        own: unit definitions of the FMU whose variable has the column
        Raises ScenarioError for a unit of another dimension.
        """
        try:
            return conversion(self.units[index] if self.units else "", expected, own)
        except SystemDefinitionError as error:
            raise ScenarioError(f"{self.path}:1: {self.titles[index]}: {error}") from None

    def numbers(self, *indices: int, gaps: bool = False) -> np.ndarray:
        """Returns columns, shape (rows, columns); a time of ISO 8601 as seconds after that of the first row.

        gaps: whether a cell may be empty, or say that there is no number, which gives NaN
        Raises ScenarioError for a cell that is no number, with its line.
        """
        first: dict[int, datetime] = {}

        def number(row: list[str], index: int) -> float:
            value = _number(row[index] if index < len(row) else "", gaps)
            if isinstance(value, datetime):
                return (value - first.setdefault(index, value)).total_seconds()
            return value

        result = np.empty((len(self.rows), len(indices)))
        for values, (line, row) in zip(result, self.rows, strict=True):
            try:
                values[:] = [number(row, index) for index in indices]
            except ValueError:
                columns = " and ".join(str(index + 1) for index in indices)
                expected = f"expected numbers in column{'s' * (len(indices) > 1)} {columns}"
                raise ScenarioError(f"{self.path}:{line}: {expected}, got {','.join(row)!r}") from None
        return result


def read_data_file(path: Path) -> DataFile:
    """Reads the text of a file; ScenarioError for one that is no CSV file."""
    if not path.is_file():
        got, folder = ("a folder", path) if path.is_dir() else ("no file", path.parent)
        names = [file.name for file in folder.glob("*.csv")]
        known = nearest(path.name, names) if names else "no other is there"
        raise ScenarioError(f"{path}: expected a CSV file, got {got}; {known}")
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as stream:
            lines = [(number, line) for number, line in enumerate(stream, start=1) if _holds_data(line)]
        # a comma is the delimiter only where no other is: it may be that of decimals
        delimiter = next((one for one in _DELIMITERS if lines and one in lines[0][1]), ",")
        cells = csv.reader((line for _, line in lines), delimiter=delimiter, strict=True)
        rows = tuple((number, row) for (number, _), row in zip(lines, cells, strict=True))
    except (OSError, csv.Error, ValueError) as error:
        reason = getattr(error, "strerror", None) or error  # without the number of an error of the system
        raise ScenarioError(f"{path}: expected a CSV file, got {reason}") from error
    with suppress(ValueError):
        _number(rows[0][1][0] if rows else "0")
        return DataFile(path, (), (), rows)
    matches = [(_TITLE.fullmatch(title.strip()), title.strip()) for title in rows[0][1]]
    titles = tuple(match[1] if match else title for match, title in matches)
    units = tuple(match[2] if match else "" for match, _ in matches)
    return DataFile(path, titles, units, rows[1:])


def _holds_data(line: str) -> bool:
    return bool(line.strip()) and not line.startswith("#")


def _number(text: str, gaps: bool = False) -> float | datetime:
    """Returns a number or a time, in UTC if it names no zone; ValueError for neither."""
    text = text.strip()
    if text.lower() in _ABSENT:
        return math.nan if gaps else float("")  # which is no number
    with suppress(ValueError):
        return float(text)
    if text.count(",") == 1 and "." not in text:
        with suppress(ValueError):
            return float(text.replace(",", "."))
    time = datetime.fromisoformat(text)
    return time if time.tzinfo else time.replace(tzinfo=UTC)
