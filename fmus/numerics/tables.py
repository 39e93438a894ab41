"""Lines through points."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from fmus.numerics.choice import where


def ramps(t: Any, times: Sequence[Any], values: Sequence[Any], smooth: Any) -> Any:
    """Lines through (time, value) at time t, held before the first and after the last point.

    times: ascending, each later than the one before
    smooth: quintic ramps instead, 10 s^3 - 15 s^4 + 6 s^5: no first or second derivative at the points
    """
    points = list(zip(times, values, strict=True))
    value = points[-1][1]
    for (t_0, y_0), (t_1, y_1) in reversed(list(pairwise(points))):
        s = (t - t_0) / (t_1 - t_0)
        quintic = s**3 * (10.0 + s * (6.0 * s - 15.0))
        value = where(t <= t_1, y_0 + (y_1 - y_0) * where(smooth, quintic, s), value)
    return where(t <= points[0][0], points[0][1], value)
