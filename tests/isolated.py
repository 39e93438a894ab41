"""Importers of other projects, each in a separate process."""

from contextlib import closing
from typing import Any

from fmus.fmi.process import ProcessEndedError, Worker, WorkerProcess


def answer_of(worker: Worker, job: object, timeout: float) -> Any:
    """Returns the message that a worker sends for a job, or the reason for its absence.

    timeout: s
    """
    with closing(WorkerProcess(worker)) as process:
        process.send(job)
        try:
            return process.receive(timeout)
        except TimeoutError:
            return f"not done in {timeout:g} s"
        except ProcessEndedError as error:
            return f"ended with {error}: {error.last_error_line or 'no message'}"
