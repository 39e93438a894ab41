"""What a run leaves behind: signals with units at the communication points, and where they came from.

pandas and xarray are imported where they are needed: who uses neither does not wait for them.
"""

import json
import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, TextIO

import numpy as np

from fmus.errors import nearest
from orchestration.errors import OrchestrationError
from orchestration.results import recording_summary

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

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
        return self.time if name == TIME else self.values[:, self._column(name)]

    def _column(self, name: str) -> int:
        try:
            return self.names.index(name)
        except ValueError:
            raise OrchestrationError(f"{name!r} was not recorded; {nearest(str(name), self.names)}") from None

    def unit(self, name: str) -> str:
        return "s" if name == TIME else self.units[self._column(name)]

    def __repr__(self) -> str:
        return recording_summary.as_text(self)

    def _repr_html_(self) -> str:
        """What a notebook shows."""
        return recording_summary.as_html(self)

    def to_pandas(self) -> "pd.DataFrame":
        """A column a signal over the time [s]; `attrs` holds "units" (name -> unit) and "provenance"."""
        import pandas as pd

        table = pd.DataFrame(
            self.values, index=pd.Index(self.time, name=TIME), columns=list(self.names), copy=True
        )
        units = dict(zip(self.names, self.units, strict=True))
        table.attrs = {"units": units, "provenance": self.provenance}
        return table

    def to_xarray(self) -> "xr.Dataset":
        """A variable a signal over the coordinate time; attributes "units", and "provenance" as JSON."""
        import xarray as xr

        columns = zip(self.names, self.units, self.values.T, strict=True)
        return xr.Dataset(
            {name: (TIME, values.copy(), {"units": unit}) for name, unit, values in columns},
            coords={TIME: (TIME, self.time.copy(), {"units": "s"})},
            attrs={"provenance": json.dumps(self.provenance)},
        )

    def write(self, path: str | Path) -> None:
        """One row per communication point, as .csv or as .parquet; floats survive exactly in both.

        OrchestrationError for another ending.
        """
        from orchestration.results import recording_files

        recording_files.write(self, Path(path))

    @staticmethod
    def read(path: str | Path) -> "Recording":
        """The inverse of `write`; CSV does not keep the provenance.

        OrchestrationError for a file that is none of these, or is damaged.
        """
        from orchestration.results import recording_files

        return recording_files.read(Path(path))


def write_json(content: Any, path: Path) -> None:
    """Plain data as JSON; ValueError for a number that JSON does not have."""
    write_whole(path, lambda stream: json.dump(content, stream, indent=2, allow_nan=False))


def write_whole(path: Path, write: Callable[[TextIO], object]) -> None:
    """Call `write` on a text stream that becomes `path` only when it is complete."""
    with _whole(path) as handle, os.fdopen(handle, "w", encoding="utf-8", newline="") as stream:
        write(stream)


def write_whole_binary(path: Path, write: Callable[[BinaryIO], object]) -> None:
    """Call `write` on a stream of bytes that becomes `path` only when it is complete."""
    with _whole(path) as handle, os.fdopen(handle, "wb") as stream:
        write(stream)


@contextmanager
def _whole(path: Path) -> Iterator[int]:
    """A handle to a file beside `path` that takes its place, or of which nothing is left."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        yield handle
        Path(temporary).chmod(0o644)
        Path(temporary).replace(path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise
