"""The files of a sweep: a journal while it runs, so that nothing done is lost; one table at the end.

NAME.sweep.jsonl     while it runs: the journal, a row for each finished sample
NAME.sweep.lock      while a process runs it
NAME.recordings/     recordings of the samples, if they were asked for
NAME.sweep.parquet   the table
"""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from fmus.extras import imports_of
from fmus.files import write_bytes_atomically
from orchestration.errors import SweepError
from orchestration.many.journal import Journal
from orchestration.sweep import table

with imports_of("sweep", "a sweep"):
    import pyarrow as pa


class Store:
    """The files of one sweep, for one process at a time: the context holds their lock until it ends.

    columns: as of `table.schema`; SweepError if the files are those of another sweep
    """

    def __init__(self, folder: Path, columns: pa.Schema) -> None:
        about = table.provenance_of(columns)
        self._columns, self._count, name = columns, about["samples"], about["name"]
        self.path = folder / f"{name}.sweep.parquet"
        self.recordings = folder / f"{name}.recordings"
        self._journal = Journal(folder / f"{name}.sweep.jsonl", about, "sweep", SweepError, _identity)

    def __enter__(self) -> "Store":
        self._journal.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self._journal.__exit__()

    def discard(self) -> None:
        """Removes what an earlier sweep of that name has left."""
        self.path.unlink(missing_ok=True)
        self._journal.discard()
        shutil.rmtree(self.recordings, ignore_errors=True)

    def begin(self) -> set[int]:
        """Returns the samples that are done already."""
        if self.path.is_file():
            finished, stored = table.read(self.path)
            self._journal.check_same(stored, self.path)
            return self._checked(finished[table.SAMPLE].to_pylist(), self.path)
        self._journal.begin()
        return set(np.flatnonzero(self._positions() >= 0).tolist())

    def add(self, rows: Sequence[Mapping[str, Any]], recordings: Sequence[bytes | None] = ()) -> None:
        """Stores the rows of samples that are done, and their recordings as Parquet files."""
        digits = len(str(self._count - 1))
        for row, recording in zip(rows, recordings, strict=False):
            if recording:
                number = f"{row[table.SAMPLE]:0{digits}}"
                write_bytes_atomically(self.recordings / f"sample-{number}.parquet", recording)
        self._journal.add(rows)

    def finish(self) -> None:
        """Writes the table; SweepError if samples are missing."""
        if not self.path.is_file():
            positions = self._positions()
            if (positions < 0).any():
                self._checked(np.flatnonzero(positions >= 0).tolist(), self._journal.path)
            table.write(self._journal.rows_at(positions), self._columns, self.path)
        self._journal.discard()

    def _checked(self, samples: Iterable[int], path: Path) -> set[int]:
        """Returns the samples; SweepError unless they are all, each once."""
        numbers = sorted(samples)
        if numbers != list(range(self._count)):
            raise self._journal.refusal(
                f"{path}: {len(numbers)} rows of {len(set(numbers))} samples, expected {self._count}"
            )
        return set(numbers)

    def _positions(self) -> np.ndarray:
        """Returns each sample's row in the journal, shape (samples,); -1 for one that was not run."""
        positions = np.full(self._count, -1, np.int64)
        for position, row in self._journal.rows():
            if row.keys() >= {table.SAMPLE, table.ERROR} and row[table.SAMPLE] < self._count:
                positions[row[table.SAMPLE]] = position
        return positions


def _identity(key: str, value: Any) -> Any:
    """Returns what is compared of a value: hashes of FMUs, but neither their paths nor the command's text."""
    if key == "arguments":
        return None
    if key == "scenario" and isinstance(value, dict):
        return {**value, "components": sorted(value["components"])}
    return value
