"""The process in which the FMUs of a run with a timeout are: it runs FOLDER/task and leaves FOLDER/outcome.

FOLDER is where its temporary files go. The record and the report of the loop are files that both processes
map: what was recorded is there however the run ended. A byte on standard input asks the run to stop, as an
interrupt does; at the end of standard input the process ends at once.
"""

import _thread
import os
import pickle
import sys
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import cloudpickle
import numpy as np

from fmus.files import write_bytes_atomically
from fmus.process import private_stream
from orchestration.errors import OrchestrationError
from orchestration.master.interrupt import kept_interrupts
from orchestration.master.loop import RECORDED, REPORT_SIZE, Storage
from orchestration.master.simulator import Simulator
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.system import System

TASK, OUTCOME, WARNINGS = "task", "outcome", "warnings"  # files
_INSIST_S = 0.1  # until the next interrupt: one that comes while the run is prepared changes nothing


@dataclass(frozen=True)
class Task:
    """options: of `Simulator.run`; shape: of its record"""

    system: System
    experiment: Experiment
    options: Mapping[str, Any]
    shape: tuple[int, int]


class SharedRecord:
    """The storage of a run as files in a folder; on Windows they can be removed after `close` alone.

    So nobody else may keep its arrays.
    """

    def __init__(self, folder: Path, shape: tuple[int, int], mode: Any) -> None:
        rows = np.memmap(folder / "rows", float, mode, shape=shape)
        report = np.memmap(folder / "report", np.int64, mode, shape=(REPORT_SIZE,))
        self.storage = Storage(np.asarray(rows), np.asarray(report))

    def close(self) -> None:
        del self.storage


def child() -> None:
    """What the process does."""
    stream = private_stream(sys.stdin.fileno(), "rb")
    threading.Thread(target=_listen, args=(stream,), daemon=True).start()
    folder = Path(tempfile.gettempdir())
    with kept_interrupts():  # the run itself looks at those that come while it goes on
        try:
            outcome: Recording | BaseException = _run(folder)
        except BaseException as error:  # whatever it is, it is for the other process
            error.add_note("".join(traceback.format_exception(error)))
            outcome = error
        content = _packed(outcome)
        write_bytes_atomically(folder / OUTCOME, content)


def _listen(stream: BinaryIO) -> None:
    if stream.read(1):
        threading.Thread(target=_insist, daemon=True).start()
        stream.read(1)
    os._exit(1)


def _insist() -> None:
    while True:
        _thread.interrupt_main()
        time.sleep(_INSIST_S)


def _run(folder: Path) -> Recording:
    try:
        task: Task = pickle.loads((folder / TASK).read_bytes())
    except Exception as error:
        raise OrchestrationError(
            f"what is to be run cannot be loaded in a process of its own: {type(error).__name__}: {error}; "
            "expected signals that can be imported, or no timeout"
        ) from error
    storage = SharedRecord(folder, task.shape, "r+").storage
    storage.report[RECORDED] = 0
    with (folder / WARNINGS).open("wb", buffering=0) as heard, warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = lambda message, category, filename, lineno, *_: heard.write(
            cloudpickle.dumps((str(message), category, filename, lineno))
        )
        with Simulator(task.system) as simulator:
            return simulator.run(task.experiment, storage=storage, **task.options)


def _packed(outcome: Recording | BaseException) -> bytes:
    if isinstance(outcome, Recording | OrchestrationError):
        return pickle.dumps(outcome)
    try:
        content = cloudpickle.dumps(outcome)
        pickle.loads(content)
    except Exception:  # of an error that does not travel: what it says does
        return pickle.dumps(OrchestrationError(f"{type(outcome).__name__}: {outcome}"))
    return content
