"""A controller in the loop of the protocol, in a process of its own, where it may hang or crash."""

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Concatenate

from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess
from orchestration.errors import OrchestrationError
from orchestration.score.loop import Controller, Loop
from orchestration.score.protocol import read_protocol

_MOST_ENDINGS = 3  # of processes; a start takes a second
_START_S = 300.0  # to import and to load, on a machine that is busy


class RunError(OrchestrationError):
    """A run that gave no figures: the controller failed, hung or crashed."""


class IsolatedLoop:
    """Calls functions of a `Loop` in another process, which is replaced when it ends.

    timeout: longest time [s] of a run. Nothing more is asked of a controller after a call that took longer,
    and after its process has ended three times.
    """

    def __init__(self, controller: Controller, protocol: Path, timeout: float) -> None:
        self._job, self._timeout = (controller, protocol), timeout
        self._process: WorkerProcess | None = None
        self._lock = threading.Lock()
        self._refusal = ""
        self._endings = 0

    def call(self, function: Callable[Concatenate[Loop, ...], Any], *arguments: Any, runs: int = 1) -> Any:
        """function(loop, *arguments), a function of a module that makes so many runs.

        Raises RunError, which says why there is no result.
        """
        try:
            process = self._running()
            process.send((function, arguments))
            value, error = process.receive(runs * self._timeout)
        except ProcessEndedError as ended:
            self._endings += 1
            self._replace()
            if self._endings == _MOST_ENDINGS:
                self._refuse(f"not run: its process ended {_MOST_ENDINGS} times before")
            raise RunError(f"its process ended with {ended}") from ended
        except TimeoutError:
            self._refuse("not run: it took too long before")
            raise RunError(f"it took longer than {self._timeout:g} s") from None
        if error:
            raise RunError(error)
        return value

    @property
    def is_intact(self) -> bool:
        """Whether no call took too long, and no process ended by itself."""
        return not self._endings and not self._refusal

    def close(self) -> None:
        """End the process at once, also from another thread while a call runs."""
        self._refuse("closed")

    def _running(self) -> WorkerProcess:
        with self._lock:
            if self._refusal:
                raise RunError(self._refusal)
            if self._process is not None:
                return self._process
            self._process = process = WorkerProcess(answer_calls)
        process.send(self._job)
        process.receive(_START_S)
        return process

    def _refuse(self, reason: str) -> None:
        with self._lock:
            self._refusal = reason
        self._replace()

    def _replace(self) -> None:
        with self._lock:
            if self._process is not None:
                self._process.close()
            self._process = None


def answer_calls(parent: Parent) -> None:
    """In the process: receive controller and protocol; then call what is sent, and send the result."""
    controller, protocol = parent.receive()
    loop = Loop(controller, read_protocol(protocol))
    parent.send("ready")
    while True:
        function, arguments = parent.receive()
        try:
            answer = function(loop, *arguments), ""
        except Exception as error:  # whatever the reason, it is a row of the score
            loop.close()
            answer = None, error_line(error)
        parent.send(answer)


def error_line(error: Exception) -> str:
    """Why there is no result, in one line."""
    text = str(error) if isinstance(error, OrchestrationError) else f"{type(error).__name__}: {error}"
    return " ".join(text.split())
