"""Statistics over plants: what one controller does on all of them, and how two differ, plant by plant.

A plant on which a controller has no value (its run ended early) counts as worse than any number in the
distribution of that controller, and is left out of pairs, whose number is given.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

TAIL = 0.05  # of the plants: the worst ones, of which CVaR is the mean
CONFIDENCE = 0.95
_RESAMPLES = 9999
_BOOTSTRAP_SEED = 1


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
    """A metric of two controllers on the same plants, the first minus the second.

    pairs: plants on which both have a value; low, high: 95 % interval of the median difference
    p: of Wilcoxon's signed-rank test, that the differences are symmetric about 0
    """

    pairs: int
    median_difference: float
    low: float
    high: float
    p: float


def distribution(values: npt.ArrayLike) -> OrderStatistics:
    """Returns median, 95th percentile and CVaR by order statistics: each value is one of the plants'."""
    ordered = np.sort(np.nan_to_num(np.asarray(values, float), nan=math.inf))
    median, p95 = np.quantile(ordered, (0.5, 1.0 - TAIL), method="inverted_cdf")
    worst = ordered[len(ordered) - math.ceil(TAIL * len(ordered)) :]
    return OrderStatistics(float(median), float(p95), float(worst.mean()))


def compare(first: npt.ArrayLike, second: npt.ArrayLike) -> PairedComparison:
    """Returns Wilcoxon's test and a bootstrap interval of the median difference, paired by plant."""
    from scipy import stats  # takes longer to import than the test takes

    differences = np.asarray(first, float) - np.asarray(second, float)
    differences = differences[np.isfinite(differences)]
    count = len(differences)
    if count < 2:
        return PairedComparison(count, math.nan, math.nan, math.nan, math.nan)
    median = float(np.median(differences))
    if not np.any(differences != differences[0]):
        return PairedComparison(count, median, median, median, 1.0 if median == 0.0 else 2.0 ** (1 - count))
    test: Any = stats.wilcoxon(differences)
    resampled = stats.bootstrap(
        (differences,),
        np.median,
        n_resamples=_RESAMPLES,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(_BOOTSTRAP_SEED),
    ).confidence_interval
    return PairedComparison(count, median, float(resampled.low), float(resampled.high), float(test.pvalue))


def holm(p_values: Mapping[str, float]) -> dict[str, float]:
    """Returns name -> p-value corrected for how many are tested together, in steps as of Holm (1979).

    The k-th smallest of m is multiplied by m - k + 1, and is not below those before it, nor above 1. What is
    not a number is no test, and stays.
    """
    tested = sorted((p, name) for name, p in p_values.items() if not math.isnan(p))
    corrected, largest = dict(p_values), 0.0
    for index, (p, name) in enumerate(tested):
        largest = max(largest, min(1.0, (len(tested) - index) * p))
        corrected[name] = largest
    return corrected
