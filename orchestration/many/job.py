"""Runs to make and runs that were made, what they share, and the batches in which they are handed out."""

import math
import os
import pickle
import re
from collections import deque
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import islice
from pathlib import Path
from tempfile import gettempdir
from typing import Any, NamedTuple, Protocol

import cloudpickle

from orchestration.errors import OrchestrationError
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

Changes = tuple[Mapping[str, Any], Mapping[str, Mapping[str, Any]]]
"""Field of an experiment -> its value; and field of `ENTRIES` -> name -> value of the entries that differ."""
ENTRIES = ("parameters", "inputs", "signals")

BATCH_S = 0.25
"""Time [s] after which a batch of runs ends, whatever is left of it."""
_MOST_OF_A_BATCH = 1000
_SPREAD = 3  # of what is left for a worker it takes this part, so that all end at about the same time

Reduce = Callable[[Recording], Sequence[Any]]
"""Returns a result for each run of a recording with an axis of runs; a function of a module, or picklable."""

ENDED, TOO_LONG = "ended", "too long"
"""Causes of a failure: the process of the run ended, or was ended because the run took too long."""


class Run(NamedTuple):
    """A run to make: what its caller knows it by, its experiment, and what its result is computed with."""

    key: Any
    experiment: Experiment
    reduce: Reduce


class Done(NamedTuple):
    """A run that is done.

    result: of `reduce`, or a `Failure`; warned: the components whose FMUs returned warnings
    seconds: processor time of the run, not a number if others ran beside it
    """

    result: Any
    warned: tuple[str, ...] = ()
    seconds: float = math.nan


@dataclass(frozen=True)
class Failure:
    """A run without a result.

    Parameters
    ----------
    reason : str
        Why the result is missing, in one line.
    cause : str
        "ended" if the process of the run ended, "too long" if it was ended after the timeout, else "".
    """

    reason: str
    cause: str = ""


class Finished(NamedTuple):
    """A run that was made."""

    key: Any
    done: Done


class ClosedError(OrchestrationError):
    """A runner was closed during a run, which another runner has to make."""


@dataclass(frozen=True)
class Job:
    """The data that all runs of one system share, wherever they are made.

    fmus: file name -> content, where the system's components are such file names
    base: an experiment like the runs' own, which are sent as their differences from it
    timeout: longest time [s] of a run, None for ever
    not_in_vectors: why the runs cannot step together in vectors, empty if nothing is known against it
    """

    system: System
    base: Experiment
    timeout: float | None = None
    not_in_vectors: str = ""
    fmus: Mapping[str, bytes] = field(default_factory=dict)

    def with_packed_fmus(self) -> "Job":
        """Returns the job for another machine: its FMUs go with it."""
        components = self.system.components
        files = {name: Path(name, path.name) for name, path in components.items()}
        fmus = {files[name].as_posix(): path.read_bytes() for name, path in components.items()}
        return replace(self, fmus=fmus, system=replace(self.system, components=files))

    def with_unpacked_fmus(self, folder: Path) -> "Job":
        """Returns the job with its FMUs as files in a folder."""
        for name, content in self.fmus.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        components = {name: folder / path for name, path in self.system.components.items()}
        return replace(self, fmus={}, system=replace(self.system, components=components))

    def is_like(self, other: "Job") -> bool:
        """Whether the runs of one may be made with what is loaded for the other."""
        same = (self.system, self.timeout, self.not_in_vectors)
        return same == (other.system, other.timeout, other.not_in_vectors)

    def pickled(self, runs: Sequence[Run]) -> bytes:
        """Returns runs without their keys, for a process that has this job."""
        return cloudpickle.dumps([(differences(self.base, run.experiment), run.reduce) for run in runs])

    def unpickled(self, content: bytes) -> list[Run]:
        """Returns the runs, each with its number as the key: the inverse of `pickled`."""
        runs = enumerate(pickle.loads(content))
        return [Run(i, changed(self.base, changes), reduce) for i, (changes, reduce) in runs]

    def error_line(self, error: Exception) -> str:
        """Returns an error as one line that does not depend on where this process keeps its files."""
        text = str(error) if isinstance(error, OrchestrationError) else f"{type(error).__name__}: {error}"
        for path in self.system.components.values():
            text = text.replace(f"{path.parent}{os.sep}", "")
        text = re.sub(rf"{re.escape(gettempdir())}/[^/\s]+/", "", text)  # of what was unpacked
        return " ".join(text.split())


def differences(base: Experiment, experiment: Experiment) -> Changes:
    """Returns what differs from the base: fields and entries that are other objects."""
    whole, entries = dict[str, Any](), dict[str, Mapping[str, Any]]()
    for one in fields(Experiment):
        old, new = getattr(base, one.name), getattr(experiment, one.name)
        if one.name in ENTRIES and new.keys() == old.keys():
            entries[one.name] = {name: value for name, value in new.items() if value is not old[name]}
        elif new is not old:
            whole[one.name] = new
    return whole, {name: values for name, values in entries.items() if values}


def changed(base: Experiment, changes: Changes) -> Experiment:
    """Returns the experiment that differs from the base so: the inverse of `differences`."""
    whole, entries = changes
    merged = {name: {**getattr(base, name), **values} for name, values in entries.items()}
    return replace(base, **whole, **merged)


class Place(Protocol):
    """Makes the runs of one job after another; a generator that is closed early stops them."""

    def runs(self, job: Job, batches: "Batches") -> Generator[list[Finished], None, None]: ...


class Batches:
    """Runs to hand out, as many at once as take about a quarter of a second."""

    def __init__(self, runs: Iterable[Run], count: int) -> None:
        self._runs, self.left, self._run_s = iter(runs), count, math.inf
        self._returned: deque[Run] = deque()

    def take(self, workers: int, group: int = 1, most: int = _MOST_OF_A_BATCH) -> list[Run]:
        """Returns the next runs for one of so many workers; none if none are left.

        group: how many run at once: batches are whole groups, until the last; most: of a batch
        """
        share = math.ceil(self.left / (_SPREAD * workers))
        count = max(1, min(int(BATCH_S / self._run_s), share, most))
        count = max(group, count - count % group)
        batch = [self._returned.popleft() for _ in range(min(count, len(self._returned)))]
        batch += islice(self._runs, count - len(batch))
        self.left -= len(batch)
        return batch

    def note(self, count: int, seconds: float, rest: Sequence[Run] = ()) -> None:
        """Notes how long so many runs took, one after another; rest: of their batch, to hand out again."""
        self._run_s = max(seconds / count, 1e-9)
        self._returned += rest
        self.left += len(rest)
