"""Wall time of the phases of a run, and of the steps of each FMU in it."""

import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np


class RunStatistics:
    """Statistics of one run: the wall time [s] of each phase, and the steps of each FMU.

    steps: shape (2, FMUs), how many steps each made and their wall time [s]; the loop adds to it
    start_time: simulated time [s] from which the run stepped
    """

    def __init__(self, components: Iterable[str]) -> None:
        self._components = tuple(components)
        self.steps = np.zeros((2, len(self._components)))
        self.start_time = 0.0
        self._phases: dict[str, float] = {}

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Measures what happens in the context; it may fail."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self._phases[name] = time.perf_counter() - start

    def report(self, end_time: float, is_sequential: bool) -> dict[str, Any]:
        """Returns phases and FMUs for the provenance of a recording, without a step the phases alone.

        end_time: simulated time [s] that was reached
        is_sequential: whether FMUs stepped one after another; the rest of the loop is the time between them
        """
        if "stepping" not in self._phases:
            return {"phases_s": self._phases}
        stepping, simulated = self._phases["stepping"], end_time - self.start_time
        counts, times = self.steps.tolist()
        rest = {"rest_of_loop_s": stepping - sum(times)} if is_sequential else {}
        return {
            "phases_s": self._phases,
            "simulated_s": simulated,
            "real_time_factor": simulated / stepping,
            "fmus": {
                name: {"steps": int(count), "wall_s": wall}
                for name, count, wall in zip(self._components, counts, times, strict=True)
            },
            **rest,
        }
