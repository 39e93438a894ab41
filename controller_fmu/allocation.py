"""Allocation of a demanded vertical force to two thruster voltages, and its inverse.

    u = K^-1 T^+ J' tau    with K = diag(k_1, k_2) [N/V], T = [1, 1], T^+ = [1/2, 1/2]

A table in place of k inverts the curve of thrusters: the force of each is half of J tau, limited to what the
table gives up to the largest voltage, and its voltage is that at which the table has this force. Where the
force changes its sign the voltage jumps over the dead band; it is 0 V for a force of exactly 0.

tau is the demand in the earth frame, J = cos(roll) cos(pitch). T is 1x2, so its inverse is a
pseudo-inverse. Source: Maalouf et al. (2013), section 4.3 and (11).
"""

from collections.abc import Sequence

from fmus.numerics import clip, cos, interp, maximum, minimum, where

_SMALLEST_J = 0.1  # a vehicle on its side cannot push vertically; keeps the inverse finite


def body_to_earth(roll: float, pitch: float) -> float:
    """Returns J(roll, pitch) = cos(roll) cos(pitch), for angles in rad."""
    return cos(roll) * cos(pitch)


def allocate(force: float, j: float, gains: tuple[float, float]) -> tuple[float, float]:
    """Returns the voltages [V] that give the force [N]; each thruster takes half."""
    share = 0.5 * j * force
    return share / gains[0], share / gains[1]


def saturate(voltages: tuple[float, float], limit: float) -> tuple[float, float]:
    """Returns the voltages limited to -limit..limit."""
    return clip(voltages[0], -limit, limit), clip(voltages[1], -limit, limit)


def force(voltages: tuple[float, float], j: float, gains: tuple[float, float]) -> float:
    """Returns the force [N] in the earth frame that voltages give: tau = T K u / J, with |J| kept from 0."""
    thrust = gains[0] * voltages[0] + gains[1] * voltages[1]
    return thrust / where(j < 0.0, minimum(j, -_SMALLEST_J), maximum(j, _SMALLEST_J))


def table_voltage(force: float, voltages: Sequence[float], forces: Sequence[float]) -> float:
    """Returns the voltage [V] at which a table has a force [N], held at its ends; 0 V for 0 N.

    voltages, forces: points of the table, ascending; a force that several points have is a jump
    """
    return where(force == 0.0, 0.0, lambda: interp(force, forces, voltages))


def saturation_error(
    demanded: tuple[float, float],
    saturated: tuple[float, float],
    j: float,
    gains: tuple[float, float],
) -> float:
    """Returns force delivered minus force demanded [N], earth frame; exactly 0 without saturation."""
    return force((saturated[0] - demanded[0], saturated[1] - demanded[1]), j, gains)
