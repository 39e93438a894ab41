"""The metrics of many runs at once: the numbers of each are those of `metrics.evaluate`, to the last bit."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from orchestration.results import metrics
from orchestration.results.recordings import OF_ALL, Recordings


def evaluate_all(
    recordings: Recordings, declared: Mapping[str, Mapping[str, Any]]
) -> list[dict[str, float] | None]:
    """The declared metrics of each run; None for a run of which `metrics.evaluate` raises an error."""
    columns = [_of_each_run(recordings, name, call) for name, call in declared.items()]
    rows = [[column[run] for column in columns] for run in range(len(recordings))]
    return [None if math.inf in map(abs, row) else dict(zip(declared, row, strict=True)) for row in rows]


def _of_each_run(recordings: Recordings, name: str, call: Mapping[str, Any]) -> Sequence[float]:
    """A metric of each run; infinite where it cannot be computed: an infinite one is an error too."""
    function = metrics.FUNCTIONS.get(call["function"])
    if function in OF_ALL and not recordings.first.texts:
        arguments = {key: value for key, value in call.items() if key not in ("function", "unit")}
        try:
            return function(recordings, **arguments).tolist()  # type: ignore[union-attr]
        except Exception:  # whatever the reason: that of each run is found alone
            pass
    return [_of_one(recordings, run, name, call) for run in range(len(recordings))]


def _of_one(recordings: Recordings, run: int, name: str, call: Mapping[str, Any]) -> float:
    try:
        return metrics.evaluate(recordings.run(run), {name: call})[name]
    except Exception:  # whatever the reason: a metric that fails is infinite
        return math.inf
