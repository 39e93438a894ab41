"""Where a sweep keeps its results: parts while it runs, so that nothing done is lost; one table at the end.

NAME.sweep/          what is run (sweep.json) and the rows that are done, a file a batch; gone at the end
NAME.recordings/     recordings of the samples, if they were asked for
NAME.sweep.parquet   the table
"""

import json
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from fmus.extras import imports_of
from fmus.files import write_bytes_atomically, write_json_atomically
from orchestration.errors import SweepError
from orchestration.sweep import table

with imports_of("sweep", "a sweep"):
    import pyarrow as pa
    import pyarrow.parquet as pq


class Store:
    """The files of one sweep.

    provenance: of the sweep; SweepError if the files are those of another one
    """

    def __init__(self, folder: Path, columns: pa.Schema, provenance: Mapping[str, Any]) -> None:
        name = provenance["name"]
        self.path = folder / f"{name}.sweep.parquet"
        self.recordings = folder / f"{name}.recordings"
        self._parts, self._manifest = folder / f"{name}.sweep", folder / f"{name}.sweep" / "sweep.json"
        self._columns, self._provenance = columns, provenance

    @property
    def complete(self) -> bool:
        return self.path.is_file()

    def discard(self) -> None:
        """Remove what an earlier sweep of that name has left."""
        self.path.unlink(missing_ok=True)
        for folder in (self._parts, self.recordings):
            shutil.rmtree(folder, ignore_errors=True)

    def begin(self) -> set[int]:
        """The samples that are done already."""
        if self.complete:
            _, stored = table.read(self.path)
            self._check_same(stored, self.path)
            return set(range(self._provenance["samples"]))
        if self._manifest.is_file():
            self._check_same(json.loads(self._manifest.read_text(encoding="utf-8")), self._parts)
            return {row[table.SAMPLE] for row in self._rows([table.SAMPLE])}
        write_json_atomically(self._manifest, self._provenance)
        return set()

    def _check_same(self, stored: Mapping[str, Any], path: Path) -> None:
        """Rows of two sweeps must not be mixed."""
        ours = json.loads(json.dumps(self._provenance))
        differing = [key for key in ours if _identity(key, ours[key]) != _identity(key, stored.get(key))]
        if differing:
            raise SweepError(
                f"{path} is of another sweep ({', '.join(differing)} differ): expected the same to go on; "
                "--restart discards it"
            )

    def add(self, rows: list[dict[str, Any]], recordings: Mapping[int, bytes]) -> None:
        """Store rows that are done, with the recordings of their samples."""
        for sample, content in recordings.items():
            number = f"{sample:0{len(str(self._provenance['samples'] - 1))}}"
            write_bytes_atomically(self.recordings / f"sample-{number}.parquet", content)
        numbers = [row[table.SAMPLE] for row in rows]
        table.write(rows, self._columns, self._parts / f"{min(numbers)}-{max(numbers)}.parquet")

    def finish(self) -> None:
        """Make the parts one table."""
        if self.complete:
            return
        table.write(self._rows(), table.with_provenance(self._columns, self._provenance), self.path)
        shutil.rmtree(self._parts)

    def _rows(self, columns: list[str] | None = None) -> Iterable[dict[str, Any]]:
        for part in sorted(self._parts.glob("[0-9]*.parquet")):
            yield from pq.read_table(part, columns=columns).to_pylist()


def _identity(key: str, value: Any) -> Any:
    """The paths of FMUs make no difference; their hashes are compared."""
    if key == "scenario" and isinstance(value, dict):
        return {**value, "components": sorted(value["components"])}
    return value
