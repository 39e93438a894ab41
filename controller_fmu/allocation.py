"""Allocation of a demanded vertical force to two thruster voltages, and its inverse.

    F = T^+ J' tau,   u = K^-1 F    with K = diag(k_1, k_2) [N/V], T = [1, 1], T^+ = [1/2, 1/2]

The force F of each is half of J tau, limited to its force at the largest voltage. A table in place of k
inverts the curve of thrusters: it has the force at the voltage. Where the force changes its sign the voltage
jumps over the dead band; it is 0 V for a force of exactly 0.

Force and moment together, of thrusters at x_1 > 0 > x_2 forward of the centre of gravity, bow up positive:

    F_1 + F_2 = F,   -x_1 F_1 - x_2 F_2 = M   gives   F_1 = s_1 F - m,   F_2 = s_2 F + m
    s_1 = -x_2 / (x_1 - x_2),   s_2 = x_1 / (x_1 - x_2),   m = M / (x_1 - x_2)

Where a thruster's limit allows only one of them, the other gives way: `limited`.

tau is the demand in the earth frame, J = cos(roll) cos(pitch). T is 1x2, so its inverse is a
pseudo-inverse. Source: Maalouf et al. (2013), section 4.3 and (11).
"""

from collections.abc import Sequence

from fmus.numerics import clip, cos, interp, maximum, minimum, where

Pair = tuple[float, float]
# a vehicle on its side cannot push vertically; keeps the inverse finite
_SMALLEST_J = 0.1


def body_to_earth(roll: float, pitch: float) -> float:
    """Returns J = cos(roll) cos(pitch).

    Parameters
    ----------
    roll, pitch : float
        Angles [rad].

    Returns
    -------
    float
    """
    return cos(roll) * cos(pitch)


def saturate(voltages: Pair, limit: float) -> Pair:
    """Returns the voltages limited to -limit..limit.

    Parameters
    ----------
    voltages : tuple of two floats
        Demanded voltages [V].
    limit : float
        Largest voltage [V].

    Returns
    -------
    tuple of two floats
        Voltages [V].
    """
    return clip(voltages[0], -limit, limit), clip(voltages[1], -limit, limit)


def force(forces: Pair, j: float) -> float:
    """Returns the force tau = T F / J of thrusters in the earth frame.

    Parameters
    ----------
    forces : tuple of two floats
        Force F of each thruster along the body's z axis [N].
    j : float
        J; a magnitude below 0.1 counts as 0.1.

    Returns
    -------
    float
        tau [N], positive down.

    Examples
    --------
    >>> force((1.0, 2.0), j=0.5)
    6.0
    """
    return (forces[0] + forces[1]) / where(j < 0.0, minimum(j, -_SMALLEST_J), maximum(j, _SMALLEST_J))


def table_voltage(force: float, voltages: Sequence[float], forces: Sequence[float]) -> float:
    """Returns the voltage [V] of a force [N] by a table, held at its ends; 0 V for 0 N.

    Parameters
    ----------
    force : float
        Demanded force [N].
    voltages, forces : sequence of float
        Points of the table [V, N], ascending. A force of several points is a jump.

    Returns
    -------
    float

    Examples
    --------
    >>> table_voltage(2.0, voltages=(-12.0, -1.0, 1.0, 12.0), forces=(-4.0, 0.0, 0.0, 4.0))
    6.5
    """
    return where(force == 0.0, 0.0, lambda: interp(force, forces, voltages))


def shares(levers: Pair) -> Pair:
    """Returns the share s of a force for each thruster.

    Parameters
    ----------
    levers : tuple of two floats
        Levers x_1 > 0 > x_2 forward of the centre of gravity [m].

    Returns
    -------
    tuple of two floats
        s_1 and s_2, with a sum of 1.

    Examples
    --------
    >>> shares((0.5, -1.5))
    (0.75, 0.25)
    """
    span = levers[0] - levers[1]
    return -levers[1] / span, levers[0] / span


def limited(force: float, couple: float, share: Pair, ranges: tuple[Pair, Pair], heave_first: bool) -> Pair:
    """Returns the force F and the couple m within the range of the thrusters.

    Parameters
    ----------
    force, couple : float
        Demanded F [N] and m = M / (x_1 - x_2) [N].
    share : tuple of two floats
        Shares of `shares`.
    ranges : tuple of two pairs
        Lowest and highest force [N] of each thruster, of different signs.
    heave_first : bool
        Whether F is limited first, and m to the range that F leaves; else the other way.

    Returns
    -------
    tuple of two floats
        F [N] and m [N], unchanged if the thrusters can give both.

    Examples
    --------
    >>> limited(6.0, 2.0, (0.5, 0.5), ((-4.0, 4.0), (-4.0, 4.0)), heave_first=True)
    (6.0, 1.0)
    """
    (low_1, high_1), (low_2, high_2) = ranges
    s_1, s_2 = share

    def couple_beside(f: float) -> float:
        low = maximum(s_1 * f - high_1, low_2 - s_2 * f)
        return clip(couple, low, minimum(s_1 * f - low_1, high_2 - s_2 * f))

    def force_beside(m: float) -> float:
        low = maximum((m + low_1) / s_1, (low_2 - m) / s_2)
        return clip(force, low, minimum((m + high_1) / s_1, (high_2 - m) / s_2))

    largest_force = clip(force, low_1 + low_2, high_1 + high_2)
    largest_couple = clip(couple, s_1 * low_2 - s_2 * high_1, s_1 * high_2 - s_2 * low_1)
    return where(
        heave_first,
        lambda: (largest_force, couple_beside(largest_force)),
        lambda: (force_beside(largest_couple), largest_couple),
    )
