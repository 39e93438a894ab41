"""Waiting: an interrupt waits for the end of a step, and a run in real time for its communication points.

An interrupt inside an FMU would look like the FMU's own failure.
"""

import math
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from orchestration.errors import SystemDefinitionError


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], None]]:
    """Keeps an interrupt until the yielded function is called: it must not strike inside an FMU."""
    with kept_interrupts() as received:

        def check_interrupt() -> None:
            if received:
                raise KeyboardInterrupt

        yield check_interrupt
    check_interrupt()  # one that came after the last look


class _InterruptTimes(list[float]):
    """A handler of SIGINT that only records the times [s of time.monotonic] of interrupts."""

    def __call__(self, number: int, frame: object) -> None:
        self.append(time.monotonic())


@contextmanager
def kept_interrupts() -> Iterator[list[float]]:
    """Interrupts only leave their time [s of time.monotonic] in the list given.

    Inside another such context the list is that of the outer one, with the interrupts that came before.
    Outside the main thread, which receives no interrupts, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield []
        return
    before = signal.getsignal(signal.SIGINT)
    if isinstance(before, _InterruptTimes):
        yield before
        return
    times = _InterruptTimes()
    signal.signal(signal.SIGINT, times)
    try:
        yield times
    finally:
        signal.signal(signal.SIGINT, before)


_LONGEST_SLEEP_S = 0.1  # between two checks for an interrupt


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
