"""Columns of numbers in a CSV file as other programs write it.

Delimiters are commas, semicolons, tabs or bars. Numbers may have decimal commas if no comma separates cells.
Times may be those of ISO 8601, as 2026-05-04T12:00:00.25. A first line of titles may have units, "depth [m]".
All rows have as many cells. Empty lines and lines that begin with # are left out.
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
# with its unit: "u [cm]", "u (cm)" or "u[cm]", but for an index as of "u[1,2]"
_TITLE = re.compile(r"(.+?)(?:\s+[\[(]|\[(?![\d,\s]*\]))([^\[\]()]*)[\])]", re.DOTALL)
_FIRST_NUMBER = re.compile(r"[+-]?[.,]?\d")  # begins a file without titles
_CLOCK_TIME = re.compile(r"\d+:\d+(:\d+([.,]\d*)?)?")
_DATED = "; seconds or a date before it: 2026-05-04T13:50:40"


@dataclass(frozen=True)
class DataFile:
    """The rows of a file: the line number and the cells of each; and its titles, if the first line has any.

    units: "" where a title has none; delimiter: between cells
    """

    path: Path
    titles: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[int, list[str]], ...]
    delimiter: str

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

    def numbers(self, *indices: int, gaps: bool = False, names: Mapping[str, float] = {}) -> np.ndarray:
        """Returns columns, shape (rows, columns); a time of ISO 8601 as seconds after that of the first row.

        gaps: whether a cell may be empty, or say that there is no number, which gives NaN
        names: text that stands for a number -> the number
        Raises ScenarioError for a cell that is no number, or among dates no date, with its line.
        """
        return np.array([self._column(index, gaps, names) for index in indices]).T

    def _column(self, index: int, gaps: bool, names: Mapping[str, float]) -> list[float]:
        column: list[float] = []
        start: datetime | None = None
        for line, row in self.rows:
            text = row[index].strip() if index < len(row) else ""
            value = names.get(text, names.get(text.lower(), _number(text, gaps, self.delimiter)))
            if isinstance(value, datetime) and (start or not np.isfinite(column).any()):
                start = start or value
                value = (value - start).total_seconds()
            elif isinstance(value, datetime) or value is None or (start and not math.isnan(value)):
                expected = ("a date" if start else "a number") + (
                    f" or one of {', '.join(names)}" if names else ""
                )
                remedy = _DATED if _CLOCK_TIME.fullmatch(text) else ""
                where = f"{self.path}:{line}"
                raise ScenarioError(
                    f"{where}: expected {expected} in column {index + 1}, got {text!r}{remedy}"
                )
            column.append(value)
        if start and self.units and self.units[index] not in ("", "s"):
            title, unit = self.titles[index], self.units[index]
            raise ScenarioError(
                f"{self.path}:1: {title} has dates in {unit}: expected a title without a unit"
            )
        return column

    def check_ascending(self, times: np.ndarray) -> None:
        """Raises ScenarioError for a row with an earlier time [s] than the row before, with its line."""
        for i in np.flatnonzero(np.diff(times) < 0.0)[:1].tolist():
            raise ScenarioError(
                f"{self.path}:{self.rows[i + 1][0]}: earlier time {times[i + 1]:.9g} s after "
                f"{times[i]:.9g} s: expected ascending times"
            )


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
    for line, row in rows:
        if len(row) != len(rows[0][1]):
            raise ScenarioError(
                f"{path}:{line}: {len(row)} cells: expected {len(rows[0][1])}, as in the first row"
            )
    if not rows or _FIRST_NUMBER.match(rows[0][1][0].strip()):
        return DataFile(path, (), (), rows, delimiter)
    matches = [(_TITLE.fullmatch(title.strip()), title.strip()) for title in rows[0][1]]
    titles = tuple(match[1] if match else title for match, title in matches)
    units = tuple(match[2] if match else "" for match, _ in matches)
    if twice := next((title for title in titles if title and titles.count(title) > 1), ""):
        raise ScenarioError(f"{path}:{rows[0][0]}: two columns {twice!r}: expected titles that differ")
    return DataFile(path, titles, units, rows[1:], delimiter)


def _holds_data(line: str) -> bool:
    return bool(line.strip()) and not line.startswith("#")


def _number(text: str, gaps: bool, delimiter: str) -> float | datetime | None:
    """Returns a number or a time, in UTC if it names no zone; None for neither."""
    if text.lower() in _ABSENT:
        return math.nan if gaps else None
    if delimiter != "," and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    with suppress(ValueError):
        if "_" not in text:  # with which Python groups digits
            return float(text)
    with suppress(ValueError):
        time = datetime.fromisoformat(text)
        return time if time.tzinfo else time.replace(tzinfo=UTC)
    return None
