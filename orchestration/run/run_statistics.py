"""Wall time of the phases of a run, and of the steps of each FMU in it."""

import time
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any

import numpy as np

_UNMEASURED = nullcontext()


class RunStatistics:
    """Statistics of one run: the wall time [s] of each phase, and the steps of each FMU.

    is_asked_for: whether there is a report; without one the loop counts and measures no steps
    steps: shape (2, FMUs), how many steps each made and their wall time [s], to which the loop adds; else 0
    start_time: simulated time [s] from which the run stepped
    """

    def __init__(self, components: Iterable[str], is_asked_for: bool = True) -> None:
        self._components, self._is_asked_for = tuple(components), is_asked_for
        self.steps: Any = np.zeros((2, len(self._components))) if is_asked_for else 0
        self.start_time = 0.0
        self._phases: dict[str, float] = {}

    def phase(self, name: str) -> AbstractContextManager[None]:
        """Returns a context that adds the time of what happens in it, which may fail."""
        return self._measured(name) if self._is_asked_for else _UNMEASURED

    @contextmanager
    def _measured(self, name: str) -> Iterator[None]:
        start = time.perf_counter()
        try:
            yield
        finally:
            self._phases[name] = self._phases.get(name, 0.0) + time.perf_counter() - start

    def report(self, end_time: float, is_sequential: bool) -> dict[str, Any]:
        """Returns phases and FMUs as an entry of a recording's provenance, without a step the phases alone.

        end_time: simulated time [s] that was reached
        is_sequential: whether FMUs stepped one after another; the rest of the loop is the time between them
        """
        if not self._is_asked_for:
            return {}
        if "stepping" not in self._phases:
            return {"statistics": {"phases_s": self._phases}}
        stepping, simulated = self._phases["stepping"], end_time - self.start_time
        counts, times = self.steps.tolist()
        rest = {"rest_of_loop_s": stepping - sum(times)} if is_sequential else {}
        statistics = {
            "phases_s": self._phases,
            "simulated_s": simulated,
            "real_time_factor": simulated / stepping,
            "fmus": {
                name: {"steps": int(count), "wall_s": wall}
                for name, count, wall in zip(self._components, counts, times, strict=True)
            },
            **rest,
        }
        return {"statistics": statistics}
