"""A run in another process: an FMU that hangs or crashes there takes nothing else with it."""

import contextlib
import math
import time
import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import cloudpickle
import numpy as np

from fmus.fmi.process import ProcessEndedError, WorkerProcess
from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.results.recording import Recording
from orchestration.run.error_estimate import with_error_estimate
from orchestration.run.interrupt import kept_interrupts
from orchestration.run.loop_data import Report
from orchestration.run.run_recording import make_recording, reason_of
from orchestration.run.stepping import Progress
from orchestration.run.subprocess_worker import STOP, Outcome, SharedRecord, Task, Warned, run_task
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import System

_LOOK_S = 0.1
_LOADING_S = 60.0  # for an FMU to be loaded, at least: it may start an interpreter, or look for a license
_AGAIN_S = 1.0  # an interrupt that soon after another is the same one, passed on by a shell for instance
_NOT_BEGUN = -1


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
    alone = replace(prepared, experiment=replace(experiment, error_estimate=False))
    task = _packed(Task(system, alone, dict(options or {})))
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
    outcome, stopped = _with_warnings(watch.warnings, outcome), watch.stopped
    if stopped is None and isinstance(outcome, Recording):
        stopped = _call_progress(progress, len(outcome.time) - 1, len(outcome.time) - 1)
    recording = _unwrapped(outcome, stopped)
    if experiment.error_estimate:

        def second(coarser: Experiment) -> Recording:
            return simulate_in_subprocess(system, prepare(system, coarser), timeout)

        return with_error_estimate(recording, prepared, second)
    return recording


def _packed(task: Task) -> bytes:
    """Raises OrchestrationError for what cannot be given to another process."""
    content = b""
    given = task.prepared.experiment.signals
    signals = {f"the signal of {name}": signal for name, signal in given.items()}
    for what, value in {**signals, "the experiment": task}.items():
        try:
            content = cloudpickle.dumps(value)
        except Exception as error:
            raise OrchestrationError(
                f"{what} cannot be given to a process of its own: {error}; expected a function of its own "
                "arguments and of plain data, or no timeout"
            ) from error
    return content


class _Watch:
    """Receives the messages of a process until its outcome, its end, or the end of its time.

    outcome: None without one; warnings: those of the FMUs; stopped: what stopped the run from here
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
        """Returns why there is no outcome, in words, if there is none."""
        with kept_interrupts() as interrupts:
            while True:
                try:
                    self._receive()
                except ProcessEndedError as ended:
                    return f"ended its process with {ended}"
                if self.outcome is not None:
                    return ""
                if self.stopped is None:
                    self.stopped = KeyboardInterrupt() if interrupts else self._report_progress()
                    if self.stopped is not None:
                        self._asked = time.monotonic()
                        self._process.send(STOP, self._process.request)
                elif interrupts and interrupts[-1] > self._asked + _AGAIN_S:
                    return "did not return after an interrupt, and its process was ended"
                limit = self._exceeded()
                if limit:
                    return f"did not return within {limit:g} s, and its process was ended"

    def _receive(self) -> None:
        """Receives all messages there are, and waits a little for the first."""
        with contextlib.suppress(TimeoutError):
            message = self._process.receive(_LOOK_S)
            while isinstance(message, Warned):
                self.warnings.append(message)
                message = self._process.receive(0.0)
            self.outcome = message

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
        if calls[2] == 0 or calls != self._calls_seen:
            self._calls_seen, self._since = calls, time.monotonic()
        limit = max(self._timeout, _LOADING_S) if calls[2] < 0 else self._timeout
        return limit if time.monotonic() - self._since > limit else 0.0


def _call_progress(progress: Progress | None, done: int, last: int) -> BaseException | None:
    """Calls the progress; what it raises stops the run."""
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
    done, busy = int(report[Report.RECORDED]), abs(int(report[Report.BUSY]))
    who = list(prepared.system.components)[busy - 1] if busy else "the run"
    where = f"at t = {prepared.points[done - 1]:.9g} s" if done else "in the initialisation"
    return SimulationError(f"{who} {where}: {problem}", make_recording(prepared, rows, done))


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
    """Returns the recording, or raises why there is none of the whole run."""
    recording = outcome if isinstance(outcome, Recording) else getattr(outcome, "recording", None)
    if recording is not None and (isinstance(stopped, Exception) or (stopped and recording is outcome)):
        outcome = SimulationError(reason_of(stopped), recording)
    if isinstance(outcome, Recording):
        return outcome
    if stopped:
        outcome.__cause__ = stopped
    raise outcome
