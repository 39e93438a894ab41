"""Real time: communication points are waited for, and those reached too late are counted."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field

_LONGEST_SLEEP_S = 0.1  # without a look at interrupts


@dataclass
class Pacing:
    """Simulated seconds go by at `factor` times the wall clock, from the first point that is waited for.

    missed: points reached later than that; worst: by how much at most [s of the wall clock];
    worst_at: at which point [s]
    """

    factor: float = 1.0
    missed: int = 0
    worst: float = 0.0
    worst_at: float = 0.0
    _zero: float | None = field(default=None, repr=False)

    def wait(self, t: float, check_interrupt: Callable[[], None]) -> None:
        """Until it is time for the communication point t [s]."""
        now = time.perf_counter()
        if self._zero is None:
            self._zero = now - t / self.factor
        late = now - (self._zero + t / self.factor)
        if late < 0.0:
            while (left := self._zero + t / self.factor - time.perf_counter()) > 0.0:
                time.sleep(min(left, _LONGEST_SLEEP_S))
                check_interrupt()
            return
        if late > 0.0:
            self.missed += 1
            if late > self.worst:
                self.worst, self.worst_at = late, t

    def report(self) -> dict[str, float | int]:
        return {
            "factor": self.factor,
            "missed_deadlines": self.missed,
            "worst_lateness_s": self.worst,
            "worst_at_s": self.worst_at,
        }
