"""The communication loop compiled, and its Jacobi steps on several threads where that is faster.

`loop.c` is compiled by whoever built the wheel, else at its first use.

Between two communication points the components of a Jacobi step know nothing of each other, so any thread may
step any of them, with the same results bit for bit. Inputs, outputs, statuses and the recording stay with one
thread, in the order of the components. For light FMUs, waiting for each other would cost more than the steps:
a batch of the loop goes to threads only after one without them took long, and goes on with them only if they
were faster.
"""

import ctypes
import threading
import time
from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmus.errors import ExportError
from fmus.native import compiled_library
from fmus.operating_system import usable_processors
from orchestration.errors import OrchestrationError
from orchestration.run.loop_data import LoopFunctions, Team, Wiring

_SOURCE = "loop.c"
_loading = threading.Lock()


def compiled_loop(wiring: Wiring) -> LoopFunctions:
    """Returns the functions of the loop for one wiring; OrchestrationError if it cannot be compiled."""
    functions = library()
    memory = np.array(_members(wiring), np.int64)
    pointer = ctypes.c_void_p(memory.ctypes.data)
    pointer.memory = memory, wiring  # type: ignore[attr-defined]  # they must live as long as the functions
    return LoopFunctions(*(partial(getattr(functions, name), pointer) for name in _SIGNATURES))


_INDEX, _TIME = ctypes.c_int64, ctypes.c_double
# in the order of `LoopFunctions`: the type of the result, and of the arguments after the wiring
_SIGNATURES: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "loop_run": (_INDEX, (_INDEX, _INDEX)),
    "loop_exchange_and_record": (ctypes.c_int, (_INDEX,)),
    "loop_exchange": (ctypes.c_int, (_INDEX, _TIME, ctypes.c_int)),
    "loop_step": (ctypes.c_int, (_INDEX, _TIME, _TIME)),
    "loop_read_outputs": (ctypes.c_int, (_INDEX,)),
    "loop_save": (ctypes.c_int, (ctypes.c_void_p,)),
    "loop_restore": (ctypes.c_int, (ctypes.c_void_p,)),
    "loop_help": (None, ()),
}


def _members(wiring: Wiring) -> list[int]:
    """Returns `Wiring` of loop.c: counts, then every member in its order, an array as its address."""
    sources = wiring.connections.source
    counted = (
        wiring.points,
        wiring.instances,
        sources,
        wiring.signal_index,
        wiring.record_index,
        wiring.memory,
    )
    flat: list[Any] = []
    for member in wiring:
        flat += member if isinstance(member, tuple) else (member,)
    return [*map(len, counted), *(x.ctypes.data if isinstance(x, np.ndarray) else x for x in flat)]


def library() -> ctypes.CDLL:
    """Returns the loop of the wheel, or one compiled once for this user; OrchestrationError if it fails."""
    # two threads would load it twice, each with another floating-point mode to restore
    with _loading:
        loaded = _library_or_error()
    if isinstance(loaded, Exception):
        raise OrchestrationError(f"the communication loop is not compiled: {loaded}") from loaded
    return loaded


@cache
def _library_or_error() -> ctypes.CDLL | Exception:
    """Returns the library or the error, looked for once: finding no compiler takes time."""
    source = Path(__file__).parent / _SOURCE
    try:
        loaded = compiled_library.load(source)
    except (ExportError, OSError) as error:
        return error
    for function, (result, arguments) in _SIGNATURES.items():
        entry = getattr(loaded, function)
        entry.restype, entry.argtypes = result, (ctypes.c_void_p, *arguments)
    return loaded


if TYPE_CHECKING:
    from concurrent.futures import ThreadPoolExecutor

# of all components together: threads that wait for each other cost some microseconds a step
_LEAST_STEP_S = 1e-4
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
        wiring: Wiring,
        loop: LoopFunctions,
        threads: int | None,
        processors: int | None = None,
        clocks: tuple[Callable[[], float], Callable[[], float]] = (time.thread_time, time.perf_counter),
    ) -> None:
        self._loop, self._team, (self._cpu, self._clock) = loop, wiring.team, clocks
        self._is_measured = threads is None
        useful = processors or usable_processors() if wiring.independent else 1
        most = useful if threads is None else threads
        can_share = loop.help is not None and not wiring.gauss_seidel
        self._threads = min(most, len(wiring.instances)) if can_share else 1
        self._pool: ThreadPoolExecutor | None = None
        # time of a step without threads; the first batch is slower, and is not counted
        self._single_s, self._has_run = 0.0, False

    def run(self, first: int, last: int) -> int:
        """Implements `LoopFunctions.run`."""
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
        # imported here: few runs have steps that are long enough for threads
        from concurrent.futures import ThreadPoolExecutor

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

    @property
    def have_shared(self) -> bool:
        """Whether any steps were shared."""
        return self._pool is not None

    def close(self) -> None:
        if self._pool:
            self._pool.shutdown()
