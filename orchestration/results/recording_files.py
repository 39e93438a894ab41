"""Recordings as files: CSV for everyone, Parquet with the provenance inside. Floats survive both exactly."""

import csv
import json
import re
from enum import StrEnum
from pathlib import Path
from typing import TextIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from fmus.errors import nearest
from orchestration.errors import OrchestrationError
from orchestration.results.recording import TIME, Recording, write_whole, write_whole_binary

_TIME_TITLE = f"{TIME} [s]"
_TITLE = re.compile(r"(.*) \[([^\[\]]*)\]", re.DOTALL)  # of a signal with its unit
_UNIT, _KIND, _PROVENANCE = b"unit", b"l1_depth.kind", b"l1_depth.provenance"
_RECORDING = b"recording"


class Format(StrEnum):
    """Kinds of files that a recording is written to, by their ending."""

    CSV = "csv"
    PARQUET = "parquet"


def write(recording: Recording, path: Path) -> None:
    """A recording as the ending of the path says."""
    {Format.CSV: _write_csv, Format.PARQUET: _write_parquet}[_format(path)](recording, path)


def read(path: Path) -> Recording:
    """The inverse of `write`; CSV does not keep the provenance.

    Raises OrchestrationError for a file that is none of these, or is damaged.
    """
    if not path.is_file():
        beside = [each.name for each in path.parent.glob("*") if each.suffix[1:] in set(Format)]
        raise OrchestrationError(f"no file {path}; beside it, {nearest(path.name, beside)}")
    return {Format.CSV: _read_csv, Format.PARQUET: _read_parquet}[_format(path)](path)


def is_recording(path: Path) -> bool:
    """Whether a file says that it is one; nothing of its data is read."""
    if path.suffix[1:] == Format.CSV:
        with path.open("rb") as stream:
            return stream.readline().startswith(_TIME_TITLE.encode())
    return path.suffix[1:] == Format.PARQUET and _metadata(path).get(_KIND) == _RECORDING


def _metadata(path: Path) -> dict[bytes, bytes]:
    try:
        return pq.read_schema(path).metadata or {}
    except pa.ArrowInvalid as error:
        raise OrchestrationError(f"{path}: expected a Parquet file: {error}") from error


def _format(path: Path) -> Format:
    try:
        return Format(path.suffix[1:])
    except ValueError:
        raise OrchestrationError(f"{path}: expected a file ending in {' or '.join(Format)}") from None


def _write_csv(recording: Recording, path: Path) -> None:
    header = [_TIME_TITLE, *(_title(*each) for each in zip(recording.names, recording.units, strict=True))]

    def rows(stream: TextIO) -> None:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(np.column_stack([recording.time, recording.values]).tolist())

    write_whole(path, rows)


def _title(name: str, unit: str) -> str:
    """ "name [unit]", or the name alone if there is no unit and nothing in the name looks like one."""
    return f"{name} [{unit}]" if unit or _TITLE.fullmatch(name) else name


def _read_csv(path: Path) -> Recording:
    with path.open(newline="", encoding="utf-8") as stream:
        try:
            header = next(csv.reader(stream), [])
            if header[:1] != [_TIME_TITLE]:
                raise OrchestrationError(
                    f"{path}: expected {_TIME_TITLE!r} as first column, got {header[:1]}"
                )
            lines = stream.readlines()
            data = np.loadtxt(lines, delimiter=",", ndmin=2) if lines else np.empty((0, len(header)))
        except (ValueError, csv.Error) as error:
            raise OrchestrationError(f"{path}: expected a table of numbers: {error}") from error
    if data.shape[1] != len(header):
        raise OrchestrationError(f"{path}: expected {len(header)} columns, got {data.shape[1]}")
    titles = [(found[1], found[2]) if (found := _TITLE.fullmatch(t)) else (t, "") for t in header[1:]]
    return Recording(
        names=tuple(name for name, _ in titles),
        units=tuple(unit for _, unit in titles),
        time=data[:, 0],
        values=data[:, 1:],
    )


def _write_parquet(recording: Recording, path: Path) -> None:
    """Units as metadata of the columns, the provenance as that of the table."""
    names, units = (TIME, *recording.names), ("s", *recording.units)
    fields = [
        pa.field(n, pa.float64(), nullable=False, metadata={_UNIT: u})
        for n, u in zip(names, units, strict=True)
    ]
    metadata = {_KIND: _RECORDING, _PROVENANCE: json.dumps(recording.provenance)}
    columns = [pa.array(column) for column in (recording.time, *recording.values.T)]
    table = pa.Table.from_arrays(columns, schema=pa.schema(fields, metadata=metadata))
    write_whole_binary(path, lambda stream: pq.write_table(table, stream))


def _read_parquet(path: Path) -> Recording:
    metadata = _metadata(path)
    if metadata.get(_KIND) != _RECORDING:
        raise OrchestrationError(
            f"{path}: expected a recording, as l1-depth run writes it; got another table"
        )
    table = pq.read_table(path)
    signals = table.schema.names[1:]
    return Recording(
        names=tuple(signals),
        units=tuple(table.schema.field(name).metadata[_UNIT].decode() for name in signals),
        time=table[TIME].to_numpy(),
        values=np.column_stack([table[name].to_numpy() for name in signals] or [np.empty((len(table), 0))]),
        provenance=json.loads(metadata[_PROVENANCE]),
    )
