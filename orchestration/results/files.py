"""Files of recordings: CSV for everyone, Parquet with the provenance inside. Floats survive both exactly."""

import csv
import errno
import hashlib
import io
import itertools
import json
import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import ModuleType
from typing import Any, BinaryIO, TextIO

import numpy as np

from fmus.errors import nearest
from fmus.extras import require
from fmus.files import open_atomically, write_json_atomically
from fmus.operating_system import allocate
from orchestration.errors import OrchestrationError
from orchestration.results.formats import RecordingFormat

TIME = "time"  # name of the first column
ERROR_ESTIMATE = "error_estimate."
"""Prefix of the column with the estimated error of a signal."""
_TIME_TITLE = f"{TIME} [s]"
_STRING = "String"  # in a title in place of the unit: a column of text
_TITLE = re.compile(r"(.*) \[([^\[\]]*)\]", re.DOTALL)  # of a signal with its unit
_UNIT, _KIND, _PROVENANCE = b"unit", b"l1_depth.kind", b"l1_depth.provenance"
_RECORDING = b"recording"
# The numbers of so many rows stay in the processor's cache while they become text.
_BLOCK = 250
_LEAST_PLAIN, _FIRST_LARGE = 1e-4, 1e16  # `repr` writes numbers between them without an exponent
_GROUP = 1 << 17  # rows of Parquet that are copied at a time
_BYTES = {RecordingFormat.CSV: 20, RecordingFormat.PARQUET: 8}  # about, of a number in a file


@dataclass(frozen=True)
class Columns:
    """Signals by name, as a file has them: the base of `Recording`, whose docstring explains the fields."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    provenance: dict[str, Any] = field(default_factory=dict)
    strings: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __getitem__(self, name: str) -> np.ndarray:
        """Returns one signal, shape (n,) or (runs, n); a String as an array of text.

        Parameters
        ----------
        name
            "component.variable", or "time" for the communication points [s].

        Raises
        ------
        OrchestrationError
            If the signal was not recorded; the message names the nearest one.
        """
        if name == TIME:
            return self.time
        values = self.values[..., self._column(name)]
        return np.array(self.strings[name], object)[values.astype(int)] if name in self.strings else values

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of the signals other than Strings."""
        return tuple(name for name in self.names if name not in self.strings)

    def _column(self, name: str) -> int:
        try:
            return self.names.index(name)
        except ValueError:
            raise OrchestrationError(f"{name!r} was not recorded; {nearest(str(name), self.names)}") from None

    def unit(self, name: str) -> str:
        """Returns the unit of a signal, "" if the FMU gives none.

        Parameters
        ----------
        name : str
            "component.variable", or "time".

        Returns
        -------
        str

        Raises
        ------
        OrchestrationError
            If the signal was not recorded; the message names the nearest one.
        """
        return "s" if name == TIME else self.units[self._column(name)]

    def columns(self) -> list[list[Any]]:
        """Returns the values of each signal, Strings as text.

        Returns
        -------
        list of lists
        """
        return [self[name].tolist() for name in self.names]


def write(path: Path, content: Columns) -> str:
    """Writes a file in the format of its ending; returns its SHA-256."""
    write_format = {RecordingFormat.CSV: _write_csv, RecordingFormat.PARQUET: _write_parquet}[_format(path)]
    with open_atomically(path) as stream:
        write_format(stream, content)
        # The digest is of this stream: another run may write the same path a moment later.
        stream.seek(0)
        return hashlib.file_digest(stream, "sha256").hexdigest()


def write_document(
    path: Path, digest: str, scenario: Mapping[str, Any], run: Mapping[str, Any], metrics: Mapping[str, Any]
) -> Path:
    """Writes the .json of a run beside its recording and returns it; digest: SHA-256 of the recording.

    scenario: resolved, as TOML has it; run: its provenance; metrics: name -> "value" and "unit"
    """
    document = {
        "recording": path.name,
        "sha256": digest,
        "scenario": scenario,
        "run": run,
        "metrics": metrics,
    }
    write_json_atomically(file := path.with_suffix(".json"), document)
    return file


def read(path: Path) -> Columns:
    """Reads a recording; one from CSV has no provenance.

    Raises OrchestrationError for a file that is not a recording, or is damaged.
    """
    if not path.is_file():
        beside = [file.name for file in path.parent.glob("*") if file.suffix[1:] in set(RecordingFormat)]
        raise OrchestrationError(f"no file {path}; beside it, {nearest(path.name, beside)}")
    return {RecordingFormat.CSV: _read_csv, RecordingFormat.PARQUET: _read_parquet}[_format(path)](path)


@contextmanager
def reserved(path: Path, shape: tuple[int, int]) -> Iterator[None]:
    """Allocates the disk space of a recording until the context ends.

    shape: points, signals. Raises OrchestrationError if the disk has less space.
    """
    needed = shape[0] * (shape[1] + 1) * _BYTES[_format(path)]
    path.parent.mkdir(parents=True, exist_ok=True)
    # A file without a name is freed with the process, however it ends.
    stream = tempfile.TemporaryFile(dir=path.parent, buffering=0)  # noqa: SIM115
    try:
        _allocate(stream.fileno(), needed, path)
        yield
    finally:
        # An FMU may have closed the descriptor: it runs in this process.
        with suppress(OSError):
            stream.close()


def _allocate(descriptor: int, size: int, path: Path) -> None:
    try:
        if shutil.disk_usage(path.parent).free < size:
            raise OSError(errno.ENOSPC, "")
        if size:
            allocate(descriptor, size)
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
            raise OrchestrationError(
                f"{path}: the recording needs about {size / 1e6:.3g} MB, expected as much room on the disk; "
                "record fewer signals, write Parquet, or write elsewhere"
            ) from None


def is_recording(path: Path) -> bool:
    """Whether a file is marked as a recording, without reading its data."""
    if path.suffix[1:] == RecordingFormat.CSV:
        with path.open("rb") as stream:
            return stream.readline().startswith(_TIME_TITLE.encode())
    return path.suffix[1:] == RecordingFormat.PARQUET and _metadata(path).get(_KIND) == _RECORDING


def _format(path: Path) -> RecordingFormat:
    try:
        return RecordingFormat(path.suffix[1:])
    except ValueError:
        raise OrchestrationError(
            f"{path}: expected a file ending in {' or '.join(RecordingFormat)}"
        ) from None


def _write_csv(stream: BinaryIO, content: Columns) -> None:
    pairs = zip(content.names, content.units, strict=True)
    titles = [_title(name, _STRING if name in content.strings else unit) for name, unit in pairs]
    text = io.TextIOWrapper(stream, encoding="utf-8", newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([_TIME_TITLE, *titles])
    # a carriage return in a text would else end the row
    texts = csv.writer(text, lineterminator="\n", quoting=csv.QUOTE_NONNUMERIC)
    text.flush()
    for start in range(0, len(content.time), _BLOCK):
        rows = slice(start, start + _BLOCK)
        block = replace(content, values=content.values[rows])
        if content.strings:
            texts.writerows(zip(content.time[rows].tolist(), *block.columns(), strict=True))
        else:
            stream.write(_lines(np.column_stack([content.time[rows], block.values])))
    text.detach()


def _lines(rows: np.ndarray) -> bytes:
    """Returns rows of numbers as lines, each number in the fewest digits that read back exactly."""
    # imported here because runs that write no CSV start faster without it
    from pydantic_core import to_json

    # `to_json` writes numbers without an exponent as `repr` does, in a fifth of its time
    numbers, sizes = rows.tolist(), np.abs(rows)
    lines = to_json(numbers)[2:-2].split(b"],[")
    is_plain = (sizes >= _LEAST_PLAIN) & (sizes < _FIRST_LARGE) | (sizes == 0.0)
    for row in np.flatnonzero(~is_plain.all(axis=1)).tolist():
        cells = lines[row].split(b",")
        for column in np.flatnonzero(~is_plain[row]).tolist():
            cells[column] = repr(numbers[row][column]).encode()
        lines[row] = b",".join(cells)
    return b"\n".join(lines) + b"\n"


def _title(name: str, unit: str) -> str:
    """Returns "name [unit]", or the name alone if there is no unit and nothing in the name looks like one."""
    return f"{name} [{unit}]" if unit or _TITLE.fullmatch(name) else name


def _read_csv(path: Path) -> Columns:
    with path.open(newline="", encoding="utf-8") as stream:
        try:
            header = next(csv.reader(stream), [])
            if header[:1] != [_TIME_TITLE]:
                raise OrchestrationError(
                    f"{path}: expected {_TIME_TITLE!r} as first column, got {header[:1]}"
                )
            pairs = [(match[1], match[2]) if (match := _TITLE.fullmatch(t)) else (t, "") for t in header[1:]]
            strings: dict[str, list[str]] = {name: [] for name, unit in pairs if unit == _STRING}
            if strings:
                data = np.array(_rows_with_strings(stream, pairs, strings), float).reshape(-1, len(header))
            else:
                first = stream.readline()
                lines = itertools.chain([first], stream)
                data = np.loadtxt(lines, delimiter=",", ndmin=2) if first else np.empty((0, len(header)))
        except (ValueError, csv.Error) as error:
            raise OrchestrationError(f"{path}: expected a table of numbers: {error}") from error
    if data.shape[1] != len(header):
        raise OrchestrationError(f"{path}: expected {len(header)} columns, got {data.shape[1]}")
    names = tuple(name for name, _ in pairs)
    units = tuple("" if unit == _STRING else unit for _, unit in pairs)
    return Columns(names, units, data[:, 0], data[:, 1:], {}, strings)


def _rows_with_strings(
    stream: TextIO, pairs: list[tuple[str, str]], strings: dict[str, list[str]]
) -> list[list[float]]:
    """Returns the lines of a table as numbers; a text becomes its index in the list of its column."""
    names = ["", *(name for name, _ in pairs)]
    numbers: dict[str, dict[str, int]] = {name: {} for name in strings}
    rows = []
    for row in csv.reader(stream):
        cells = zip(names, row, strict=True)
        rows.append(
            [
                float(numbers[name].setdefault(cell, len(numbers[name])) if name in strings else cell)
                for name, cell in cells
            ]
        )
    for name, known in numbers.items():
        strings[name].extend(known)
    return rows


def _write_parquet(stream: BinaryIO, content: Columns) -> None:
    """Writes units as metadata of the columns, and the provenance as metadata of the table."""
    pa, pq = _arrow()
    names, units = (TIME, *content.names), ("s", *content.units)
    fields = [
        pa.field(
            name,
            pa.string() if name in content.strings else pa.float64(),
            nullable=False,
            metadata={_UNIT: unit},
        )
        for name, unit in zip(names, units, strict=True)
    ]
    metadata = {_KIND: _RECORDING, _PROVENANCE: json.dumps(content.provenance)}
    schema = pa.schema(fields, metadata=metadata)
    # Numbers hardly repeat: a dictionary of them would only add memory and bytes.
    strings = [*content.strings] or False
    with pq.ParquetWriter(stream, schema, use_dictionary=strings) as writer:
        for start in range(0, max(len(content.time), 1), _GROUP):
            rows = slice(start, start + _GROUP)
            part = replace(content, values=content.values[rows])
            values = part.columns() if content.strings else part.values.T
            columns = [pa.array(column) for column in (content.time[rows], *values)]
            writer.write_table(pa.Table.from_arrays(columns, schema=schema))


def _read_parquet(path: Path) -> Columns:
    metadata = _metadata(path)
    if metadata.get(_KIND) != _RECORDING:
        raise OrchestrationError(
            f"{path}: expected a recording, as l1-depth run writes it; got another table"
        )
    pa, pq = _arrow()
    table = pq.read_table(path)
    signals = table.schema.names[1:]
    strings = {}
    for i, name in enumerate(table.schema.names):
        if table.schema.field(name).type == pa.string():
            encoded = table[name].combine_chunks().dictionary_encode()
            strings[name] = encoded.dictionary.to_pylist()
            field = table.schema.field(name).with_type(pa.float64())
            table = table.set_column(i, field, encoded.indices.cast(pa.float64()))
    return Columns(
        names=tuple(signals),
        units=tuple(table.schema.field(name).metadata[_UNIT].decode() for name in signals),
        time=table[TIME].to_numpy(),
        values=np.column_stack([table[name].to_numpy() for name in signals] or [np.empty((len(table), 0))]),
        provenance=json.loads(metadata[_PROVENANCE]),
        strings=strings,
    )


def _metadata(path: Path) -> dict[bytes, bytes]:
    pa, pq = _arrow()
    try:
        return pq.read_schema(path).metadata or {}
    except pa.ArrowInvalid as error:
        raise OrchestrationError(f"{path}: expected a Parquet file: {error}") from error


def _arrow() -> tuple[ModuleType, ModuleType]:
    purpose = "a Parquet file"
    return require("pyarrow", "tables", purpose), require("pyarrow.parquet", "tables", purpose)
