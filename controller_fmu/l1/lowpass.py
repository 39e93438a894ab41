"""The low-pass filter of the control law, u_a(s) = -k D(s) v(s) with v = eta_hat - k_g r.

Two choices of D(s), given by their closed filter C(s) = k D / (1 + k D):

    first order   C(s) = w / (s + w)                        u_a' = -w v
    third order   C(s) = (3 w^2 s + w^3) / (s + w)^3        p_1' = -3 w p_1 - v
                                                            p_2' = p_1
                                                            u_a' = 3 w^2 p_1 + w^3 p_2

w is the filter bandwidth [rad/s].
Source: Maalouf et al. (2013), (6), with sigma_hat in eta_hat (docs/fidelity.md).
"""

from dataclasses import dataclass

from controller_fmu.anti_windup import widens
from controller_fmu.l1.parameters import FilterOrder
from fmus.block import variable
from fmus.numerics import where


@dataclass(frozen=True)
class FilterState:
    """State of the filter; p_1 and p_2 are 0 for the first order."""

    # u_a itself is a state: a change of w during a run makes no jump of the control
    u_a: float = variable(0.0, "Adaptive control u_a")
    p_1: float = variable(0.0, "State p_1 of the third order")
    p_2: float = variable(0.0, "State p_2 of the third order")


def midpoint_response(order: FilterOrder, w: float, filter: FilterState, half: float) -> tuple[float, float]:
    """Returns (free, gain) of u_a = free - gain v in the middle of a step.

    Parameters
    ----------
    order : FilterOrder
    w : float
        Bandwidth [rad/s].
    filter : FilterState
        State at the beginning of the step.
    half : float
        Half of the step [s].

    Returns
    -------
    tuple of two floats
        u_a without input, and the gain of the mean input v.

    Examples
    --------
    >>> midpoint_response(FilterOrder.FIRST, 2.0, FilterState(u_a=3.0), half=0.25)
    (3.0, 0.5)
    """
    slope = half * (3.0 * w**2 + half * w**3) / (1.0 + 3.0 * w * half)
    third = order == FilterOrder.THIRD
    free = filter.u_a + where(third, half * w**3 * filter.p_2 + slope * filter.p_1, 0.0)
    gain = where(third, half * slope, half * w)
    return free, gain


def advance(
    order: FilterOrder, w: float, filter: FilterState, half: float, v: float, saturation_error: float = 0.0
) -> FilterState:
    """Returns the filter after a step of the implicit midpoint rule.

    Parameters
    ----------
    order : FilterOrder
    w : float
        Bandwidth [rad/s].
    filter : FilterState
        State at the beginning of the step.
    half : float
        Half of the step [s].
    v : float
        Input in the middle of the step.
    saturation_error : float
        Delivered minus demanded control. A state whose change would widen it is held.

    Returns
    -------
    FilterState

    Examples
    --------
    >>> advance(FilterOrder.FIRST, 2.0, FilterState(u_a=3.0), half=0.25, v=2.0)
    FilterState(u_a=1.0, p_1=0.0, p_2=0.0)
    """
    free, gain = midpoint_response(order, w, filter, half)
    u_a = free - gain * v
    p_1 = (filter.p_1 - half * v) / (1.0 + 3.0 * w * half)
    p_2 = filter.p_2 + half * p_1
    third = order == FilterOrder.THIRD
    # u_a grows with every state, so the sign of each change decides whether it widens the error
    return FilterState(
        u_a=_held(filter.u_a, u_a, saturation_error),
        p_1=where(third, _held(filter.p_1, p_1, saturation_error), 0.0),
        p_2=where(third, _held(filter.p_2, p_2, saturation_error), 0.0),
    )


def _held(before: float, midway: float, saturation_error: float) -> float:
    """Returns the value after the step, or before it where the change would widen the saturation error."""
    return where(widens(saturation_error, midway - before), before, 2.0 * midway - before)
