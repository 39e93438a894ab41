"""Functions that run side by side, each in a process that an interrupt ends at once."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, contextmanager
from queue import SimpleQueue
from typing import Any

from fmus.fmi.process import Parent, ProcessEndedError, WorkerProcess
from orchestration.errors import OrchestrationError

Submit = Callable[..., Future[Any]]
"""(function of a module, *arguments) -> its future result."""


@contextmanager
def worker_pool(count: int) -> Iterator[Submit]:
    """So many processes, which end with the context, whatever they are at."""
    with ExitStack() as stack:
        threads = stack.enter_context(ThreadPoolExecutor(count))
        stack.callback(threads.shutdown, wait=False, cancel_futures=True)
        idle: SimpleQueue[WorkerProcess] = SimpleQueue()
        for _ in range(count):
            idle.put(stack.enter_context(closing(WorkerProcess(run_calls))))

        def call(function: Callable[..., Any], *arguments: Any) -> Any:
            process = idle.get()
            try:
                process.send((function, arguments))
                result, error = process.receive()
            except ProcessEndedError as ended:
                raise OrchestrationError(f"a worker process ended with {ended}") from ended
            finally:
                idle.put(process)
            if error is not None:
                raise error
            return result

        yield lambda function, *arguments: threads.submit(call, function, *arguments)


def run_calls(parent: Parent) -> None:
    """In such a process: call what the parent sends, and send what it returns or raises."""
    while True:
        function, arguments = parent.receive()
        try:
            answer = function(*arguments), None
        except Exception as error:
            answer = None, error
        parent.send(answer)
