"""Thruster: voltage to force, by a curve with few parameters or by a table, and its answer in time.

    v_s = sat(v, v_max),   v_d = sgn(v_s) max(|v_s| - v_0, 0)
    F_s = efficiency K r v_d ((1 - c) + c |v_d| / v_q),   r = 1 for v_d >= 0, the reverse ratio below
    F'  = sat((F_s - F) / T, R)
    force = s F,   s = clip(d / d_f, 0, 1)

    or by a table    F_s = efficiency n table(v_s)
    and behind it    force(s) / F(s) = (b_1 s + a_0) / (s^3 + a_2 s^2 + a_1 s + a_0)
                     x_1' = x_2,   x_2' = x_3,   x_3' = a_0 (F - x_1) - a_1 x_2 - a_2 x_3,
                     force = x_1 + b_1 / a_0 x_2

K [N/V], dead zone v_0 [V], saturation v_max [V], lag T [s], efficiency 0..1 (1 healthy, 0 dead). The curve
is a line for c = 0 and quadratic for c = 1; at v_q [V] both give K v_q, so that K stays in N/V. R [N/s]
limits how fast the force changes, as the torque of a motor limits how fast its propeller speeds up. d [m]
is the depth of the propeller, d_f the depth of its full thrust; above it draws air (ventilation) and loses
thrust, here in proportion to its depth. An ideal thruster gives efficiency K v at once, in air too.
The table is linear between its points and held outside; n is the number of thrusters that the voltage
drives. The transfer function has a gain of 1.
The paper's model is F = K u, (11); the rest is added here. The straight line of the ventilation replaces
curves that depend on the load, too: Kozlowska et al., Time domain modeling of propeller forces due to
ventilation in static and dynamic conditions, Journal of Marine Science and Engineering 8, 2020.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

from fmus.block import variable
from fmus.numerics import (
    absolute,
    clip,
    exp,
    interp,
    logical_and,
    logical_not,
    logical_or,
    maximum,
    power,
    sign,
    sin,
    sqrt,
    where,
)
from fmus.numerics import all as all_hold

# Pulse [us] and force [kgf] of a Blue Robotics T200 at 16 V: every tenth row of the public performance data
# of September 2019, and both ends of its dead band.
_T200_AT_16_V = (
    (1900, 5.25), (1860, 4.65), (1820, 3.82), (1780, 3.11), (1740, 2.43), (1700, 1.82), (1660, 1.28),
    (1620, 0.82), (1580, 0.40), (1540, 0.08), (1532, 0.04), (1528, 0.0), (1472, 0.0), (1468, -0.04),
    (1460, -0.07), (1420, -0.32), (1380, -0.65), (1340, -1.02), (1300, -1.44), (1260, -1.94), (1220, -2.45),
    (1180, -2.99), (1140, -3.66), (1100, -4.07),
)  # fmt: skip
# The map from volts to pulses is a choice, a line that falls: a positive voltage must push down, and forward
# thrust of the BlueROV2, the vehicle with this table, pushes up.
T200_VOLTAGE = tuple((1500.0 - pulse) * 12.0 / 400.0 for pulse, _ in _T200_AT_16_V)
T200_FORCE = tuple(0.0 - kgf * 9.80665 for _, kgf in _T200_AT_16_V)
"""Points of a table: voltage [V], and force [N], positive down."""

Pair = tuple[float, float]
Triple = tuple[float, float, float]
Table = tuple[float, ...]

_GUESS = "guess: the paper gives none"
# a parameter below these counts as 0, which leaves its effect out; the divisions by it stay finite
_SHORTEST_LAG = 1e-9  # s
_LEAST_RATE = 1e-9  # N/s
_LEAST_DEPTH = 1e-9  # m


@dataclass(frozen=True)
class ThrusterParameters:
    """Parameters of two thrusters; functions take the index i of one."""

    thruster_ideal: bool = variable(
        False,
        "Keeps only gain and efficiency of the thrusters: no dead zone, saturation or lag",
        variability="fixed",
    )
    thruster_gain: Pair = variable(
        (0.25, 0.25), "Force coefficient K of each thruster", unit="N/V", min=1e-6, max=1e6, source=_GUESS
    )
    thruster_dead_zone: Pair = variable(
        (0.0, 0.0), "Voltage below which a thruster gives no force", unit="V", min=0.0, max=1e6, source=_GUESS
    )
    thruster_voltage_limit: Pair = variable(
        (12.0, 12.0), "Largest voltage of each thruster", unit="V", min=1e-6, max=1e6, source=_GUESS
    )
    thruster_lag: Pair = variable(
        (0.05, 0.05), "Time constant of each thruster", unit="s", min=0.0, max=1e3, source=_GUESS
    )
    thruster_rate_limit: Pair = variable(
        (0.0, 0.0),
        "Largest change of a thruster's force in a second; 0 does not limit",
        unit="N/s",
        min=0.0,
        max=1e6,
        source="guess: none, the paper gives none",
    )
    thruster_reverse_ratio: Pair = variable(
        (1.0, 1.0),
        "Gain of negative voltages over the gain of positive ones",
        min=0.0,
        max=10.0,
        source="assumed: symmetric, as (11); other propellers give less in reverse, about 0.8 (guess)",
    )
    thruster_curvature: Pair = variable(
        (0.0, 0.0),
        "Share of the force that is quadratic in the voltage: 0 a line, 1 a parabola",
        min=0.0,
        max=1.0,
        source="published: a line, (11)",
    )
    thruster_curve_voltage: Pair = variable(
        (12.0, 12.0),
        "Voltage where line and parabola give the same force",
        unit="V",
        min=1e-6,
        max=1e6,
        source="guess: the largest voltage; without effect on a line",
    )
    thruster_tabulated: bool = variable(
        False,
        "Whether the table gives the force, in place of gain, dead zone, reverse ratio and curvature",
        variability="fixed",
        source="assumed: the paper has a straight line, (11)",
    )
    thruster_scale: Pair = variable(
        (1.0, 1.0),
        "Number of thrusters that a voltage drives: factor of the table's force",
        min=0.0,
        max=1e3,
        source="assumed: one thruster each",
    )
    thruster_table_voltage: Table = variable(
        T200_VOLTAGE,
        "Voltages of the table, ascending",
        unit="V",
        min=-1e6,
        max=1e6,
        source="chosen: it stands for a speed controller's pulse; 12 V (down) is 1100 us, -12 V (up) 1900 us",
    )
    thruster_table_force: Table = variable(
        T200_FORCE,
        "Force at each voltage of the table, positive down",
        unit="N",
        min=-1e6,
        max=1e6,
        source="published: Blue Robotics T200 at 16 V, September 2019, forward thrust up",
    )
    thruster_depth: float = variable(
        0.073,
        "Depth of the propellers below the vehicle's top",
        unit="m",
        min=-1e3,
        max=1e3,
        source="guess: half of the published 0.146 m; without effect but for ventilation",
    )
    thruster_full_depth: float = variable(
        0.0,
        "Least depth of a propeller without loss of thrust by ventilation; 0: no ventilation",
        unit="m",
        min=0.0,
        max=1e3,
        source="guess: left out, the paper gives none",
    )


def steady_force(p: ThrusterParameters, i: int, voltage: float, efficiency: float) -> float:
    """Returns the steady force of the submerged thruster under a constant voltage.

    Parameters
    ----------
    p : ThrusterParameters
    i : {0, 1}
        Index of the thruster.
    voltage : float
        Voltage [V].
    efficiency : float
        1 for a healthy thruster, 0 for a dead one.

    Returns
    -------
    float
        Force [N], positive down.

    Examples
    --------
    >>> steady_force(ThrusterParameters(), 0, 8.0, 1.0), steady_force(ThrusterParameters(), 0, 20.0, 1.0)
    (2.0, 3.0)
    """
    saturated = clip(voltage, -p.thruster_voltage_limit[i], p.thruster_voltage_limit[i])
    # Not by absolute and maximum: their derivative at 0 V is 0. Without a dead zone the slope there is the
    # gain, which directional derivatives must give.
    direction, zone = where(saturated < 0.0, -1.0, 1.0), p.thruster_dead_zone[i]
    beyond = direction * saturated - absolute(sign(saturated)) * zone
    size = where(direction * saturated < zone, 0.0, beyond)
    curvature = p.thruster_curvature[i]
    curve = (1.0 - curvature) + curvature * size / p.thruster_curve_voltage[i]
    ratio = where(saturated < 0.0, p.thruster_reverse_ratio[i], 1.0)
    real = direction * size * (curve * ratio)
    follows_table = logical_and(p.thruster_tabulated, logical_not(p.thruster_ideal))
    factor = where(follows_table, p.thruster_scale[i], p.thruster_gain[i])
    linear = where(p.thruster_ideal, voltage, real)
    points = p.thruster_table_voltage, p.thruster_table_force
    force_or_voltage = where(follows_table, lambda: interp(saturated, *points), linear)
    return efficiency * factor * force_or_voltage


def corners(
    p: ThrusterParameters, i: int, voltage: float, force: float, steady: float
) -> tuple[float, float, float, float]:
    """Returns event indicators: numbers that change their signs at corners of the force of a thruster.

    Parameters
    ----------
    p : ThrusterParameters
    i : {0, 1}
        Index of the thruster.
    voltage : float
        Voltage [V].
    force, steady : float
        Force behind limit and lag, and steady force of the voltage [N].

    Returns
    -------
    tuple of four floats
        Of the saturation [V]; of the points of a table, or the dead zone's end and reverse gain [V]; of the
        dead zone's other end [V]; of the limit of the force's rate [N]. Each is 1 without such a corner.
    """
    zone, ratio = p.thruster_dead_zone[i], p.thruster_reverse_ratio[i]
    has_zone, is_real = zone > 0.0, logical_not(p.thruster_ideal)
    follows_table = logical_and(is_real, p.thruster_tabulated)
    follows_curve = logical_and(is_real, logical_not(p.thruster_tabulated))
    has_end = logical_and(follows_curve, logical_or(has_zone, ratio != 1.0))
    points = p.thruster_table_voltage

    def at_points() -> float:
        outside = clip(voltage - clip(voltage, points[0], points[-1]), -0.5, 0.5)
        # the place among the points, up to half a point outside: its sine changes its sign at each point
        return sin(math.pi * (interp(voltage, points, tuple(map(float, range(len(points))))) + outside))

    rate, lag = p.thruster_rate_limit[i], maximum(p.thruster_lag[i], _SHORTEST_LAG)
    is_limited = logical_and(is_real, rate > _LEAST_RATE)
    return (
        where(is_real, p.thruster_voltage_limit[i] - absolute(voltage), 1.0),
        where(follows_table, at_points, where(has_end, voltage - zone, 1.0)),
        where(logical_and(follows_curve, has_zone), voltage + zone, 1.0),
        where(is_limited, absolute(force - steady) - rate * lag, 1.0),
    )


def table_ascends(p: ThrusterParameters) -> tuple:
    """Returns the requirement that the voltages of a table in use ascend.

    Parameters
    ----------
    p : ThrusterParameters

    Returns
    -------
    tuple
        Condition, and expectation in words.
    """
    ascend = all_hold(a < b for a, b in pairwise(p.thruster_table_voltage))
    is_left_out = logical_not(p.thruster_tabulated)
    return logical_or(is_left_out, ascend), "thruster_table_voltage: each above the one before"


def force_after(p: ThrusterParameters, i: int, force: float, steady: float, elapsed: float) -> float:
    """Returns the force some time later: the exact answer of limit and lag to a voltage.

    The force changes at the rate R as long as the lag alone would change it faster.

    Parameters
    ----------
    p : ThrusterParameters
    i : {0, 1}
        Index of the thruster.
    force : float
        Force before [N].
    steady : float
        Steady force of the voltage [N].
    elapsed : float
        Time since `force` [s].

    Returns
    -------
    float
        Force [N].
    """
    lag = where(p.thruster_ideal, 0.0, p.thruster_lag[i])
    rate = maximum(p.thruster_rate_limit[i], _LEAST_RATE)
    is_limited = logical_and(logical_not(p.thruster_ideal), p.thruster_rate_limit[i] > _LEAST_RATE)
    away = force - steady
    limited = where(is_limited, maximum(absolute(away) / rate - lag, 0.0), 0.0)  # s
    begins = where(is_limited, clip(away, -rate * lag, rate * lag), away)
    # s; not by maximum, whose derivative at 0 is not 1
    lagging = where(elapsed < limited, 0.0, elapsed - limited)
    left = where(is_limited, _left(lag, lagging), _left(lag, elapsed))
    return where(elapsed < limited, force - sign(away) * rate * elapsed, steady + begins * left)


def present_forces(p: ThrusterParameters, forces: Pair, steady: Pair) -> Pair:
    """Returns the forces behind limit and lag; without either, the forces of the voltages.

    Parameters
    ----------
    p : ThrusterParameters
    forces : tuple of two floats
        Forces behind limit and lag [N].
    steady : tuple of two floats
        Steady forces of the voltages [N].

    Returns
    -------
    tuple of two floats
        Forces [N].
    """
    first, second = (where(is_moving(p, i), forces[i], steady[i]) for i in (0, 1))
    return first, second


def force_rates(p: ThrusterParameters, forces: Pair, steady: Pair) -> Pair:
    """Returns F' of each thruster by limit and lag; 0 without either.

    Parameters
    ----------
    p : ThrusterParameters
    forces : tuple of two floats
        Forces behind limit and lag [N].
    steady : tuple of two floats
        Steady forces of the voltages [N].

    Returns
    -------
    tuple of two floats
        Rates [N/s].
    """
    first, second = (_force_rate(p, i, forces[i], steady[i]) for i in (0, 1))
    return first, second


def _force_rate(p: ThrusterParameters, i: int, force: float, steady: float) -> float:
    away, limit = force - steady, maximum(p.thruster_rate_limit[i], _LEAST_RATE)
    rate = -away / maximum(p.thruster_lag[i], _SHORTEST_LAG)
    is_limited = p.thruster_rate_limit[i] > _LEAST_RATE
    return where(is_moving(p, i), where(is_limited, clip(rate, -limit, limit), rate), 0.0)


def is_moving(p: ThrusterParameters, i: int) -> bool:
    """Whether the force follows the voltage by a limit or a lag, and not at once.

    Parameters
    ----------
    p : ThrusterParameters
    i : {0, 1}
        Index of the thruster.

    Returns
    -------
    bool
    """
    has_rate = logical_or(p.thruster_lag[i] > _SHORTEST_LAG, p.thruster_rate_limit[i] > _LEAST_RATE)
    return logical_and(logical_not(p.thruster_ideal), has_rate)


def _left(lag: float, elapsed: float) -> float:
    """Returns the remaining share of a difference after some time [s], 1 at its start."""
    return where(lag > _SHORTEST_LAG, exp(-elapsed / maximum(lag, _SHORTEST_LAG)), 0.0)


@dataclass(frozen=True)
class Transfer:
    """Coefficients of a transfer function with a gain of 1.

    Parameters
    ----------
    b_1 : float
        Of the numerator [1/s2].
    a_2, a_1, a_0 : float
        Of the denominator [1/s], [1/s2], [1/s3]; a_0 = 0 leaves the function out.
    """

    b_1: float
    a_2: float
    a_1: float
    a_0: float

    def rates(self, x: Triple, steady: float) -> Triple:
        """Returns x' at a state x.

        Parameters
        ----------
        x : tuple of three floats
            State [N], [N/s], [N/s2].
        steady : float
            Steady force F [N].

        Returns
        -------
        tuple of three floats
            x' [N/s], [N/s2], [N/s3].
        """
        third = self.a_0 * (steady - x[0]) - self.a_1 * x[1] - self.a_2 * x[2]
        return where(self.a_0 > 0.0, (x[1], x[2], third), (0.0, 0.0, 0.0))

    def force(self, x: Triple, steady: float) -> float:
        """Returns the force at a state x.

        Parameters
        ----------
        x : tuple of three floats
            State [N], [N/s], [N/s2].
        steady : float
            Steady force F [N], which is the force if the function is left out.

        Returns
        -------
        float
            Force [N].
        """
        # C may divide before it chooses
        divisor = where(self.a_0 > 0.0, self.a_0, 1.0)
        return where(self.a_0 > 0.0, lambda: x[0] + self.b_1 / divisor * x[1], steady)

    def requirements(self, step: float) -> tuple:
        """Returns the requirements: the function is stable, and Runge-Kutta steps resolve its poles.

        Parameters
        ----------
        step : float
            Step [s].

        Returns
        -------
        tuple
            Condition and expectation in words of each.
        """
        is_stable = logical_and(self.a_2 > 0.0, self.a_2 * self.a_1 > self.a_0)  # Routh and Hurwitz
        fastest = maximum(maximum(self.a_2, sqrt(self.a_1)), power(self.a_0, 1.0 / 3.0))
        is_left_out = self.a_0 <= 0.0
        return (
            (logical_or(is_left_out, is_stable), "thruster_transfer stable: a_2 a_1 > a_0 and a_2 above 0"),
            (
                logical_or(is_left_out, step * fastest <= 1.0),
                "internal_step at most 1 / a_2, 1 / sqrt(a_1) and 1 / cbrt(a_0) of thruster_transfer",
            ),
        )


def ventilation_crossings(depth: float, p: ThrusterParameters) -> tuple[float, float]:
    """Returns the distances of propellers below the depths where thrust begins, and where it is full.

    Parameters
    ----------
    depth : float
        Depth of the vehicle [m].
    p : ThrusterParameters

    Returns
    -------
    tuple of two floats
        Distances [m]; 1 without ventilation.
    """
    is_ventilated = logical_and(logical_not(p.thruster_ideal), p.thruster_full_depth > _LEAST_DEPTH)
    of_propeller = depth + p.thruster_depth
    return (
        where(is_ventilated, of_propeller, 1.0),
        where(is_ventilated, of_propeller - p.thruster_full_depth, 1.0),
    )


def submerged_share(depth: float, p: ThrusterParameters) -> float:
    """Returns the share of thrust that the propellers of a vehicle give at its depth.

    Parameters
    ----------
    depth : float
        Depth of the vehicle [m].
    p : ThrusterParameters

    Returns
    -------
    float
        0 to 1.
    """
    full_depth = p.thruster_full_depth
    share = clip((depth + p.thruster_depth) / maximum(full_depth, _LEAST_DEPTH), 0.0, 1.0)
    return where(logical_and(logical_not(p.thruster_ideal), full_depth > _LEAST_DEPTH), share, 1.0)
