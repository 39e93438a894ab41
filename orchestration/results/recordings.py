"""The signals of many runs, for functions that compute a number of each run at once."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from typing import Any, Concatenate, ParamSpec

import numpy as np

from orchestration.results.recording import Recording

P = ParamSpec("P")
OF_ALL: set[Callable[..., Any]] = set()
"""The functions that take `Recordings`."""


@dataclass(frozen=True, eq=False)
class Recordings:
    """Signals of many runs over the same time.

    first: the recording of one run; names, units, time and provenance are those of all
    values: shape (signals, runs, n), in C order, so that a sum along n rounds as that of one run
    """

    first: Recording
    values: np.ndarray

    def __len__(self) -> int:
        """Number of runs."""
        return self.values.shape[1]

    @property
    def time(self) -> np.ndarray:
        """Communication points [s], shape (n,)."""
        return self.first.time

    def __getitem__(self, name: str) -> np.ndarray:
        """A signal of every run, shape (runs, n); ValueError for one that was not recorded."""
        return self.values[self.first.names.index(name)]

    def run(self, index: int) -> Recording:
        """The recording of one run."""
        return replace(self.first, values=self.values[:, index].T)


Runs = Recording | Recordings


def of_all(function: Callable[Concatenate[Any, P], Any]) -> Callable[Concatenate[Runs, P], float]:
    """A metric that computes along the last axis of signals: a float of one run.

    Of `Recordings` it is an array, shape (runs,), though its type is that of one run.
    """

    @wraps(function)
    def of_one_or_all(recording: Runs, /, *arguments: P.args, **named: P.kwargs) -> Any:
        value = function(recording, *arguments, **named)
        return value if isinstance(recording, Recordings) else float(value)

    OF_ALL.add(of_one_or_all)
    return of_one_or_all
