"""One thruster: voltage to force.

    v_s = sat(v, v_max),   v_d = sgn(v_s) max(|v_s| - v_0, 0)
    F_s = efficiency K r v_d ((1 - c) + c |v_d| / v_c),   r = 1 for v_d >= 0, the reverse ratio below
    F'  = sat((F_s - F) / T, R)
    force = s F,   s = clip(d / d_f, 0, 1)

K [N/V], dead zone v_0 [V], saturation v_max [V], lag T [s], efficiency 0..1 (1 healthy, 0 dead). The curve
is a line for c = 0 and quadratic for c = 1; at v_c [V] both give K v_c, so that K stays in N/V. R [N/s]
limits how fast the force changes, as the torque of a motor limits how fast its propeller speeds up. d [m]
is the depth of the propeller, d_f that from which its thrust is full; above it draws air (ventilation) and
loses thrust, here in proportion to its depth. An ideal thruster gives efficiency K v at once, in air too.
The paper's model is F = K u, (11); the rest is added here. The straight line of the ventilation stands for
curves that depend on the load too: Kozlowska et al., Time domain modeling of propeller forces due to
ventilation in static and dynamic conditions, Journal of Marine Science and Engineering 8, 2020.
"""

from dataclasses import dataclass

from fmus.numerics import absolute, clip, exp, logical_and, logical_not, maximum, sign, where

_SHORTEST_LAG = 1e-9  # s; what is shorter counts as no lag
_LEAST_RATE = 1e-9  # N/s; what is less counts as no limit
_LEAST_DEPTH = 1e-9  # m; what is less counts as no ventilation


@dataclass(frozen=True)
class Thruster:
    """Thruster; `ideal` switches all but the gain off.

    reverse_ratio: gain of negative voltages over that of positive ones
    curvature, curve_voltage: c and v_c [V]
    rate_limit: R [N/s]; 0 does not limit
    """

    gain: float
    dead_zone: float
    limit: float
    lag: float
    ideal: bool
    reverse_ratio: float = 1.0
    curvature: float = 0.0
    curve_voltage: float = 1.0
    rate_limit: float = 0.0


def steady_force(thruster: Thruster, voltage: float, efficiency: float) -> float:
    """Returns the force [N] at which the submerged thruster settles under a constant voltage."""
    saturated = clip(voltage, -thruster.limit, thruster.limit)
    size = maximum(absolute(saturated) - thruster.dead_zone, 0.0)
    curve = (1.0 - thruster.curvature) + thruster.curvature * size / thruster.curve_voltage
    ratio = where(saturated < 0.0, thruster.reverse_ratio, 1.0)
    real = sign(saturated) * size * (curve * ratio)
    return efficiency * thruster.gain * where(thruster.ideal, voltage, real)


def force_after(thruster: Thruster, force: float, steady: float, elapsed: float) -> float:
    """Returns the force [N] `elapsed` s after it was `force`: the exact answer of limit and lag to a voltage.

    Where the lag alone would change the force faster than R, it changes by R a second until it would not.
    """
    lag = where(thruster.ideal, 0.0, thruster.lag)
    rate = maximum(thruster.rate_limit, _LEAST_RATE)
    is_limited = logical_and(logical_not(thruster.ideal), thruster.rate_limit > _LEAST_RATE)
    away = force - steady
    limited = where(is_limited, maximum(absolute(away) / rate - lag, 0.0), 0.0)  # s
    begins = where(is_limited, clip(away, -rate * lag, rate * lag), away)
    # s; of slope 1 at 0, which a maximum has not
    lagging = where(elapsed < limited, 0.0, elapsed - limited)
    left = where(is_limited, _left(lag, lagging), _left(lag, elapsed))
    return where(elapsed < limited, force - sign(away) * rate * elapsed, steady + begins * left)


def _left(lag: float, elapsed: float) -> float:
    """Returns the share that is left of a difference after some time [s], 1 at its start."""
    return where(lag > _SHORTEST_LAG, exp(-elapsed / maximum(lag, _SHORTEST_LAG)), 0.0)


def submerged_share(depth: float, full_depth: float, ideal: bool) -> float:
    """Returns the share of thrust that a propeller gives at a depth [m]; 1 from `full_depth` on or if 0."""
    share = clip(depth / maximum(full_depth, _LEAST_DEPTH), 0.0, 1.0)
    return where(logical_and(logical_not(ideal), full_depth > _LEAST_DEPTH), share, 1.0)
