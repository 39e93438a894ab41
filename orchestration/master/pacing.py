"""Real time: the run waits for its communication points, and counts those that it reaches too late."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from orchestration.errors import SystemDefinitionError

_LONGEST_SLEEP_S = 0.1  # between two checks for an interrupt


@dataclass
class Pacing:
    """Simulated time passes at `factor` times the wall clock, from the first `wait` on.

    missed: number of points reached too late
    worst: largest lateness [s of the wall clock]; worst_at: simulated time of that point [s]
    """

    factor: float = 1.0
    missed: int = 0
    worst: float = 0.0
    worst_at: float = 0.0
    _zero: float | None = field(default=None, repr=False)

    def wait(self, t: float, check_interrupt: Callable[[], None]) -> None:
        """Wait until it is time for the communication point t [s]."""
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
        """The factor and the missed deadlines, for the provenance of a recording."""
        return {
            "factor": self.factor,
            "missed_deadlines": self.missed,
            "worst_lateness_s": self.worst,
            "worst_at_s": self.worst_at,
        }


def pacing_at(factor: float) -> Pacing:
    """A pacing of `factor` simulated seconds in a second; SystemDefinitionError if it is not more than 0."""
    if not (math.isfinite(factor) and factor > 0.0):
        raise SystemDefinitionError(f"real time factor {factor!r}: expected more than 0")
    return Pacing(factor)
