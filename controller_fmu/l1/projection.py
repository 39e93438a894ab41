"""Smooth projection operator over a centred box, one parameter at a time.

    f(th)  = ((1 + eps) th^2 - th_max^2) / (eps th_max^2)
    Proj(th, y) = y (1 - f)   where f > 0 and th y > 0,   else y

`th` is the estimate, `y` its unprojected rate, `th_max` the hard bound (f = 1) and `eps` sets the
width of the boundary layer: it begins (f = 0) at th_max / sqrt(1 + eps).
Source: Maalouf et al. (2013), (4), with the estimate as first argument (docs/fidelity.md).
"""

from fmus.numerics import clip, logical_and, maximum, where

# keeps f finite for a parameter with a bound of 0
_SMALLEST_BOUND = 1e-12


def boundary_function(estimate: float, bound: float, tolerance: float) -> float:
    """Returns f(th): at most 0 inside the boundary layer, 1 on the hard bound.

    Parameters
    ----------
    estimate : float
        th.
    bound : float
        th_max.
    tolerance : float
        eps.

    Returns
    -------
    float

    Examples
    --------
    >>> boundary_function(2.0, bound=2.0, tolerance=0.5)
    1.0
    """
    square = maximum(bound, _SMALLEST_BOUND) ** 2
    return ((1.0 + tolerance) * estimate * estimate - square) / (tolerance * square)


def projection_factor(estimate: float, rate: float, bound: float, tolerance: float) -> float:
    """Returns Proj(th, y) / y: 1 inside or when moving inwards, falling to 0 on the bound.

    Parameters
    ----------
    estimate : float
        th.
    rate : float
        y.
    bound : float
        th_max; 0 holds the parameter.
    tolerance : float
        eps.

    Returns
    -------
    float
    """
    f = boundary_function(estimate, bound, tolerance)
    outwards = logical_and(f > 0.0, estimate * rate > 0.0)
    factor = where(outwards, maximum(1.0 - f, 0.0), 1.0)
    return where(bound > 0.0, factor, 0.0)


def project(estimate: float, rate: float, bound: float, tolerance: float) -> float:
    """Returns Proj(th, y), the rate of an estimate that never leaves -th_max..th_max.

    Parameters
    ----------
    estimate, rate, bound, tolerance : float
        See `projection_factor`.

    Returns
    -------
    float

    Examples
    --------
    >>> project(0.0, 3.0, bound=2.0, tolerance=0.5), project(2.0, 3.0, bound=2.0, tolerance=0.5)
    (3.0, 0.0)
    """
    return rate * projection_factor(estimate, rate, bound, tolerance)


def keep_within(estimate: float, bound: float) -> float:
    """Returns the estimate limited to -bound..bound.

    Parameters
    ----------
    estimate, bound : float

    Returns
    -------
    float
    """
    # the exact flow only touches the bound, a finite step can pass it
    return clip(estimate, -bound, bound)
