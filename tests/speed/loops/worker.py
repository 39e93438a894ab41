"""One loop measured, in a process of its own."""

import os
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from statistics import median

from fmus.process import Parent
from tests.speed.pair import Pair

_MOST_STEPS = 1 << 18
_GROWTH = 4
_REPEATS = 3


def measure_loop(parent: Parent) -> None:
    """Measure what is sent: (loop, pair, enough); send (steps, seconds, levels) of N and 2 N steps.

    N grows until the second N of 2 N steps take `enough` seconds, or are many.
    """
    name, pair, enough = parent.receive()
    os.chdir(tempfile.gettempdir())  # some leave files behind
    run: Callable[[Pair, int], float] = import_module(f"{__package__}.{name}").run
    steps = 1 << 10
    run(pair, 16)  # what is imported or compiled once is paid for here
    while True:
        timed = [_timed(run, pair, count) for count in (steps, 2 * steps)]
        if timed[1][0] - timed[0][0] >= enough or steps >= _MOST_STEPS:
            break
        steps *= _GROWTH
    for _ in range(_REPEATS - 1):
        timed += [_timed(run, pair, count) for count in (steps, 2 * steps)]
    seconds = tuple(median(time for time, _ in timed[first::2]) for first in (0, 1))
    parent.send((steps, seconds, tuple(level for _, level in timed[:2])))


def _timed(run: Callable[[Pair, int], float], pair: Pair, steps: int) -> tuple[float, float]:
    start = time.perf_counter()
    level = run(pair, steps)
    return time.perf_counter() - start, level
