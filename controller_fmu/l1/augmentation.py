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
    """Returns u_p from the tracking error and int K_I e dt, (7)."""
    return -k_p * e - integral


def threshold(kind: Threshold, delta: float, floor: float, r: float) -> float:
    """Returns delta, or delta |r|, but at least `floor`, which must be positive: (8) divides by it."""
    return maximum(where(kind == Threshold.FIXED, delta, delta * absolute(r)), floor)


def nonlinear_proportional(e: float, delta: float, alpha: float, a_1: float, a_2: float) -> float:
    """Returns u_p of (8): low gain on large errors, high gain on small ones; continuous where a_1 = a_2."""
    large = a_1 * power(absolute(e), alpha) * sign(e)
    small = a_2 * e / power(delta, 1.0 - alpha)
    return -where(absolute(e) > delta, large, small)
