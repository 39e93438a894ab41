"""One thruster: voltage to force.

    v_s = sat(v, v_max),   v_d = sgn(v_s) max(|v_s| - v_0, 0)
    F'  = (efficiency K v_d - F) / T

K [N/V], dead zone v_0 [V], saturation v_max [V], lag T [s], efficiency 0..1 (1 healthy, 0 dead). An ideal
thruster gives efficiency K v at once. The paper's model is F = K u, (11); the rest is added here.
"""

from dataclasses import dataclass

from fmus.numerics import absolute, clip, exp, maximum, sign, where

_SHORTEST_LAG = 1e-9  # s; what is shorter counts as no lag


@dataclass(frozen=True)
class Thruster:
    """What characterises a thruster; `ideal` switches dead zone, saturation and lag off."""

    gain: float
    dead_zone: float
    limit: float
    lag: float
    ideal: bool


def steady_force(thruster: Thruster, voltage: float, efficiency: float) -> float:
    """Force [N] that the thruster settles at under a constant voltage."""
    saturated = clip(voltage, -thruster.limit, thruster.limit)
    real = sign(saturated) * maximum(absolute(saturated) - thruster.dead_zone, 0.0)
    return efficiency * thruster.gain * where(thruster.ideal, voltage, real)


def force_after(thruster: Thruster, force: float, steady: float, elapsed: float) -> float:
    """Force [N] `elapsed` s after it was `force`: the exact answer of the lag to a held voltage."""
    lag = where(thruster.ideal, 0.0, thruster.lag)
    left = where(lag > _SHORTEST_LAG, exp(-elapsed / maximum(lag, _SHORTEST_LAG)), 0.0)
    return steady + (force - steady) * left
