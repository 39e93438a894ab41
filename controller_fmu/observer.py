"""Alpha-beta observer of depth and its rate, in Penoyer's predict/correct form.

    predict   z_p = z_hat + T v_hat
    correct   z_hat = z_p + alpha (z - z_p),   v_hat = v_hat + beta / T (z - z_p)

Source: R. Penoyer, "The alpha-beta filter", C User's Journal 11(7), 1993, named by the paper; its
gains and sampling period are not published.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

from fmus.block import variable
from fmus.numerics import Clock, sampled


class VelocitySource(IntEnum):
    """Source of the depth rate that the controller uses."""

    ALPHA_BETA_OBSERVER = 1
    MEASURED = 2


@dataclass(frozen=True)
class ObserverState:
    """State of the observer, in SI units.

    Parameters
    ----------
    clock : Clock
        Clock of its samples.
    """

    depth: float = variable(0.0, "Estimated depth")
    rate: float = variable(0.0, "Estimated depth rate")
    clock: Clock = Clock()


def correct(
    observer: ObserverState, measured: float, alpha: float, beta: float, period: float
) -> ObserverState:
    """Returns the estimates after one more sample.

    Parameters
    ----------
    observer : ObserverState
        Estimates at the last sample.
    measured : float
        Measured depth [m].
    alpha, beta : float
        Gains.
    period : float
        Time since the last sample [s].

    Returns
    -------
    ObserverState
        The clock is unchanged.

    Examples
    --------
    >>> correct(ObserverState(depth=1.0, rate=0.0), 1.5, alpha=0.5, beta=0.25, period=0.5)
    ObserverState(depth=1.25, rate=0.25, clock=Clock(start=0.0, count=0))
    """
    predicted = observer.depth + period * observer.rate
    innovation = measured - predicted
    return replace(
        observer,
        depth=predicted + alpha * innovation,
        rate=observer.rate + beta / period * innovation,
    )


def sample_when_due(
    t: float, observer: ObserverState, measured: float, alpha: float, beta: float, period: float
) -> ObserverState:
    """Returns the observer corrected if a sample is due, else unchanged.

    Parameters
    ----------
    t : float
        Time [s].
    observer : ObserverState
        Estimates at the last sample.
    measured : float
        Measured depth [m].
    alpha, beta : float
        Gains.
    period : float
        Sampling period [s].

    Returns
    -------
    ObserverState
    """
    return sampled(t, period, observer, correct(observer, measured, alpha, beta, period))
