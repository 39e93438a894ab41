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


@contextmanager
def kept_interrupts() -> Iterator[list[float]]:
    """Interrupts only leave their time [s of time.monotonic] in the list given.

    Outside the main thread, which receives no interrupts, nothing is changed.
    """
    received: list[float] = []
    if threading.current_thread() is not threading.main_thread():
        yield received
        return
    before = signal.signal(signal.SIGINT, lambda number, frame: received.append(time.monotonic()))
    try:
        yield received
    finally:
        signal.signal(signal.SIGINT, before)
