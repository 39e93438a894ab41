"""Columns of numbers in a CSV file as other programs write it.

Delimiters are commas, semicolons, tabs or bars. Numbers may have decimal commas if no comma separates cells.
Times may be dates of ISO 8601, as 2026-05-04T12:00:00.25. A first line of titles may have units, "depth [m]".
All rows have as many cells. Empty lines and lines that begin with # are left out, but where numbers come
first, the last of these above them that has as many cells, and units if any has, holds the titles.
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
from fmus.units import UnitDefinition, si_unit
from orchestration.errors import ScenarioError, SystemDefinitionError
from orchestration.system.quantities import Conversion, conversion

_DELIMITERS = "\t;|"
_ABSENT = ("", "-", "na", "n/a", "nan", "null", "none")
# with its unit: "u [cm]", "u(cm)" or "[cm]", except an index such as "u[1,2]", and "der(x)"
_TITLE = re.compile(
    r"(.*?)(?:\s*/)?(?:\s+[\[(]|(?:\[|(?<!\bder)\()(?![\d,\s]*[\])]))([^\[\]()]*)[\])]", re.DOTALL
)
_OVER = re.compile(r"(.+?)(\s*/\s*|\s+in\s+)(.+)", re.DOTALL)  # "u / cm"
# begins a file without titles
_FIRST_NUMBER = re.compile(r' *"? *[+-]?([.,]?\d|(nan|inf) *[",;\t|])', re.IGNORECASE)
_DECIMAL = re.compile(r"\s*[+-]?\d*([.,])\d+(?:[eE][+-]?\d+)?\s*")
_CLOCK_TIME = re.compile(r"\d+:\d+(:\d+([.,]\d*)?)?")
_ONE_SIGN = "expected one decimal sign in a file, and digits that are not in groups"
_DATED = "; seconds or a date before it: 2026-05-04T13:50:40"


@dataclass(frozen=True)
class DataFile:
    """The rows of a file: the line number and the cells of each; and its titles, if it has any.

    units: "" where a title has none; delimiter: between cells; start: path and line of the titles
    """

    path: Path
    titles: tuple[str, ...]
    units: tuple[str, ...]
    rows: tuple[tuple[int, list[str]], ...]
    delimiter: str
    start: str

    def index(self, title: str) -> int:
        """Returns the index of a column; ScenarioError offers the nearest title."""
        if title not in self.titles:
            raise ScenarioError(f"{self.start}: no column {title!r}; {nearest(title, self.titles)}")
        return self.titles.index(title)

    def conversion(self, index: int, expected: str, own: Mapping[str, UnitDefinition] = {}) -> Conversion:
        """Returns the change of a column to a unit; a title without a unit has the expected one.

        own: unit definitions of the FMU whose variable has the column
        Raises ScenarioError for a unit of another dimension.
        """
        try:
            return conversion(self.units[index] if self.units else "", expected, own)
        except SystemDefinitionError as error:
            raise ScenarioError(f"{self.start}: {self.titles[index]}: {error}") from None

    def numbers(self, *indices: int, gaps: bool = False, names: Mapping[str, float] = {}) -> np.ndarray:
        """Returns columns, shape (rows, columns); a time of ISO 8601 as seconds after the first row's.

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
                expected = ("a date" if start else "a number") + f" or one of {', '.join(names)}" * bool(
                    names
                )
                remedy = _DATED if _CLOCK_TIME.fullmatch(text) else ""
                got = f"expected {expected} in column {index + 1}, got {text!r}{remedy}"
                raise ScenarioError(f"{self.path}:{line}: {got}")
            column.append(value)
        if start and self.units and self.units[index] not in ("", "s"):
            title, unit = self.titles[index], self.units[index]
            raise ScenarioError(f"{self.start}: {title} has dates in {unit}: expected a title without a unit")
        return column

    def times(self, index: int | None = None) -> np.ndarray:
        """Returns a column of times [s]; ScenarioError for one earlier than that before, with its line.

        index: by default the first column's; ScenarioError if another one has the title "time"
        """
        if index is None:
            index, titles = 0, [title.lower() for title in self.titles]
            # pandas writes numbers of rows as a first column
            if "time" in titles[1:] and titles[0] != "time":
                raise ScenarioError(f"{self.start}: 'time' is not the first column: expected it there")
        # before the conversion: dates with a unit are refused as dates, not as another dimension
        numbers = self.numbers(index)[:, 0]
        times = self.conversion(index, "s")(numbers)
        for i in np.flatnonzero(np.diff(times) < 0.0)[:1].tolist():
            raise ScenarioError(
                f"{self.path}:{self.rows[i + 1][0]}: earlier time {times[i + 1]:.9g} s after "
                f"{times[i]:.9g} s: expected ascending times"
            )
        return times


def read_data_file(path: Path) -> DataFile:
    """Reads the text of a file; ScenarioError for one that is no CSV file."""
    if not path.is_file():
        got, folder = ("a folder", path) if path.is_dir() else ("no file", path.parent)
        names = [file.name for file in folder.glob("*.csv")]
        known = nearest(path.name, names) if names else "no other is there"
        raise ScenarioError(f"{path}: expected a CSV file, got {got}; {known}")
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as stream:
            numbered = list(enumerate(stream, start=1))
        if any("\0" in line for _, line in numbered):
            raise ValueError("UTF-16 or no text; save it as UTF-8")
        lines = [(number, line) for number, line in numbered if _holds_data(line)]
        # a comma is the delimiter only where no other is found: it may be the decimal sign
        delimiter = next((one for one in _DELIMITERS if lines and one in lines[0][1]), ",")
        if lines and _FIRST_NUMBER.match(lines[0][1]):
            above = [(n, line.lstrip("# \t")) for n, line in numbered[: lines[0][0] - 1] if line[0] == "#"]
            titles = [x for x in above if not _FIRST_NUMBER.match(x[1])]
            titles = [x for x in titles if x[1].count(delimiter) == lines[0][1].count(delimiter)]
            titles.sort(key=lambda x: any(si_unit(_title_and_unit(y)[1]) for y in x[1].split(delimiter)))
            lines = titles[-1:] + lines
        cells = csv.reader((line for _, line in lines), delimiter=delimiter, strict=True)
        rows = tuple((number, row) for (number, _), row in zip(lines, cells, strict=True))
    except (OSError, csv.Error, ValueError) as error:
        # `strerror` leaves out the number of a system's error
        reason = getattr(error, "strerror", None) or error
        raise ScenarioError(f"{path}: expected a CSV file, got {reason}") from error
    begin, first = rows[0] if rows else (1, [])
    start = f"{path}:{begin}"
    for line, row in rows:
        if len(row) != len(first):
            raise ScenarioError(f"{path}:{line}: {len(row)} cells: expected {len(first)}, as the first row")
    numbers = rows[::-1] if delimiter != "," else []
    signs = {m[1]: (line, m[0]) for line, row in numbers for m in map(_DECIMAL.fullmatch, row) if m}
    if len(signs) > 1:
        (before, other), (line, cell) = sorted(signs.values())
        raise ScenarioError(f"{path}:{line}: got {cell!r}, after {other!r} in line {before}: {_ONE_SIGN}")
    if not rows or _FIRST_NUMBER.match(lines[0][1]):
        return DataFile(path, (), (), rows, delimiter, start)
    titles, units = zip(*map(_title_and_unit, first), strict=True)
    if twice := next((title for title in titles if title and titles.count(title) > 1), ""):
        raise ScenarioError(f"{start}: two columns {twice!r}: expected titles that differ")
    return DataFile(path, titles, units, rows[1:], delimiter, start)


def _holds_data(line: str) -> bool:
    """Whether a line is not empty, no comment, and not Excel's line that names the delimiter."""
    return bool(line.strip()) and not line.lower().startswith(("#", "sep="))


def _title_and_unit(cell: str) -> tuple[str, str]:
    text = cell.strip()
    if match := _TITLE.fullmatch(text):
        return match[1], match[2]
    match = _OVER.fullmatch(text)
    return (match[1], match[3]) if match and (match[2] == " / " or si_unit(match[3])) else (text, "")


def _number(text: str, gaps: bool, delimiter: str) -> float | datetime | None:
    """Returns a number or a time, in UTC if it names no zone; None for neither."""
    if text.lower() in _ABSENT:
        return math.nan if gaps else None
    if delimiter != "," and text.count(",") == 1 and "." not in text:
        text = text.replace(",", ".")
    with suppress(ValueError):
        # float() accepts the underscores by which Python groups digits
        if "_" not in text:
            return float(text)
    with suppress(ValueError):
        time = datetime.fromisoformat(text)
        return time if time.tzinfo else time.replace(tzinfo=UTC)
    return None
