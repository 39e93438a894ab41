"""Depth dynamics of a submerged or floating vehicle, heave axis of the body frame.

    M_z w' = tau_z + w_dz + J (W - B(z)) - D_z w_r - D_q |w_r| w_r                       (10)
    z'     = J w,    J = cos(roll) cos(pitch),    w_r = w - J v_c

z [m] is the depth of the vehicle's top, positive down; w [m/s] the heave velocity; tau_z and w_dz [N] the
thrust and external force along the body's z axis; v_c [m/s] the vertical current in the earth frame.
Source: Maalouf et al. (2013), (10); quadratic damping, current and free surface after Fossen (2002).
"""

from fmus.numerics import absolute, clip, cos

GRAVITY = 9.81  # m/s2


def body_to_earth(roll: float, pitch: float) -> float:
    """Returns J(roll, pitch) = cos(roll) cos(pitch), for angles in rad."""
    return cos(roll) * cos(pitch)


def buoyancy(z: float, submerged: float, density: float, waterplane_area: float) -> float:
    """Returns B(z) [N]: `submerged` under water, less rho g A per metre that has emerged, never negative.

    Vertical-sided approximation: the vehicle emerges by -z when its top is above the surface.
    """
    emerged = clip(-z, 0.0, submerged / (density * GRAVITY * waterplane_area))
    return submerged - density * GRAVITY * waterplane_area * emerged


def damping(relative_velocity: float, linear: float, quadratic: float) -> float:
    """Returns D_z w_r + D_q |w_r| w_r [N], opposing the motion through the water."""
    return (linear + quadratic * absolute(relative_velocity)) * relative_velocity


def acceleration(thrust: float, external: float, restoring: float, drag: float, inertia: float) -> float:
    """Returns w' [m/s2] of (10), restoring = J (W - B)."""
    return (thrust + external + restoring - drag) / inertia
