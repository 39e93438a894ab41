"""A run in a process of its own: an FMU that hangs or crashes there takes nothing else with it.

It runs FOLDER/task and leaves FOLDER/outcome. The record and the report of the loop are files that both
processes map: what was recorded is there however the run ended. The process ends when the one that started it
does.
"""

import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np

from orchestration.errors import OrchestrationError, SimulationError, SystemDefinitionError
from orchestration.experiment import Experiment, checked_settings, communication_points, recorded
from orchestration.master.loop import BUSY, RECORDED, REPORT_SIZE, Storage
from orchestration.master.simulator import Simulator
from orchestration.master.stepping import Progress, provenance
from orchestration.recording import Recording
from orchestration.system import CheckedSystem, System, check

_LOOK_S = 0.02
_PATIENCE_S = 5.0  # for a run that was asked to end
_NOT_BEGUN = -1


def simulate_apart(
    system: System,
    experiment: Experiment,
    timeout: float,
    progress: Progress | None = None,
    options: Mapping[str, Any] | None = None,
) -> Recording:
    """`Simulator.run` with these options in a process of its own.

    timeout: longest time [s] for the initialisation or a communication step
    Raises SimulationError when that is over, and when the process dies.
    """
    if not timeout > 0.0:
        raise SystemDefinitionError(f"timeout {timeout!r} s: expected more than 0")
    checked = check(system, [*experiment.inputs, *experiment.signals])
    checked_settings(checked, experiment)
    with tempfile.TemporaryDirectory(prefix="l1-depth-run-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        storage = _storage(folder, checked, experiment, "w+")
        storage.report[RECORDED] = _NOT_BEGUN
        with (folder / "task").open("wb") as stream:
            cloudpickle.dump((system, experiment, dict(options or {}), storage.rows.shape), stream)
        process = subprocess.Popen(
            [sys.executable, "-c", f"from {__name__} import child; child()", name],
            stdin=subprocess.PIPE,
            env={**os.environ, "TMPDIR": name, "TEMP": name},
        )
        try:
            problem = _watch(process, storage.report, timeout, progress, len(storage.rows) - 1)
        except KeyboardInterrupt:
            problem = _interrupt(process)
        finally:
            process.kill()
            process.communicate()
        outcome = folder / "outcome"
        if outcome.is_file():
            with outcome.open("rb") as stream:
                result = pickle.load(stream)
            if isinstance(result, Exception):
                raise result
            return result
        raise _failure(problem, checked, experiment, storage)


def _storage(folder: Path, checked: CheckedSystem, experiment: Experiment, mode: Any) -> Storage:
    shape = len(communication_points(checked, experiment)), len(recorded(checked, experiment))
    return map_storage(folder, shape, mode)


def map_storage(folder: Path, shape: tuple[int, int], mode: Any) -> Storage:
    """The record and the report as files."""
    rows = np.memmap(folder / "rows", float, mode, shape=shape)
    return Storage(rows, np.memmap(folder / "report", np.int64, mode, shape=(REPORT_SIZE,)))


def _watch(
    process: subprocess.Popen[bytes],
    report: np.ndarray,
    timeout: float,
    progress: Progress | None,
    last: int,
) -> str:
    """Wait for the end of the process; why it left no outcome, if it did not."""
    seen, since = _NOT_BEGUN, time.monotonic()
    while True:
        try:
            status = process.wait(_LOOK_S)
        except subprocess.TimeoutExpired:
            pass
        else:
            return f"ended its process with {_named(status)}"
        if progress:
            progress(max(0, int(report[RECORDED]) - 1), last)
        if report[RECORDED] != seen:
            seen, since = int(report[RECORDED]), time.monotonic()
        elif seen != _NOT_BEGUN and time.monotonic() - since > timeout:
            return f"did not return within {timeout:g} s, and its process was ended"


def _named(status: int) -> str:
    return f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"


def _interrupt(process: subprocess.Popen[bytes]) -> str:
    process.send_signal(signal.SIGINT)
    try:
        process.wait(_PATIENCE_S)
    except subprocess.TimeoutExpired:
        return "did not return after an interrupt, and its process was ended"
    return "was interrupted"


def _failure(
    problem: str, checked: CheckedSystem, experiment: Experiment, storage: Storage
) -> SimulationError:
    """A run without an outcome: who did what, and what was recorded."""
    points = communication_points(checked, experiment)
    done = max(0, int(storage.report[RECORDED]))
    busy = int(storage.report[BUSY])
    who = list(checked.components)[busy - 1] if busy else "an FMU"
    where = f"at t = {points[done - 1]:.9g} s" if done else "in the initialisation"
    names = recorded(checked, experiment)
    recording = Recording(
        names=names,
        units=tuple(checked.ports[name].variable.unit or "" for name in names),
        time=points[:done].copy(),
        values=np.array(storage.rows[:done]),
        provenance=provenance(checked, experiment),
    )
    return SimulationError(f"{who} {where}: {problem}", recording)


def _run(folder: Path) -> None:
    with (folder / "task").open("rb") as stream:
        system, experiment, options, shape = pickle.load(stream)
    storage = map_storage(folder, shape, "r+")
    storage.report[RECORDED] = 0
    try:
        with Simulator(system) as simulator:
            outcome: Any = simulator.run(experiment, storage=storage, **options)
    except OrchestrationError as error:
        outcome = error
    unfinished = folder / "unfinished outcome"
    with unfinished.open("wb") as stream:
        cloudpickle.dump(outcome, stream)
    unfinished.replace(folder / "outcome")


def _end_with_parent() -> None:
    os.read(sys.stdin.fileno(), 1)  # nothing is ever sent: this is the end of the pipe
    os._exit(1)


def child() -> None:
    """What the process does."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    _run(Path(sys.argv[1]))
