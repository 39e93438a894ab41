"""The files of a sweep: a log while it runs, so that nothing done is lost; one table at the end.

NAME.sweep.jsonl     while it runs: what is run, then a line for each finished sample; it may not fit into
                     memory, so it is read line by line
NAME.sweep.lock      while a process runs it
NAME.recordings/     recordings of the samples, if they were asked for
NAME.sweep.parquet   the table
"""

import json
import shutil
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from fmus.extras import imports_of
from fmus.files import write_bytes_atomically
from orchestration.errors import SweepError
from orchestration.sweep import table

with imports_of("sweep", "a sweep"):
    import pyarrow as pa
    from filelock import FileLock, Timeout

_DISCARD = "--restart discards it"


class Store:
    """The files of one sweep, for one process at a time: the context holds their lock until it ends.

    columns: as of `table.schema`; SweepError if the files are those of another sweep
    """

    def __init__(self, folder: Path, columns: pa.Schema) -> None:
        self._columns, self._provenance = columns, table.provenance_of(columns)
        name = self._provenance["name"]
        self.path = folder / f"{name}.sweep.parquet"
        self.recordings = folder / f"{name}.recordings"
        self._log = folder / f"{name}.sweep.jsonl"
        self._lock_file = folder / f"{name}.sweep.lock"
        self._lock = FileLock(self._lock_file, timeout=0)

    def __enter__(self) -> "Store":
        self._lock_file.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._lock.acquire()
        except Timeout:
            raise SweepError(
                f"{self._lock_file}: another process runs this sweep; expected its end, or another folder"
            ) from None
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(OSError):  # Windows does not remove an open file, but at its release
            self._lock_file.unlink()
        self._lock.release()

    def discard(self) -> None:
        """Remove what an earlier sweep of that name has left."""
        for file in (self.path, self._log):
            file.unlink(missing_ok=True)
        shutil.rmtree(self.recordings, ignore_errors=True)

    def begin(self) -> set[int]:
        """The samples that are done already."""
        if self.path.is_file():
            finished, stored = table.read(self.path)
            self._check_same(stored, self.path)
            return self._checked(finished[table.SAMPLE].to_pylist(), self.path)
        if self._log.is_file():
            with self._log.open("rb") as log:
                self._check_same(_read_line(log.readline()), self._log)
            return set(np.flatnonzero(self._positions() >= 0).tolist())
        write_bytes_atomically(self._log, json.dumps(self._provenance).encode())
        return set()

    def _check_same(self, stored: Mapping[str, Any], path: Path) -> None:
        """Rows of two sweeps must not be mixed."""
        if not stored:
            raise SweepError(f"{path}: expected what is run in the first line, it is damaged; {_DISCARD}")
        ours = self._provenance
        differing = [key for key in ours if _identity(key, ours[key]) != _identity(key, stored.get(key))]
        if differing:
            raise SweepError(
                f"{path} is of another sweep ({', '.join(differing)} differ): expected the same; {_DISCARD}"
            )

    def add(self, rows: Sequence[Mapping[str, Any]], recordings: Sequence[bytes | None] = ()) -> None:
        """Store the rows of samples that are done, and their recordings as Parquet files."""
        digits = len(str(self._provenance["samples"] - 1))
        for row, recording in zip(rows, recordings, strict=False):
            if recording:
                number = f"{row[table.SAMPLE]:0{digits}}"
                write_bytes_atomically(self.recordings / f"sample-{number}.parquet", recording)
        lines = "".join(f"\n{json.dumps(row)}" for row in rows)  # which ends a line that was cut off
        with self._log.open("a", encoding="utf-8") as log:
            log.write(lines)

    def finish(self) -> None:
        """Write the table; SweepError if samples are missing."""
        if not self.path.is_file():
            positions = self._positions()
            if (positions < 0).any():
                self._checked(np.flatnonzero(positions >= 0).tolist(), self._log)
            table.write(self._rows_at(positions), self._columns, self.path)
        self._log.unlink(missing_ok=True)

    def _checked(self, samples: Iterable[int], path: Path) -> set[int]:
        """The samples; SweepError unless they are all, each once."""
        numbers, count = sorted(samples), self._provenance["samples"]
        if numbers != list(range(count)):
            raise SweepError(
                f"{path}: {len(numbers)} rows of {len(set(numbers))} samples, expected {count}; {_DISCARD}"
            )
        return set(numbers)

    def _positions(self) -> np.ndarray:
        """Where the line of each sample begins in the log, shape (samples,).

        -1 for one that was not run, as which that of a damaged line counts.
        """
        positions, position = np.full(self._provenance["samples"], -1, np.int64), 0
        with self._log.open("rb") as log:
            for line in log:
                row = _read_line(line)
                if (
                    position
                    and row.keys() >= {table.SAMPLE, table.ERROR}
                    and row[table.SAMPLE] < len(positions)
                ):
                    positions[row[table.SAMPLE]] = position
                position += len(line)
        return positions

    def _rows_at(self, positions: np.ndarray) -> Iterator[dict[str, Any]]:
        with self._log.open("rb") as log:
            for position in positions:
                log.seek(position)
                yield _read_line(log.readline())


def _read_line(line: bytes) -> dict[str, Any]:
    """The table in a line of the log, empty where it is damaged."""
    with suppress(ValueError):
        content = json.loads(line)
        return content if isinstance(content, dict) else {}
    return {}


def _identity(key: str, value: Any) -> Any:
    """The paths of FMUs, and how the command was written, make no difference; hashes are compared."""
    if key == "arguments":
        return None
    if key == "scenario" and isinstance(value, dict):
        return {**value, "components": sorted(value["components"])}
    return value
