"""The process in which the FMUs of a run with a timeout are loaded and run.

The record and the report of the loop are files that both processes map: the values recorded until a crash
are there after it.
"""

import _thread
import math
import os
import pickle
import tempfile
import threading
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cloudpickle
import numpy as np

from fmus.fmi.process import Parent
from orchestration.errors import OrchestrationError
from orchestration.results.recording import Recording
from orchestration.run.interrupt import kept_interrupts
from orchestration.run.loop_data import Report, Storage
from orchestration.run.simulator import Simulator
from orchestration.system.prepared_run import PreparedRun
from orchestration.system.system import System

STOP = "stop"  # the message that asks the run to stop, as an interrupt does

Outcome = Recording | BaseException


@dataclass(frozen=True)
class Task:
    """A run to make; options: of `Simulator.run`"""

    system: System
    prepared: PreparedRun
    options: Mapping[str, Any]


class Warned(NamedTuple):
    """A warning that was issued in the process."""

    message: str
    category: type[Warning]
    filename: str
    lineno: int


class SharedRecord:
    """The storage of a run as files in a folder; on Windows they can be removed after `close` alone.

    So nobody else may keep its arrays.
    """

    def __init__(self, folder: Path, shape: tuple[int, int], is_new: bool) -> None:
        rows = _mapped(folder / "rows", np.float64, shape, is_new)
        self.storage = Storage(rows, _mapped(folder / "report", np.int64, (len(Report),), is_new))

    def close(self) -> None:
        del self.storage


def _mapped(path: Path, kind: type[np.generic], shape: tuple[int, ...], is_new: bool) -> np.ndarray:
    """Returns a file as an array; OrchestrationError without room for it, which mapping would not tell."""
    if is_new:
        size = max(math.prod(shape) * np.dtype(kind).itemsize, 1)
        try:
            with path.open("wb") as stream:
                if hasattr(os, "posix_fallocate"):
                    os.posix_fallocate(stream.fileno(), 0, size)
                else:
                    stream.truncate(size)
        except OSError as error:
            raise OrchestrationError(
                f"{path.parent}: no room for a record of {size / 1e6:.3g} MB, as a run with a timeout needs: "
                f"{error.strerror}; expected another folder in TMPDIR, fewer recorded variables or no timeout"
            ) from error
    return np.asarray(np.memmap(path, kind, "r+", shape=shape))


def run_task(parent: Parent) -> None:
    """Receives a pickled Task; sends a Warned for each warning, then the Outcome."""
    with kept_interrupts():  # also those that come while the run is prepared end it
        try:
            outcome: Outcome = _run(parent, Path(tempfile.gettempdir()))
        except BaseException as error:  # whatever it is, it is for the other process
            error.add_note("".join(traceback.format_exception(error)))
            outcome = error
        parent.send(outcome, _packed)


def _stop_when_asked(parent: Parent) -> None:
    if parent.receive() == STOP:
        _thread.interrupt_main()


def _run(parent: Parent, folder: Path) -> Recording:
    try:
        task: Task = pickle.loads(parent.receive())
    except Exception as error:
        raise OrchestrationError(
            f"what is to be run cannot be loaded in a process of its own: {type(error).__name__}: {error}; "
            "expected signals that can be imported, or no timeout"
        ) from error
    threading.Thread(target=_stop_when_asked, args=(parent,), daemon=True).start()
    storage = SharedRecord(folder, task.prepared.shape, is_new=False).storage
    storage.report[Report.RECORDED] = 0
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, category, filename, lineno, *_: parent.send(
            Warned(str(message), category, filename, lineno), cloudpickle.dumps
        )
        with Simulator(task.system) as simulator:
            return simulator.run(task.prepared, storage=storage, **task.options)


def _packed(outcome: object) -> bytes:
    if isinstance(outcome, Recording | OrchestrationError):
        return pickle.dumps(outcome)
    try:
        content = cloudpickle.dumps(outcome)
        pickle.loads(content)
    except Exception:  # of an error that does not travel: what it says does
        return pickle.dumps(OrchestrationError(f"{type(outcome).__name__}: {outcome}"))
    return content
