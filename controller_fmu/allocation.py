"""Allocation of a demanded vertical force to two thruster voltages, and its inverse.

    F = T^+ J' tau,   u = K^-1 F    with K = diag(k_1, k_2) [N/V], T = [1, 1], T^+ = [1/2, 1/2]

The force F of each is half of J tau, limited to what it gives up to the largest voltage. A table in place of
k inverts the curve of thrusters: the voltage is that at which the table has the force. Where the force
changes its sign the voltage jumps over the dead band; it is 0 V for a force of exactly 0.

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
_SMALLEST_J = 0.1  # a vehicle on its side cannot push vertically; keeps the inverse finite


def body_to_earth(roll: float, pitch: float) -> float:
    """Returns J(roll, pitch) = cos(roll) cos(pitch), for angles in rad."""
    return cos(roll) * cos(pitch)


def saturate(voltages: Pair, limit: float) -> Pair:
    """Returns the voltages limited to -limit..limit."""
    return clip(voltages[0], -limit, limit), clip(voltages[1], -limit, limit)


def force(forces: Pair, j: float) -> float:
    """Returns the force [N] in the earth frame that thrusters give: tau = T F / J, with |J| kept from 0."""
    return (forces[0] + forces[1]) / where(j < 0.0, minimum(j, -_SMALLEST_J), maximum(j, _SMALLEST_J))


def table_voltage(force: float, voltages: Sequence[float], forces: Sequence[float]) -> float:
    """Returns the voltage [V] at which a table has a force [N], held at its ends; 0 V for 0 N.

    voltages, forces: points of the table, ascending; a force that several points have is a jump
    """
    return where(force == 0.0, 0.0, lambda: interp(force, forces, voltages))


def shares(levers: Pair) -> Pair:
    """Returns the share s of a force that each thruster takes, for their levers x_1 > 0 > x_2 [m]."""
    span = levers[0] - levers[1]
    return -levers[1] / span, levers[0] / span


def limited(force: float, couple: float, share: Pair, ranges: tuple[Pair, Pair], heave_first: bool) -> Pair:
    """Returns F [N] and m [N] within what the thrusters give; both as they are where that gives both.

    ranges: lowest and highest force [N] of each thruster, of different signs
    heave_first: whether F is limited first, and m to what F leaves of the thrusters; else the other way
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
