"""Jacobi steps of the components on several threads, where that is faster, with the same results bit for bit.

Between two communication points the components of a Jacobi step know nothing of each other, so any thread may
step any of them. Inputs, outputs, statuses and the recording stay with one thread, in the order of the
components. For light FMUs, waiting for each other would cost more than the steps: a batch of the loop goes to
threads only after one without them took long, and goes on with them only if they were faster.
"""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from fmus.fmi.description import is_independent
from fmus.platforms import usable_processors
from orchestration.run.loop_data import LoopFunctions, Team
from orchestration.run.wiring import WiredRun

if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

_LEAST_STEP_S = 1e-4  # of all components together; waiting for each other takes some microseconds
_FASTER = 0.9  # of the time without threads


class StepThreads:
    """Runs the loop of one run, on threads where that pays; `close` ends them.

    threads: how many, whatever that costs; None for as many as there are processors, decided by measurement.
    FMUs that are not known to leave each other alone (`is_independent`) then stay on one thread
    clocks: CPU time of this thread and wall clock [s]; steps without threads are measured by the first one,
    so that what else runs on a processor is no reason for threads, which would wait for it too
    """

    def __init__(
        self,
        wired: WiredRun,
        loop: LoopFunctions,
        threads: int | None,
        processors: int | None = None,
        clocks: tuple[Callable[[], float], Callable[[], float]] = (time.thread_time, time.perf_counter),
    ) -> None:
        self._loop, self._team, (self._cpu, self._clock) = loop, wired.wiring.team, clocks
        self._is_measured = threads is None
        most = _useful(wired, processors or usable_processors()) if threads is None else threads
        can_share = loop.help is not None and not wired.wiring.gauss_seidel
        self._threads = min(most, len(wired.instances)) if can_share else 1
        self._pool: ThreadPoolExecutor | None = None
        self._single_s, self._has_run = 0.0, False  # of a step without threads, after the first, slower batch

    def run(self, first: int, last: int) -> int:
        """`LoopFunctions.run`."""
        if self._threads < 2 or (self._is_measured and self._single_s < _LEAST_STEP_S):
            start = self._cpu()
            reached = self._loop.run(first, last)
            self._single_s = (self._cpu() - start) / max(reached - first, 1) if self._has_run else 0.0
            self._has_run = True
            return reached
        start = self._clock()
        reached = self._run_together(first, last)
        step_s = (self._clock() - start) / max(reached - first, 1)
        if self._is_measured and step_s > _FASTER * self._single_s:
            self._threads = 1
        return reached

    def _run_together(self, first: int, last: int) -> int:
        from concurrent.futures import ThreadPoolExecutor  # few runs have steps that take long

        self._pool = self._pool or ThreadPoolExecutor(self._threads - 1, "l1-depth-step")
        assert self._loop.help
        self._team[Team.IS_USED], self._team[Team.IS_OVER] = 1, 0
        helpers = []
        try:
            helpers += [self._pool.submit(self._loop.help) for _ in range(self._threads - 1)]
            return self._loop.run(first, last)
        finally:
            self._team[Team.IS_USED], self._team[Team.IS_OVER] = 0, 1
            for helper in helpers:
                helper.result()

    def close(self) -> None:
        if self._pool:
            self._pool.shutdown()


def _useful(wired: WiredRun, processors: int) -> int:
    """The processors; 1 unless all FMUs are known to be independent of each other."""
    independent = all(is_independent(instance.description) for instance in wired.instances.values())
    return processors if independent else 1
