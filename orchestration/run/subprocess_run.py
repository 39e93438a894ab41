"""A run in another process: an FMU that hangs or crashes there takes nothing else with it.

The record and the report of the loop are files that both processes map: the values recorded until a crash
are there after it.
"""

import _thread
import contextlib
import math
import pickle
import tempfile
import threading
import time
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cloudpickle
import numpy as np

from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess
from fmus.operating_system import allocate
from orchestration.errors import FmuWarning, OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run.error_estimate import with_error_estimate
from orchestration.run.loop_data import Report, Storage
from orchestration.run.process_guard import kept_interrupts
from orchestration.run.run import Progress
from orchestration.run.run_recording import make_recording, reason_of
from orchestration.run.simulator import Simulator
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import System

_LOOK_S = 0.1
# At least, for an FMU to be loaded: it may start an interpreter, or look for a license.
_LOADING_S = 60.0
# An interrupt so soon after another is the same one, passed on by a shell for instance.
_AGAIN_S = 1.0
_NOT_BEGUN = -1
_STOP = "stop"  # the message that asks the run to stop, as an interrupt does

Outcome = Recording | BaseException


def simulate_in_subprocess(
    system: System,
    prepared: PreparedRun,
    timeout: float,
    progress: Progress | None = None,
    options: Mapping[str, Any] | None = None,
) -> Recording:
    """Calls `Simulator.run` with these options in another process.

    timeout: longest time [s] that a call of an FMU may take; to load one may take a minute
    Raises SimulationError when that is over, and when the process dies. An interrupt stops the run as it does
    without timeout; a second one ends the process.
    """
    if not timeout > 0.0:
        raise SystemDefinitionError(f"timeout {timeout!r} s: expected more than 0")
    experiment = prepared.experiment
    # the second run of an error estimate gets another process, below
    alone = replace(prepared, experiment=replace(experiment, error_estimate=False))
    task = _packed_task(system, alone, dict(options or {}))
    with (
        contextlib.closing(WorkerProcess(run_task)) as process,
        contextlib.closing(SharedRecord(process.folder, prepared.shape, is_new=True)) as record,
    ):
        record.storage.report[Report.RECORDED] = _NOT_BEGUN
        process.send(task)
        watch = _Watch(process, record, timeout, progress)
        problem = watch.until_the_end()
        process.kill()
        outcome = _failure(problem, prepared, record) if watch.outcome is None else watch.outcome
        if problem and watch.outcome is not None:
            # after the run no call is in progress: the process ended outside of the FMUs' functions
            who = _busy(prepared, record).replace("the run", "an FMU")
            text = f"{who} after the run: {problem}; the recording is not affected"
            watch.warnings.append(Warned(text, FmuWarning, __file__, 0))
    outcome, stopped = _with_warnings(watch.warnings, outcome), watch.stopped
    if stopped is None and isinstance(outcome, Recording):
        stopped = _call_progress(progress, len(outcome.time) - 1, len(outcome.time) - 1)
    recording = _unwrapped(outcome, stopped)
    if experiment.error_estimate:

        def second(coarser: Experiment) -> Recording:
            return simulate_in_subprocess(system, prepare(system, coarser), timeout)

        return with_error_estimate(recording, prepared, second)
    return recording


def _packed_task(system: System, prepared: PreparedRun, options: Mapping[str, Any]) -> bytes:
    """Returns what is run, pickled; OrchestrationError for what cannot be given to another process."""
    content, task = b"", (system, prepared, options)
    given = prepared.experiment.signals
    signals = {f"the signal of {name}": signal for name, signal in given.items()}
    for what, value in {**signals, "the experiment": task}.items():
        try:
            content = cloudpickle.dumps(value)
        except Exception as error:
            raise OrchestrationError(
                f"{what} cannot be given to a separate process: {error}; expected a function of its "
                "arguments and of plain data, or no timeout"
            ) from error
    return content


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
                allocate(stream.fileno(), size)
        except OSError as error:
            raise OrchestrationError(
                f"{path.parent}: no room for a record of {size / 1e6:.3g} MB, as a run with a timeout needs: "
                f"{error.strerror}; expected another folder in TMPDIR, fewer recorded variables or no timeout"
            ) from error
    return np.asarray(np.memmap(path, kind, "r+", shape=shape))


class _Watch:
    """Receives the messages of a process until its FMUs are freed, its end, or the end of its time.

    outcome: the recording or the error, None before it arrives
    warnings: the FMUs' warnings
    stopped: the interrupt, or the error of the progress, that stopped the run from this process
    """

    def __init__(
        self, process: WorkerProcess, record: SharedRecord, timeout: float, progress: Progress | None
    ) -> None:
        self.outcome: Outcome | None = None
        self.warnings: list[Warned] = []
        self.stopped: BaseException | None = None
        self._process, self._record = process, record
        self._timeout, self._progress = timeout, progress
        self._calls_seen, self._since = (0, 0, 0), time.monotonic()
        self._asked = math.inf

    def until_the_end(self) -> str:
        """Returns why there is no outcome, or why its FMUs were not freed after it, in words, if so."""
        with kept_interrupts() as interrupts:
            while True:
                try:
                    if self._receive():
                        return ""
                except ProcessEndedError as ended:
                    return f"ended its process with {ended}"
                if self.stopped is None:
                    self.stopped = KeyboardInterrupt() if interrupts else self._report_progress()
                    if self.stopped is not None:
                        self._asked = time.monotonic()
                        self._process.send(_STOP, self._process.request)
                elif interrupts and interrupts[-1] > self._asked + _AGAIN_S:
                    return "did not return after an interrupt, and its process was ended"
                limit = self._exceeded()
                if limit:
                    return f"did not return within {limit:g} s, and its process was ended"

    def _receive(self) -> bool:
        """Receives all messages there are, and waits a little for the first; whether the FMUs are freed."""
        with contextlib.suppress(TimeoutError):
            message = self._process.receive(_LOOK_S)
            while message is not None:
                if isinstance(message, Warned):
                    self.warnings.append(message)
                else:
                    self.outcome = message
                message = self._process.receive(0.0)
            return True
        return False

    def _report_progress(self) -> BaseException | None:
        """Calls the progress; returns what it raises."""
        done, last = int(self._report[Report.RECORDED]) - 1, len(self._record.storage.rows) - 1
        return _call_progress(self._progress, done, last) if 0 <= done < last else None

    @property
    def _report(self) -> np.ndarray:
        return self._record.storage.report

    def _exceeded(self) -> float:
        """Returns the limit [s], if the present call of an FMU takes longer."""
        calls = (
            int(self._report[Report.RECORDED]),
            int(self._report[Report.CALLS]),
            int(self._report[Report.BUSY]),
        )
        if (calls[2] == 0 and self.outcome is None) or calls != self._calls_seen:
            self._calls_seen, self._since = calls, time.monotonic()
        # to be unloaded may take as long
        limit = max(self._timeout, _LOADING_S) if calls[2] <= 0 else self._timeout
        return limit if time.monotonic() - self._since > limit else 0.0


def _call_progress(progress: Progress | None, done: int, last: int) -> BaseException | None:
    """Calls the progress; returns its exception, which stops the run."""
    try:
        if progress:
            progress(done, last)
    except (Exception, KeyboardInterrupt) as error:
        return error
    return None


def _failure(problem: str, prepared: PreparedRun, record: SharedRecord) -> OrchestrationError:
    """Returns a run without an outcome: who did what, and what was recorded."""
    report, rows = record.storage.report, record.storage.rows
    if report[Report.RECORDED] == _NOT_BEGUN:
        return OrchestrationError(f"a process for the FMUs could not begin: {problem}")
    done = int(report[Report.RECORDED])
    where = f"at t = {prepared.points[done - 1]:.9g} s" if done else "in the initialisation"
    text = f"{_busy(prepared, record)} {where}: {problem}"
    return SimulationError(text, make_recording(prepared, rows, done))


def _busy(prepared: PreparedRun, record: SharedRecord) -> str:
    """Returns the name of the component whose call is in progress, or else "the run"."""
    busy = abs(int(record.storage.report[Report.BUSY]))
    return list(prepared.system.components)[busy - 1] if busy else "the run"


def _with_warnings(warned: list[Warned], outcome: Outcome) -> Outcome:
    """Issues the warnings of the process; where a warning is an error, a run that was done fails of it."""
    try:
        for warning in warned:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    except Warning as error:
        if isinstance(outcome, Recording):
            failure = SimulationError(repr(error), outcome)
            failure.__cause__ = error
            return failure
    return outcome


def _unwrapped(outcome: Outcome, stopped: BaseException | None) -> Recording:
    """Returns the recording of the whole run, or raises the reason why it is missing."""
    recording = outcome if isinstance(outcome, Recording) else getattr(outcome, "recording", None)
    if recording is not None and (isinstance(stopped, Exception) or (stopped and recording is outcome)):
        outcome = SimulationError(reason_of(stopped), recording)
    if isinstance(outcome, Recording):
        return outcome
    if stopped:
        outcome.__cause__ = stopped
    raise outcome


# In the other process:


def run_task(parent: Parent) -> None:
    """Receives a pickled Task; sends a Warned for each warning, the Outcome, and None when FMUs are freed."""
    # interrupts that come while the run is prepared end it, too
    with kept_interrupts(), contextlib.ExitStack() as fmus:
        try:
            outcome: Outcome = _run(parent, Path(tempfile.gettempdir()), fmus)
        except BaseException as error:
            # any error, also SystemExit, is an outcome for the other process
            error.add_note("".join(traceback.format_exception(error)))
            outcome = error
        parent.send(outcome, _packed_outcome)
        # an FMU may crash in it
        fmus.close()
        parent.send(None)


def _stop_when_asked(parent: Parent) -> None:
    if parent.receive() == _STOP:
        _thread.interrupt_main()


def _run(parent: Parent, folder: Path, fmus: contextlib.ExitStack) -> Recording:
    try:
        system, prepared, options = pickle.loads(parent.receive())
    except Exception as error:
        raise OrchestrationError(
            f"the run cannot be loaded in a separate process: {type(error).__name__}: {error}; "
            "expected signals that can be imported, or no timeout"
        ) from error
    threading.Thread(target=_stop_when_asked, args=(parent,), daemon=True).start()
    storage = SharedRecord(folder, prepared.shape, is_new=False).storage
    storage.report[Report.RECORDED] = 0
    # before the FMUs are loaded: warnings while `fmus` frees them are sent too
    fmus.enter_context(warnings.catch_warnings())
    warnings.simplefilter("always")
    warnings.showwarning = lambda message, category, filename, lineno, *_: parent.send(
        Warned(str(message), category, filename, lineno), cloudpickle.dumps
    )
    return fmus.enter_context(Simulator(system)).run(prepared, storage=storage, **options)


def _packed_outcome(outcome: object) -> bytes:
    if isinstance(outcome, Recording | OrchestrationError):
        return pickle.dumps(outcome)
    try:
        content = cloudpickle.dumps(outcome)
        pickle.loads(content)
    except Exception:
        # an error that cannot be pickled: its text can
        return pickle.dumps(OrchestrationError(f"{type(outcome).__name__}: {outcome}"))
    return content
