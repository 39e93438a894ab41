"""Evaluations side by side, each in a process of its own, which a controller may crash or hang."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from queue import SimpleQueue
from typing import Any

from orchestration.score.isolated_loop import IsolatedLoop, RunError
from orchestration.score.loop import Controller
from orchestration.score.protocol import Protocol
from orchestration.score.tune import Evaluate
from orchestration.score.tune_cost import LARGEST, cost_of, practice_cases


@contextmanager
def processes(controller: Controller, protocol: Protocol, count: int) -> Iterator[Evaluate]:
    """So many processes, which end with the context; gains that end one have the largest cost."""
    timeout = protocol.tables.time_limit * (len(practice_cases(protocol)) + 1)
    with ExitStack() as stack:
        idle: SimpleQueue[IsolatedLoop] = SimpleQueue()

        def start() -> None:
            loop = IsolatedLoop(controller, protocol.file.path, timeout)
            stack.callback(loop.close)
            idle.put(loop)

        def cost(gains: dict[str, float]) -> dict[str, Any]:
            loop = idle.get()
            try:
                evaluated = loop.call(cost_of, gains)
            except RunError as error:
                loop.close()
                start()
                return {"cost": LARGEST, "failure": str(error)}
            idle.put(loop)
            return evaluated

        threads = stack.enter_context(ThreadPoolExecutor(count))  # waits last, for calls whose process ended
        for _ in range(count):
            start()
        stack.callback(threads.shutdown, wait=False, cancel_futures=True)
        yield lambda gains: threads.map(cost, gains)
