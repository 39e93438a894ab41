"""Statistics over many runs of a controller, and differences of two controllers, run by run.

A run without a value (it ended early) counts as worse than any number in the distribution of its controller.
Pairs leave it out and give the number of pairs.
"""

import math
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import numpy as np
import numpy.typing as npt

from fmus.extras import require

TAIL = 0.05  # share of the worst plants; CVaR is their mean
CONFIDENCE = 0.95
Name = TypeVar("Name", bound=Hashable)
Verdict = Literal["lower", "equal", "higher", "open"]
# Share of the smaller median. Seeds of one search agree if they come so near to each other
# (tune.LARGEST_SPREAD), so a smaller difference may come from the search alone.
EQUIVALENCE = 0.05


@dataclass(frozen=True)
class OrderStatistics:
    """Order statistics of a metric over the plants; infinite if they include a plant without a value.

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
    margin: smaller differences count as equal: 5 % of the smaller median
    p: of Wilcoxon's signed-rank test that the differences are symmetric about 0
    """

    pairs: int
    median_difference: float
    interval: tuple[float, float]
    margin: float
    verdict: Verdict
    p: float


def verdict_of(interval: tuple[float, float], margin: float) -> Verdict:
    """Returns "equal" for an interval within the margin, "lower" or "higher" beyond it, else "open"."""
    low, high = interval
    if -margin < low and high < margin:
        return "equal"
    if high < -margin or low > margin:
        return "lower" if high < 0.0 else "higher"
    return "open"


def distribution(values: npt.ArrayLike) -> OrderStatistics:
    """Returns median, 95th percentile and CVaR by order statistics."""
    ordered = np.sort(np.nan_to_num(np.asarray(values, float), nan=math.inf))
    median, p95 = np.quantile(ordered, (0.5, 1.0 - TAIL), method="inverted_cdf")
    worst = ordered[len(ordered) - math.ceil(TAIL * len(ordered)) :]
    return OrderStatistics(float(median), float(p95), float(worst.mean()))


def paired(first: npt.ArrayLike, second: npt.ArrayLike, comparisons: int = 1) -> PairedComparison:
    """Returns Wilcoxon's test and the interval of the median difference between order statistics, by pairs.

    comparisons: number of intervals that hold together with 95 % (Bonferroni)
    """
    # SciPy takes longer to import than the test takes
    stats: Any = require("scipy.stats", "study", "a comparison")

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
    """Returns the 95 % interval of a share by Clopper and Pearson (1934), which covers at least 95 %."""
    stats: Any = require("scipy.stats", "study", "a comparison")

    interval = stats.binomtest(count, of).proportion_ci(CONFIDENCE, method="exact")
    return float(interval.low), float(interval.high)


def ratios_to_best(values: npt.ArrayLike, ranked: Sequence[bool]) -> npt.NDArray[np.float64]:
    """Returns each value by the least of its problem among the ranked controllers (Dolan and More 2002).

    values: controllers x problems; NaN for a run that failed, whose ratio is infinite
    """
    given = np.nan_to_num(np.asarray(values, float), nan=math.inf)
    best = given[np.asarray(ranked, bool)].min(axis=0, initial=math.inf)
    return np.divide(given, best, out=np.full_like(given, math.inf), where=np.isfinite(given))


def profile(ratios: npt.NDArray[np.float64], limits: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Returns the share of problems with a ratio of at most each limit, controllers x limits."""
    return (ratios[:, :, np.newaxis] <= np.asarray(limits, float)).mean(axis=1)


def holm(p_values: Mapping[Name, float]) -> dict[Name, float]:
    """Returns name -> p-value corrected for the number of tests by the step-down method of Holm (1979).

    The k-th smallest of m is multiplied by m - k + 1, and is at least the one before it and at most 1. NaN is
    no test and stays NaN.
    """
    tested = sorted((name for name, p in p_values.items() if not math.isnan(p)), key=p_values.__getitem__)
    corrected, largest = dict(p_values), 0.0
    for index, name in enumerate(tested):
        largest = max(largest, min(1.0, (len(tested) - index) * p_values[name]))
        corrected[name] = largest
    return corrected
