"""One loop measured in a process of its own: `python -m tests.speed.loops NAME FOLDER RESULT ENOUGH`.

N grows until the second N of 2 N steps take as many seconds as are enough, or are many. RESULT becomes a JSON
file.
"""

import json
import sys
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from statistics import median

from tests.speed.pair import Pair

_MOST_STEPS = 1 << 18
_GROWTH = 4
_REPEATS = 3


def main(name: str, folder: str, measurement: str, enough: str) -> None:
    run: Callable[[Pair, int], float] = import_module(f"{__package__}.{name}").run
    pair, steps = Pair(Path(folder)), 1 << 10
    run(pair, 16)  # what is imported or compiled once is paid for here
    while True:
        timed = [_timed(run, pair, count) for count in (steps, 2 * steps)]
        seconds, levels = zip(*timed, strict=True)
        if seconds[1] - seconds[0] >= float(enough) or steps >= _MOST_STEPS:
            break
        steps *= _GROWTH
    for _ in range(_REPEATS - 1):
        timed += [_timed(run, pair, count) for count in (steps, 2 * steps)]
    seconds = [median(time for time, _ in timed[place::2]) for place in (0, 1)]
    Path(measurement).write_text(json.dumps({"steps": steps, "seconds": seconds, "levels": levels}))


def _timed(run: Callable[[Pair, int], float], pair: Pair, steps: int) -> tuple[float, float]:
    begun = time.perf_counter()
    level = run(pair, steps)
    return time.perf_counter() - begun, level


if __name__ == "__main__":
    main(*sys.argv[1:])
