"""Metrics of a run, and whether it failed; statistics over many runs; how two controllers differ, run by run.

A run in which a controller has no value (it ended early) counts as worse than any number in the distribution
of that controller, and is left out of pairs, whose number is given.
"""

import math
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from orchestration.results.metrics import evaluate
from orchestration.results.recording import Recording
from orchestration.scenarios.actuators import Actuators
from orchestration.score.protocol import Case, Protocol, metric_of
from orchestration.score.protocol_format import SIGNALS

_TRACED = ("depth", "reference", "u")
_TRACE_PERIOD_S = 0.5

Trace = dict[str, list[float]]
"""time [s], depth [m], reference [m] and u [N] of a run, every half second."""


def judged(runs: Recording, compute: Callable[[Recording], Any], **of_signals: Any) -> list[Any]:
    """Returns what a function computes of the `judged_signals` of each run; of_signals: their arguments."""
    return [compute(judged_signals(runs.run(i), **of_signals)) for i in range(len(runs.values))]


def judged_signals(
    recording: Recording, columns: Sequence[str], actuators: Actuators, stride: int = 1
) -> Recording:
    """Returns the recording with the signals that metrics are computed of (`SIGNALS`) in place of its own.

    columns: names of reference, depth and actuators. Of actuators that take a force, voltage and power are
    not a number. stride: of the communication points that are judged
    """
    reference, depth, *inputs = (recording[name] for name in columns)
    given = np.column_stack(inputs)
    delivered, is_limited = actuators.delivered(given), np.isfinite(actuators.ranges).all()
    unknown = np.full_like(depth, math.nan)
    values = {
        "depth": depth,
        "reference": reference,
        "u": actuators.force(delivered),
        "voltage": np.abs(given).max(axis=1) if actuators.in_volts else unknown,
        "power": (delivered**2).sum(axis=1) if actuators.in_volts else unknown,
        "saturated": 100.0 * actuators.is_saturated(given) if is_limited else unknown,
    }
    table = np.column_stack([values[name] for name in SIGNALS])
    time, table = recording.time[::stride], table[::stride]
    return Recording(tuple(SIGNALS), tuple(SIGNALS.values()), time, table, recording.provenance)


def all_signals(signals: Recording) -> Recording:
    """Returns the signals, of which nothing is computed where the run is made."""
    return signals


def declared(case: Case, protocol: Protocol, names: Collection[str] = ()) -> dict[str, dict[str, Any] | None]:
    """Returns name -> declaration of the metrics of a case, all or those named; None if it cannot happen."""
    return {
        name: metric_of(table, case) if case.target.moves or not table.of_motion else None
        for name, table in protocol.metrics.items()
        if not names or name in names
    }


def metrics_of(signals: Recording, metrics: Mapping[str, Mapping[str, Any] | None]) -> dict[str, float]:
    """Returns name -> metric of a run; not a number for what did not happen.

    signals: as `judged_signals` gives them; metrics: as `declared` gives them
    """
    values = evaluate(signals, {name: metric for name, metric in metrics.items() if metric})
    return {name: values.get(name, math.nan) for name in metrics}


def traced_metrics(
    signals: Recording, metrics: Mapping[str, Mapping[str, Any] | None], traced: bool
) -> tuple[dict[str, float], Trace]:
    """Returns the metrics of a run, and what is drawn of it where it is traced."""
    stride = max(1, round(_TRACE_PERIOD_S / (signals.time[1] - signals.time[0])))
    columns = {name: signals[name][::stride] for name in ("time", *_TRACED)} if traced else {}
    return metrics_of(signals, metrics), {n: np.round(column, 5).tolist() for n, column in columns.items()}


def failures(metrics: Mapping[str, float], protocol: Protocol) -> list[str]:
    """Returns why a run failed: what did not happen, and what is above its limit; empty if it did not."""
    reasons = ["not settled"] if math.isnan(metrics.get("settling_time", 0.0)) else []
    for name, limit in protocol.tables.failure.items():
        if metrics.get(name, 0.0) > limit:
            table = protocol.metrics[name]
            reasons.append(f"{table.title.lower()} {metrics[name]:.3g} {table.unit}")
    return reasons


TAIL = 0.05  # of the plants: the worst ones, of which CVaR is the mean
CONFIDENCE = 0.95
Name = TypeVar("Name", bound=Hashable)
Verdict = Literal["lower", "equal", "higher", "open"]
# Of the lesser median: the seeds of one search agree if they come so near to each other
# (tune.LARGEST_SPREAD), so that a smaller difference may be that of two searches
EQUIVALENCE = 0.05


@dataclass(frozen=True)
class OrderStatistics:
    """Order statistics of a metric over the plants; infinite where plants without a value are part of it.

    median, p95: the least value that at least 50 % or 95 % of the plants do not exceed
    cvar: conditional value at risk at 95 %, the mean of the largest 5 % of the values
    """

    median: float
    p95: float
    cvar: float


@dataclass(frozen=True)
class PairedComparison:
    """A metric of two controllers in the same runs, the first minus the second.

    pairs: runs in which both have a value; interval: of the median difference
    margin: a difference below it counts as none, 5 % of the lesser median
    p: of Wilcoxon's signed-rank test, that the differences are symmetric about 0
    """

    pairs: int
    median_difference: float
    interval: tuple[float, float]
    margin: float
    verdict: Verdict
    p: float


def verdict_of(interval: tuple[float, float], margin: float) -> Verdict:
    """Returns the verdict of an interval: wholly within the margin, wholly beyond it, or neither."""
    low, high = interval
    if -margin < low and high < margin:
        return "equal"
    if high < -margin or low > margin:
        return "lower" if high < 0.0 else "higher"
    return "open"


def distribution(values: npt.ArrayLike) -> OrderStatistics:
    """Returns median, 95th percentile and CVaR by order statistics: each value is one of the plants'."""
    ordered = np.sort(np.nan_to_num(np.asarray(values, float), nan=math.inf))
    median, p95 = np.quantile(ordered, (0.5, 1.0 - TAIL), method="inverted_cdf")
    worst = ordered[len(ordered) - math.ceil(TAIL * len(ordered)) :]
    return OrderStatistics(float(median), float(p95), float(worst.mean()))


def paired(first: npt.ArrayLike, second: npt.ArrayLike, comparisons: int = 1) -> PairedComparison:
    """Returns Wilcoxon's test and the interval of the median difference between order statistics, by pairs.

    comparisons: so many intervals hold together with 95 % (Bonferroni)
    """
    from scipy import stats  # takes longer to import than the test takes

    pairs = np.array([first, second], float)
    pairs = pairs[:, np.isfinite(pairs).all(axis=0)]
    count, differences = pairs.shape[1], pairs[0] - pairs[1]
    if count < 2:
        return PairedComparison(count, math.nan, (math.nan, math.nan), math.nan, "open", math.nan)
    margin = EQUIVALENCE * float(np.median(pairs, axis=1).min())
    median = float(np.median(differences))
    level = 1.0 - (1.0 - CONFIDENCE) / comparisons
    ends = stats.quantile_test(differences, q=0, p=0.5).confidence_interval(level)
    interval = float(ends.low), float(ends.high)
    test: Any = stats.wilcoxon(differences) if np.any(differences) else None
    p = test.pvalue if test else 1.0
    return PairedComparison(count, median, interval, margin, verdict_of(interval, margin), float(p))


def proportion_interval(count: int, of: int) -> tuple[float, float]:
    """Returns the 95 % interval of a share by Clopper and Pearson (1934), which covers at least that."""
    from scipy import stats

    interval = stats.binomtest(count, of).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)


def ratios_to_best(values: npt.ArrayLike, ranked: Sequence[bool]) -> npt.NDArray[np.float64]:
    """Returns each value by the least of its problem among the ranked controllers (Dolan and More 2002).

    values: controllers x problems, not a number for a run that failed, whose ratio is infinite
    """
    given = np.nan_to_num(np.asarray(values, float), nan=math.inf)
    best = given[np.asarray(ranked, bool)].min(axis=0, initial=math.inf)
    return np.divide(given, best, out=np.full_like(given, math.inf), where=np.isfinite(given))


def profile(ratios: npt.NDArray[np.float64], limits: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Returns the share of problems with a ratio of at most each limit, controllers x limits."""
    return (ratios[:, :, np.newaxis] <= np.asarray(limits, float)).mean(axis=1)


def holm(p_values: Mapping[Name, float]) -> dict[Name, float]:
    """Returns name -> p-value corrected for how many are tested together, in steps as of Holm (1979).

    The k-th smallest of m is multiplied by m - k + 1, and is not below those before it, nor above 1. What is
    not a number is no test, and stays.
    """
    tested = sorted((name for name, p in p_values.items() if not math.isnan(p)), key=p_values.__getitem__)
    corrected, largest = dict(p_values), 0.0
    for index, name in enumerate(tested):
        largest = max(largest, min(1.0, (len(tested) - index) * p_values[name]))
        corrected[name] = largest
    return corrected
