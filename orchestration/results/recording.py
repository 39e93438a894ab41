"""Recordings: signals of one run or of many at the communication points, with units and provenance."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Concatenate, ParamSpec

import numpy as np

from fmus.extras import require
from orchestration.errors import OrchestrationError
from orchestration.results import files

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from orchestration.results.figures import ShownFigure

P = ParamSpec("P")
TIME = files.TIME


@dataclass(frozen=True)
class Recording(files.Columns):
    """A recording: signals over time, of one run or of many runs with the same communication points.

    Attributes
    ----------
    names
        "component.variable" of each signal.
    units
        In the same order, "" if the FMU gives none.
    time
        Communication points [s], shape (n,).
    values
        Shape (n, len(names)); of many runs (runs, n, len(names)), also as an array on a GPU.
    provenance
        FMUs, algorithm and settings of the run, as plain data.
    strings
        String -> the strings that it can have; its column of `values` has their indices.

    Examples
    --------
    >>> import numpy as np
    >>> time = np.array([0.0, 1.0])
    >>> recording = Recording(("plant.depth",), ("m",), time, np.array([[0.0], [0.5]]))
    >>> float(recording["plant.depth"].max())
    0.5
    >>> recording.unit("plant.depth")
    'm'
    """

    def __contains__(self, name: object) -> bool:
        """Whether a signal was recorded; true for the time."""
        return name == TIME or name in self.names

    def __iter__(self) -> Iterator[str]:
        """Iterates over the names of the signals."""
        return iter(self.names)

    def __len__(self) -> int:
        """Returns the number of signals; `len(recording.time)` is the number of communication points."""
        return len(self.names)

    def keys(self) -> tuple[str, ...]:
        """Returns the names of the signals.

        Returns
        -------
        tuple of str
        """
        return self.names

    @property
    def run_count(self) -> int | None:
        """Number of runs; None for the recording of a single one."""
        return self.values.shape[0] if self.values.ndim == 3 else None

    def run(self, index: int) -> "Recording":
        """Returns the recording of one of many runs.

        Parameters
        ----------
        index : int
            Number of the run, from 0.

        Returns
        -------
        Recording
        """
        return replace(self, values=on_host(self.values[index]))

    def __repr__(self) -> str:
        return _as_text(self.units, self.time, {name: self[name] for name in self.names})

    def _repr_html_(self) -> str:
        # only notebooks need them
        from base64 import b64encode
        from html import escape

        text = f"<pre>{escape(repr(self))}</pre>"
        if self.run_count is not None or not self.numbers or len(self.time) < 2:
            return text
        figure: Any = self.plot(*self.numbers[:_MOST_DRAWN])
        return (
            f'{text}<img width="480" src="data:image/png;base64,{b64encode(figure._repr_png_()).decode()}">'
        )

    def plot(self, *names: str, beside: "Recording | Mapping[str, Recording] | None" = None) -> "ShownFigure":
        """Returns a Matplotlib figure of signals over time; a notebook shows it, `savefig` writes it.

        Parameters
        ----------
        *names : str
            Signals, by default all that are numbers. A panel has at most four, of one unit.
        beside : Recording or mapping, optional
            Another recording, or several by their labels in the legend, drawn over this one with other
            dashes. A signal that is missing there, or equal, is drawn once.

        Returns
        -------
        matplotlib.figure.Figure

        Raises
        ------
        OrchestrationError
            For a signal that was not recorded, a String, a signal that has another unit in `beside`, and a
            recording of many runs, of which `run(i)` is one.

        Examples
        --------
        >>> import numpy as np
        >>> time = np.linspace(0.0, 1.0, 11)
        >>> fast, slow = (Recording(("a.depth",), ("m",), time, f * time[:, None]) for f in (1.0, 0.5))
        >>> figure = fast.plot("a.depth", beside={"half as fast": slow})
        >>> figure.axes[0].get_ylabel()
        'Depth [m]'
        """
        others = {"beside": beside} if isinstance(beside, Recording) else beside or {}
        for recording in (self, *others.values()):
            if recording.run_count is not None:
                raise OrchestrationError(
                    f"a recording of {recording.run_count} runs: expected one, such as run(0)"
                )
        for name in names:
            self._column(name)
            if name in self.strings:
                raise OrchestrationError(f"{name} is a String: expected numbers to plot")
        for label, other in others.items():
            for name in names or self.names:
                if name in other.names and other.unit(name) != self.unit(name):
                    units = f"expected {self.unit(name)!r}, got {other.unit(name)!r}"
                    raise OrchestrationError(f"unit of {name} in {label!r}: {units}")

        # Matplotlib takes longer to import than a run
        from orchestration.results.figures import figure_of

        return figure_of(self, names, others)

    def to_pandas(self) -> "pd.DataFrame":
        """Returns a table with a column for each signal and the time [s] as index.

        It needs the extra `tables`.

        Returns
        -------
        pandas.DataFrame
            Its `attrs` have "units" (name -> unit) and "provenance".
        """
        pandas = require("pandas", "tables", "a recording as a data frame")
        table = pandas.DataFrame(
            self.values, index=pandas.Index(self.time, name=TIME), columns=list(self.names), copy=True
        )
        for name in self.strings:
            table[name] = self[name]
        units = dict(zip(self.names, self.units, strict=True))
        table.attrs = {"units": units, "provenance": self.provenance}
        return table

    def to_xarray(self) -> "xr.Dataset":
        """Returns a data set with a variable for each signal over the coordinate "time" [s].

        It needs the extra `tables`.

        Returns
        -------
        xarray.Dataset
            Each variable has the attribute "units", the data set has "provenance" as JSON.
        """
        xarray = require("xarray", "tables", "a recording as a data set")
        columns = zip(self.names, self.units, strict=True)
        return xarray.Dataset(
            {name: (TIME, self[name].copy(), {"units": unit}) for name, unit in columns},
            coords={TIME: (TIME, self.time.copy(), {"units": "s"})},
            attrs={"provenance": json.dumps(self.provenance)},
        )

    def write(self, path: str | Path) -> None:
        """Writes a row for each communication point; floats survive exactly.

        Parameters
        ----------
        path : str or Path
            Ends in .csv, or in .parquet for a file with the provenance.

        Raises
        ------
        OrchestrationError
            For another ending.
        """
        files.write(Path(path), self)

    @staticmethod
    def read(path: str | Path) -> "Recording":
        """Reads a file of `write`; a recording from CSV has no provenance.

        Parameters
        ----------
        path : str or Path
            The file.

        Returns
        -------
        Recording

        Raises
        ------
        OrchestrationError
            For a file that does not exist, is not a recording, or is damaged.
        """
        return Recording(**vars(files.read(Path(path))))


def on_host(values: Any) -> np.ndarray:
    """Returns the same array of NumPy, or a copy of an array on a GPU."""
    return values.get() if hasattr(values, "get") else values


def along_time(
    function: Callable[Concatenate[Recording, P], Any],
) -> Callable[Concatenate[Recording, P], Any]:
    """Decorates a metric that computes along the last axis of signals: a float, or shape (runs,).

    The metric computes where the signals are, also on a GPU: it uses functions of NumPy, and creates arrays
    with `like`.
    """

    @wraps(function)
    def metric(recording: Recording, /, *arguments: P.args, **named: P.kwargs) -> Any:
        value = function(recording, *arguments, **named)
        return float(value) if recording.run_count is None else on_host(value)

    return metric


def run_by_run(
    function: Callable[Concatenate[Recording, P], float],
) -> Callable[Concatenate[Recording, P], Any]:
    """Decorates a metric of one run; for many runs it returns one value each, shape (runs,)."""

    @wraps(function)
    def metric(recording: Recording, /, *arguments: P.args, **named: P.kwargs) -> Any:
        if recording.run_count is None:
            return function(recording, *arguments, **named)
        runs = map(recording.run, range(recording.run_count))
        return np.array([function(run, *arguments, **named) for run in runs])

    return metric


_MOST, _MOST_DRAWN = 30, 6  # signals shown in the text and in the picture of a notebook
_HEADINGS = ("signal", "unit", "least", "largest", "last")


def _as_text(units: Sequence[str], time: np.ndarray, signals: Mapping[str, np.ndarray]) -> str:
    """Returns a heading and a line for each signal, for a Python prompt or a notebook.

    signals: by name; units: in the same order
    """
    names = list(signals)
    # a number stands for two signals or more: one alone is shown in its line
    shown = _MOST if len(names) > _MOST + 1 else len(names)
    columns = zip(names[:shown], units[:shown], strict=True)
    rows = [_HEADINGS, *((name, unit, *_numbers(signals[name])) for name, unit in columns)]
    widths = [max(map(len, cells)) for cells in zip(*rows, strict=True)]
    lines = ["  ".join(map(str.ljust, row, widths)).rstrip() for row in rows]
    span = f", {time[0]:g}..{time[-1]:g} s" if len(time) else ""
    heading = f"Recording of {_count(len(names), 'signal')} at {_count(len(time), 'point')}{span}"
    rest = [f"and {len(names) - shown} more signals"] if shown < len(names) else []
    return "\n".join([heading, *(f"  {line}" for line in lines), *rest])


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'s' * (number != 1)}"


def _numbers(values: np.ndarray) -> tuple[str, ...]:
    """Returns the least, the largest and the last value; NaN spreads to the first two."""
    if not len(values):
        return "", "", ""
    if values.dtype == object:  # a String
        return "", "", str(values[-1])
    return tuple(f"{value:.6g}" for value in (values.min(), values.max(), values[-1]))
