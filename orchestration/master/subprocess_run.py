"""A run in a process of its own: an FMU that hangs or crashes there takes nothing else with it.

What happens there is in `child.py`. The process ends when the one that started it does.
"""

import contextlib
import pickle
import subprocess
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any, cast

import cloudpickle
import numpy as np

from fmus.process import ending, start
from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.master.interrupt import kept_interrupts
from orchestration.master.loop import BUSY, CALLS, RECORDED
from orchestration.master.progress import Progress
from orchestration.master.record import make_recording
from orchestration.master.subprocess_worker import OUTCOME, TASK, WARNINGS, SharedRecord, Task, child
from orchestration.results.recording import Recording
from orchestration.system.experiment import Experiment
from orchestration.system.prepared_run import PreparedRun, prepare
from orchestration.system.system import System

_LOOK_S = 0.1
_LOADING_S = 60.0  # for an FMU to be loaded, at least: it may start an interpreter, or look for a license
_AGAIN_S = 1.0  # an interrupt that soon after another is the same one, passed on by a shell for instance
_NOT_BEGUN = -1

_Outcome = Recording | BaseException


def simulate_in_subprocess(
    system: System,
    experiment: Experiment,
    timeout: float,
    progress: Progress | None = None,
    options: Mapping[str, Any] | None = None,
) -> Recording:
    """`Simulator.run` with these options in a process of its own.

    timeout: longest time [s] that a call of an FMU may take; to load one may take a minute
    Raises SimulationError when that is over, and when the process dies. An interrupt stops the run as it does
    without timeout; a second one ends the process.
    """
    if not timeout > 0.0:
        raise SystemDefinitionError(f"timeout {timeout!r} s: expected more than 0")
    prepared = prepare(system, experiment)
    task = _packed(Task(system, experiment, dict(options or {}), prepared.shape))
    with tempfile.TemporaryDirectory(prefix="l1-depth-run-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        (folder / TASK).write_bytes(task)
        with contextlib.closing(SharedRecord(folder, prepared.shape, "w+")) as record:
            record.storage.report[RECORDED] = _NOT_BEGUN
            process = start(child, folder)
            try:
                watch = _Watch(process, folder / OUTCOME, record, timeout, progress)
                problem, stopped = watch.until_the_end()
            finally:
                process.kill()
                process.communicate()
            outcome = _outcome(folder / OUTCOME) or _failure(problem, prepared, record)
        outcome = _with_warnings(folder / WARNINGS, outcome)
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
    """Looks after a process until it ends, or ends it."""

    def __init__(
        self,
        process: subprocess.Popen[bytes],
        outcome: Path,
        record: SharedRecord,
        timeout: float,
        progress: Progress | None,
    ) -> None:
        self._process, self._path, self._record = process, outcome, record
        self._timeout, self._progress = timeout, progress
        self._seen, self._since = (0, 0, 0), time.monotonic()
        self._stopped: BaseException | None = None
        self._asked = 0.0

    def until_the_end(self) -> tuple[str, BaseException | None]:
        """How it ended, in words; and what stopped the run from here, if something did."""
        with kept_interrupts() as interrupts:
            while True:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    return f"ended its process with {ending(self._process.wait(_LOOK_S))}", self._stopped
                if self._stopped is None:
                    self._stopped = KeyboardInterrupt() if interrupts else self._told()
                    if self._stopped is not None:
                        self._ask_to_stop()
                elif interrupts and interrupts[-1] > self._asked + _AGAIN_S:
                    return "did not return after an interrupt, and its process was ended", self._stopped
                limit = self._exceeded()
                if limit:
                    return f"did not return within {limit:g} s, and its process was ended", self._stopped

    def _told(self) -> BaseException | None:
        """Tell the progress; what it raises."""
        done, last = int(self._report[RECORDED]) - 1, len(self._record.storage.rows) - 1
        return _said(self._progress, done, last) if 0 <= done < last else None

    @property
    def _report(self) -> np.ndarray:
        return self._record.storage.report

    def _ask_to_stop(self) -> None:
        self._asked = time.monotonic()
        questions = cast(IO[bytes], self._process.stdin)
        with contextlib.suppress(OSError):  # of a process that is gone
            questions.write(b"!")
            questions.flush()

    def _exceeded(self) -> float:
        """The limit [s], if what FMUs are doing takes longer: a call, or the end of their process."""
        now = int(self._report[RECORDED]), int(self._report[CALLS]), int(self._report[BUSY])
        loads, busy = now[2] < 0, now[2] != 0 or self._path.is_file()
        if not busy or now != self._seen:
            self._seen, self._since = now, time.monotonic()
        limit = max(self._timeout, _LOADING_S) if loads else self._timeout
        return limit if time.monotonic() - self._since > limit else 0.0


def _said(progress: Progress | None, done: int, last: int) -> BaseException | None:
    """Tell the progress; what it raises stops the run."""
    try:
        if progress:
            progress(done, last)
    except (Exception, KeyboardInterrupt) as error:
        return error
    return None


def _outcome(path: Path) -> _Outcome | None:
    return pickle.loads(path.read_bytes()) if path.is_file() else None


def _failure(problem: str, prepared: PreparedRun, record: SharedRecord) -> OrchestrationError:
    """A run without an outcome: who did what, and what was recorded."""
    report, rows = record.storage.report, record.storage.rows
    if report[RECORDED] == _NOT_BEGUN:
        return OrchestrationError(f"a process for the FMUs could not begin: {problem}")
    done, busy = int(report[RECORDED]), abs(int(report[BUSY]))
    who = list(prepared.system.components)[busy - 1] if busy else "the run"
    where = f"at t = {prepared.points[done - 1]:.9g} s" if done else "in the initialisation"
    return SimulationError(f"{who} {where}: {problem}", make_recording(prepared, rows, done))


def _with_warnings(path: Path, outcome: _Outcome) -> _Outcome:
    """Warn of what was warned of there; where a warning is an error, a run that was done fails of it."""
    try:
        for each in _pickled(path):
            warnings.warn_explicit(*each)
    except Warning as error:
        if isinstance(outcome, Recording):
            failure = SimulationError(repr(error), outcome)
            failure.__cause__ = error
            return failure
    return outcome


def _pickled(path: Path) -> Iterator[Any]:
    """What a file holds, up to its end or to where a process died."""
    if path.is_file():
        with path.open("rb") as stream, contextlib.suppress(EOFError, pickle.UnpicklingError):
            while True:
                yield pickle.load(stream)


def _last_word(progress: Progress | None, outcome: _Outcome) -> BaseException | None:
    """Tell the progress that all is done, if it is; what it raises."""
    last = len(outcome.time) - 1 if isinstance(outcome, Recording) else 0
    return _said(progress, last, last) if last else None


def _unwrapped(outcome: _Outcome, stopped: BaseException | None) -> Recording:
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
