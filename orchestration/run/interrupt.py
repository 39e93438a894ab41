"""Interrupts that wait: one inside an FMU would look like the FMU's own failure."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], None]]:
    """Keep an interrupt until the function given is called: it must not strike inside an FMU."""
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
    times = before if isinstance(before, _InterruptTimes) else _InterruptTimes()
    signal.signal(signal.SIGINT, times)
    try:
        yield times
    finally:
        signal.signal(signal.SIGINT, before)
