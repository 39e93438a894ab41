"""What runs the samples of a sweep takes them in batches, each of about the same time."""

import math
from collections import deque
from collections.abc import Generator, Iterable, Sequence
from itertools import islice
from typing import NamedTuple, Protocol

from fmus.fmi_types import FmiValue
from orchestration.sweep.plan import Plan
from orchestration.sweep.samples import BATCH_S, Job, Outcome

_MOST_OF_A_BATCH = 1000
_SPREAD = 3  # of what is left for a worker it takes this part, so that all end at about the same time


class Finished(NamedTuple):
    """Samples that were run: their numbers, what was varied, and the outcome of each."""

    numbers: Sequence[int]
    values: Sequence[dict[str, FmiValue]]
    outcomes: Sequence[Outcome]


class Workers(Protocol):
    """Runs samples side by side; an iterator that is closed early stops them."""

    def run(self, plan: Plan, job: Job, missing: "Batches") -> Generator[Finished, None, None]: ...


class Batches:
    """Samples to hand out, as many at once as take about a quarter of a second."""

    def __init__(self, samples: Iterable[int], count: int) -> None:
        self._samples, self.left, self._sample_s = iter(samples), count, math.inf
        self._returned: deque[int] = deque()

    def take(self, workers: int, group: int = 1, most: int = _MOST_OF_A_BATCH) -> list[int]:
        """The next samples for one of so many workers; none if none are left.

        group: how many run at once: batches are whole groups, until the last; most: of a batch
        """
        share = math.ceil(self.left / (_SPREAD * workers))
        count = max(1, min(int(BATCH_S / self._sample_s), share, most))
        count = max(group, count - count % group)
        batch = [self._returned.popleft() for _ in range(min(count, len(self._returned)))]
        batch += islice(self._samples, count - len(batch))
        self.left -= len(batch)
        return batch

    def note(self, count: int, seconds: float, rest: Sequence[int] = ()) -> None:
        """How long so many samples took, one after another; rest: of their batch, to hand out again."""
        self._sample_s = max(seconds / count, 1e-9)
        self._returned += rest
        self.left += len(rest)
