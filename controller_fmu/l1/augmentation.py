"""The extension of the L1 adaptive controller: u_p, added behind the low-pass filter.

    PI            u_p = -K_P e - int K_I e dt                                     (7)
    nonlinear P   u_p = -a_1 |e|^alpha sgn(e)        where |e| > delta            (8)
                  u_p = -a_2 e / delta^(1 - alpha)   elsewhere

with the tracking error e = y - r. delta is fixed or a fraction of |r|, never below a floor.
Source: Maalouf et al. (2013); errata in docs/fidelity.md.
"""

from controller_fmu.l1.parameters import Threshold
from fmus.numerics import absolute, maximum, power, sign, where


def proportional_integral(e: float, integral: float, k_p: float) -> float:
    """Returns u_p of the PI, (7).

    Parameters
    ----------
    e : float
        Tracking error.
    integral : float
        int K_I e dt, in the unit of the control.
    k_p : float
        K_P.

    Returns
    -------
    float

    Examples
    --------
    >>> proportional_integral(0.5, integral=1.0, k_p=4.0)
    -3.0
    """
    return -k_p * e - integral


def threshold(kind: Threshold, delta: float, floor: float, r: float) -> float:
    """Returns the threshold of (8): delta, or delta |r|, at least `floor`.

    Parameters
    ----------
    kind : Threshold
    delta : float
        Threshold, or its ratio to |r|.
    floor : float
        Least threshold, above 0.
    r : float
        Reference.

    Returns
    -------
    float

    Examples
    --------
    >>> threshold(Threshold.PROPORTIONAL_TO_REFERENCE, 0.1, floor=0.01, r=-2.0)
    0.2
    """
    # (8) divides by the threshold, which would be 0 where the reference crosses 0
    return maximum(where(kind == Threshold.FIXED, delta, delta * absolute(r)), floor)


def nonlinear_proportional(e: float, delta: float, alpha: float, a_1: float, a_2: float) -> float:
    """Returns u_p of (8): low gain on large errors, high gain on small ones; continuous for a_1 = a_2.

    Parameters
    ----------
    e : float
        Tracking error.
    delta : float
        Threshold of |e|, above 0.
    alpha : float
        Exponent.
    a_1, a_2 : float
        Gains of large and small errors.

    Returns
    -------
    float

    Examples
    --------
    >>> nonlinear_proportional(4.0, delta=1.0, alpha=0.5, a_1=3.0, a_2=3.0)
    -6.0
    """
    large = a_1 * power(absolute(e), alpha) * sign(e)
    small = a_2 * e / power(delta, 1.0 - alpha)
    return -where(absolute(e) > delta, large, small)
