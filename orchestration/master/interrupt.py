"""Interrupts that wait: one inside an FMU would look like the FMU's own failure."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def deferred_interrupt() -> Iterator[Callable[[], None]]:
    """Keep an interrupt until the function given is called: it must not strike inside an FMU.

    Outside the main thread, which receives no interrupts, nothing is changed.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    received: list[int] = []

    def check_interrupt() -> None:
        if received:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, lambda number, frame: received.append(number))
    try:
        yield check_interrupt
    finally:
        signal.signal(signal.SIGINT, before)
