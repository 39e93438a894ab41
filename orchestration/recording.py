"""What a run leaves behind: signals with units at the communication points, and where they came from."""

import csv
import json
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from fmus.errors import nearest
from orchestration.errors import OrchestrationError

TIME = "time"


@dataclass(frozen=True)
class Recording:
    """Signals over time.

    names: "component.variable"; units: same order, "" where the FMU gives none
    time: shape (n,) [s]; values: shape (n, len(names))
    provenance: what was run, as plain data
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    time: np.ndarray
    values: np.ndarray
    provenance: dict[str, Any] = field(default_factory=dict)

    def __getitem__(self, name: str) -> np.ndarray:
        """One signal, shape (n,); an unknown name offers the nearest."""
        if name == TIME:
            return self.time
        try:
            return self.values[:, self.names.index(name)]
        except ValueError:
            raise OrchestrationError(f"{name!r} was not recorded; {nearest(str(name), self.names)}") from None

    def unit(self, name: str) -> str:
        return "s" if name == TIME else self.units[self.names.index(name)]

    def write_csv(self, path: Path) -> None:
        """One row per communication point, headed "name [unit]"; floats survive exactly."""
        header = ["time [s]"]
        header += [f"{n} [{u}]" if u else n for n, u in zip(self.names, self.units, strict=True)]

        def write(stream: TextIO) -> None:
            rows = csv.writer(stream, lineterminator="\n")
            rows.writerow(header)
            rows.writerows(np.column_stack([self.time, self.values]).tolist())

        write_whole(path, write)


def read_csv(path: Path) -> Recording:
    """The inverse of `write_csv`, without the provenance."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = csv.reader(stream)
        titles = [title.partition(" [") for title in next(rows)]
        data = np.array([[float(cell) for cell in row] for row in rows]).reshape(-1, len(titles))
    return Recording(
        names=tuple(name for name, _, _ in titles[1:]),
        units=tuple(unit.rstrip("]") for _, _, unit in titles[1:]),
        time=data[:, 0],
        values=data[:, 1:],
    )


def write_json(content: Any, path: Path) -> None:
    """Plain data as JSON; ValueError for a number that JSON does not have."""
    write_whole(path, lambda stream: json.dump(content, stream, indent=2, allow_nan=False))


def write_whole(path: Path, write: Callable[[TextIO], object]) -> None:
    """Call `write` on a text stream that becomes `path` only when it is complete."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
            write(stream)
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
