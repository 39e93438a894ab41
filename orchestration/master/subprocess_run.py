"""A run in another process: an FMU that hangs or crashes there takes nothing else with it."""

import contextlib
import time
import warnings
from collections.abc import Mapping
from typing import Any

import cloudpickle
import numpy as np

from fmus.process import ProcessEndedError, WorkerProcess
from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.master.interrupt import kept_interrupts
from orchestration.master.loop_data import Report
from orchestration.master.stepping import Progress, make_recording
from orchestration.master.subprocess_worker import STOP, Outcome, SharedRecord, Task, Warned, run_task
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import System

_LOOK_S = 0.1
_LOADING_S = 60.0  # for an FMU to be loaded, at least: it may start an interpreter, or look for a license
_AGAIN_S = 1.0  # an interrupt that soon after another is the same one, passed on by a shell for instance
_NOT_BEGUN = -1


def simulate_in_subprocess(
    system: System,
    experiment: Experiment,
    timeout: float,
    progress: Progress | None = None,
    options: Mapping[str, Any] | None = None,
) -> Recording:
    """`Simulator.run` with these options in another process.

    timeout: longest time [s] that a call of an FMU may take; to load one may take a minute
    Raises SimulationError when that is over, and when the process dies. An interrupt stops the run as it does
    without timeout; a second one ends the process.
    """
    if not timeout > 0.0:
        raise SystemDefinitionError(f"timeout {timeout!r} s: expected more than 0")
    prepared = prepare(system, experiment)
    task = _packed(Task(system, experiment, dict(options or {}), prepared.shape))
    with (
        contextlib.closing(WorkerProcess(run_task)) as process,
        contextlib.closing(SharedRecord(process.folder, prepared.shape, "w+")) as record,
    ):
        record.storage.report[Report.RECORDED] = _NOT_BEGUN
        process.send(task)
        watch = _Watch(process, record, timeout, progress)
        problem, stopped = watch.until_the_end()
        process.kill()
        outcome = watch.outcome or _failure(problem, prepared, record)
    outcome = _with_warnings(watch.warnings, outcome)
    return _unwrapped(outcome, stopped or _last_word(progress, outcome))


def _packed(task: Task) -> bytes:
    """OrchestrationError for what cannot be given to another process."""
    try:
        return cloudpickle.dumps(task)
    except Exception as error:
        signals = {f"the signal of {name}": each for name, each in task.experiment.signals.items()}
        what = next((name for name, each in signals.items() if not _travels(each)), "the experiment")
        raise OrchestrationError(
            f"{what} cannot be given to a process of its own: {error}; expected a function of its own "
            "arguments and of plain data, or no timeout"
        ) from error


def _travels(value: object) -> bool:
    try:
        cloudpickle.dumps(value)
    except Exception:
        return False
    return True


class _Watch:
    """Receives the messages of a process until its outcome, its end, or the end of its time.

    outcome: None without one; warnings: those of the FMUs
    """

    def __init__(
        self, process: WorkerProcess, record: SharedRecord, timeout: float, progress: Progress | None
    ) -> None:
        self.outcome: Outcome | None = None
        self.warnings: list[Warned] = []
        self._process, self._record = process, record
        self._timeout, self._progress = timeout, progress
        self._calls_seen, self._since = (0, 0, 0), time.monotonic()
        self._stopped: BaseException | None = None
        self._asked = 0.0

    def until_the_end(self) -> tuple[str, BaseException | None]:
        """Why there is no outcome, if so, in words; and what stopped the run from here, if something did."""
        with kept_interrupts() as interrupts:
            while True:
                try:
                    self._receive()
                except ProcessEndedError as ended:
                    return f"ended its process with {ended}", self._stopped
                if self.outcome is not None:
                    return "", self._stopped
                if self._stopped is None:
                    self._stopped = KeyboardInterrupt() if interrupts else self._told()
                    if self._stopped is not None:
                        self._asked = time.monotonic()
                        self._process.send(STOP)
                elif interrupts and interrupts[-1] > self._asked + _AGAIN_S:
                    return "did not return after an interrupt, and its process was ended", self._stopped
                limit = self._exceeded()
                if limit:
                    return f"did not return within {limit:g} s, and its process was ended", self._stopped

    def _receive(self) -> None:
        """Receive all messages there are, and wait a little for the first."""
        with contextlib.suppress(TimeoutError):
            message = self._process.receive(_LOOK_S)
            while True:
                if isinstance(message, Warned):
                    self.warnings.append(message)
                else:
                    self.outcome = message
                    return
                message = self._process.receive(0.0)

    def _told(self) -> BaseException | None:
        """Tell the progress; what it raises."""
        done, last = int(self._report[Report.RECORDED]) - 1, len(self._record.storage.rows) - 1
        return _said(self._progress, done, last) if 0 <= done < last else None

    @property
    def _report(self) -> np.ndarray:
        return self._record.storage.report

    def _exceeded(self) -> float:
        """The limit [s], if the present call of an FMU takes longer."""
        calls = (
            int(self._report[Report.RECORDED]),
            int(self._report[Report.CALLS]),
            int(self._report[Report.BUSY]),
        )
        if calls[2] == 0 or calls != self._calls_seen:
            self._calls_seen, self._since = calls, time.monotonic()
        limit = max(self._timeout, _LOADING_S) if calls[2] < 0 else self._timeout
        return limit if time.monotonic() - self._since > limit else 0.0


def _said(progress: Progress | None, done: int, last: int) -> BaseException | None:
    """Tell the progress; what it raises stops the run."""
    try:
        if progress:
            progress(done, last)
    except (Exception, KeyboardInterrupt) as error:
        return error
    return None


def _failure(problem: str, prepared: PreparedRun, record: SharedRecord) -> OrchestrationError:
    """A run without an outcome: who did what, and what was recorded."""
    report, rows = record.storage.report, record.storage.rows
    if report[Report.RECORDED] == _NOT_BEGUN:
        return OrchestrationError(f"a process for the FMUs could not begin: {problem}")
    done, busy = int(report[Report.RECORDED]), abs(int(report[Report.BUSY]))
    who = list(prepared.system.components)[busy - 1] if busy else "the run"
    where = f"at t = {prepared.points[done - 1]:.9g} s" if done else "in the initialisation"
    return SimulationError(f"{who} {where}: {problem}", make_recording(prepared, rows, done))


def _with_warnings(warned: list[Warned], outcome: Outcome) -> Outcome:
    """Issue the warnings of the process; where a warning is an error, a run that was done fails of it."""
    try:
        for warning in warned:
            warnings.warn_explicit(warning.message, warning.category, warning.filename, warning.lineno)
    except Warning as error:
        if isinstance(outcome, Recording):
            failure = SimulationError(repr(error), outcome)
            failure.__cause__ = error
            return failure
    return outcome


def _last_word(progress: Progress | None, outcome: Outcome) -> BaseException | None:
    """Tell the progress that all is done, if it is; what it raises."""
    last = len(outcome.time) - 1 if isinstance(outcome, Recording) else 0
    return _said(progress, last, last) if last else None


def _unwrapped(outcome: Outcome, stopped: BaseException | None) -> Recording:
    """The recording, or raise why there is none of the whole run."""
    there = outcome if isinstance(outcome, Recording) else getattr(outcome, "recording", None)
    if there and (isinstance(stopped, Exception) or (stopped and there is outcome)):
        outcome = SimulationError(_reason(stopped), there)
    if isinstance(outcome, Recording):
        return outcome
    if stopped:
        outcome.__cause__ = stopped
    raise outcome


def _reason(stopped: BaseException) -> str:
    if isinstance(stopped, KeyboardInterrupt):
        return "interrupted"
    return str(stopped) if isinstance(stopped, OrchestrationError) else repr(stopped)
