"""The wall clock of a run: the time of its phases and of the steps of each FMU, and a run in real time."""

import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from orchestration.errors import SystemDefinitionError

_LONGEST_SLEEP_S = 0.1  # between two checks for an interrupt
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


@dataclass
class Pacing:
    """Simulated time passes at `factor` times the wall clock, from the first `wait` on.

    Raises SystemDefinitionError for a factor that is not more than 0.

    missed: number of points reached too late
    worst: largest lateness [s of the wall clock]; worst_at: simulated time of that point [s]
    """

    factor: float = 1.0
    missed: int = 0
    worst: float = 0.0
    worst_at: float = 0.0
    _zero: float | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        if not (math.isfinite(self.factor) and self.factor > 0.0):
            raise SystemDefinitionError(f"real time factor {self.factor!r}: expected more than 0")

    def wait(self, t: float, check_interrupt: Callable[[], None]) -> None:
        """Waits until it is time for the communication point t [s]."""
        now = time.perf_counter()
        if self._zero is None:
            self._zero = now - t / self.factor
        late = now - (self._zero + t / self.factor)
        if late < 0.0:
            while (left := self._zero + t / self.factor - time.perf_counter()) > 0.0:
                time.sleep(min(left, _LONGEST_SLEEP_S))
                check_interrupt()
        elif late > 0.0:
            self.missed += 1
            self.worst, self.worst_at = max((self.worst, self.worst_at), (late, t), key=lambda late: late[0])

    def report(self) -> dict[str, float | int]:
        """Returns the factor and the missed deadlines, for the provenance of a recording."""
        return {
            "factor": self.factor,
            "missed_deadlines": self.missed,
            "worst_lateness_s": self.worst,
            "worst_at_s": self.worst_at,
        }
