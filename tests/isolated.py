"""Other people's importers, each in a process of its own."""

from contextlib import closing
from typing import Any

from fmus.fmi.process import ProcessEndedError, Worker, WorkerProcess


def answer_of(worker: Worker, job: object, timeout: float) -> Any:
    """The message that a worker sends for a job, or a text that tells why there is none.

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
