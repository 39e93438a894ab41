"""Alpha-beta observer of depth and its rate, in Penoyer's predict/correct form.

    predict   z_p = z_hat + T v_hat
    correct   z_hat = z_p + alpha (z - z_p),   v_hat = v_hat + beta / T (z - z_p)

Source: R. Penoyer, "The alpha-beta filter", C User's Journal 11(7), 1993, named by the paper; its
gains and sampling period are not published.
"""

from dataclasses import dataclass
from enum import IntEnum

from fmus.numerics import maximum, where


class VelocitySource(IntEnum):
    """Where the controller takes the depth rate from."""

    ALPHA_BETA_OBSERVER = 1
    MEASURED = 2


@dataclass(frozen=True)
class ObserverState:
    """Estimated depth [m], estimated depth rate [m/s] and time of the next sample [s]."""

    depth: float = 0.0
    rate: float = 0.0
    next_sample: float = 0.0


def correct(
    observer: ObserverState, measured: float, alpha: float, beta: float, period: float
) -> ObserverState:
    """The estimates after one sample taken `period` s after the last."""
    predicted = observer.depth + period * observer.rate
    innovation = measured - predicted
    return ObserverState(
        depth=predicted + alpha * innovation,
        rate=observer.rate + beta / period * innovation,
        next_sample=observer.next_sample + period,
    )


def sample_when_due(
    t: float, observer: ObserverState, measured: float, alpha: float, beta: float, period: float
) -> ObserverState:
    """`correct` if a sample is due at time t, else the observer as it was."""
    due = t >= observer.next_sample - 1e-6 * period  # t and the clock round differently
    sampled = correct(observer, measured, alpha, beta, period)
    return ObserverState(
        depth=where(due, sampled.depth, observer.depth),
        rate=where(due, sampled.rate, observer.rate),
        next_sample=where(due, maximum(sampled.next_sample, t + 0.5 * period), observer.next_sample),
    )
