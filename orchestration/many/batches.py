"""Runs are handed out in batches that take about the same time, and come back with the keys of the caller."""

import math
from collections import deque
from collections.abc import Generator, Iterable, Sequence
from itertools import islice
from typing import Protocol

from orchestration.many.job import Finished, Job, Run
from orchestration.many.runners import BATCH_S

_MOST_OF_A_BATCH = 1000
_SPREAD = 3  # of what is left for a worker it takes this part, so that all end at about the same time


class Place(Protocol):
    """Makes the runs of one job after another; a generator that is closed early stops them."""

    def runs(self, job: Job, batches: "Batches") -> Generator[list[Finished], None, None]: ...


class Batches:
    """Runs to hand out, as many at once as take about a quarter of a second."""

    def __init__(self, runs: Iterable[Run], count: int) -> None:
        self._runs, self.left, self._run_s = iter(runs), count, math.inf
        self._returned: deque[Run] = deque()

    def take(self, workers: int, group: int = 1, most: int = _MOST_OF_A_BATCH) -> list[Run]:
        """Returns the next runs for one of so many workers; none if none are left.

        group: how many run at once: batches are whole groups, until the last; most: of a batch
        """
        share = math.ceil(self.left / (_SPREAD * workers))
        count = max(1, min(int(BATCH_S / self._run_s), share, most))
        count = max(group, count - count % group)
        batch = [self._returned.popleft() for _ in range(min(count, len(self._returned)))]
        batch += islice(self._runs, count - len(batch))
        self.left -= len(batch)
        return batch

    def note(self, count: int, seconds: float, rest: Sequence[Run] = ()) -> None:
        """Notes how long so many runs took, one after another; rest: of their batch, to hand out again."""
        self._run_s = max(seconds / count, 1e-9)
        self._returned += rest
        self.left += len(rest)
