"""Depth dynamics of a submerged or floating vehicle, heave axis of the body frame.

    M_z w' = tau_z + w_dz + J (W - B(z)) + (rho V + A) J w_f' - D_z w_r - D_q |w_r| w_r  (10)
    z'     = J w,    J = cos(roll) cos(pitch),    w_r = w - J (v_c + w_f)

z [m] is the depth of the vehicle's top, positive down; w [m/s] the heave velocity; tau_z and w_dz [N] the
thrust and external force along the body's z axis; v_c [m/s] the vertical current in the earth frame; w_f
[m/s] and w_f' [m/s2] the vertical orbital velocity and acceleration of waves, in the earth frame too.
Source: Maalouf et al. (2013), (10); quadratic damping, current and free surface after Fossen (2002), waves
after Faltinsen, Sea Loads on Ships and Offshore Structures (1990), chapter 3.
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
    emerged = clip(-z, 0.0, height(submerged, density, waterplane_area))
    return submerged - density * GRAVITY * waterplane_area * emerged


def height(submerged: float, density: float, waterplane_area: float) -> float:
    """Returns the height [m] of a vehicle with vertical sides, of this buoyancy under water."""
    return submerged / (density * GRAVITY * waterplane_area)


def damping(relative_velocity: float, linear: float, quadratic: float) -> float:
    """Returns D_z w_r + D_q |w_r| w_r [N], opposing the motion through the water."""
    return (linear + quadratic * absolute(relative_velocity)) * relative_velocity


def wave_force(water_acceleration: float, inertia: float, net_weight: float) -> float:
    """Returns the force [N] of accelerated water on a body that is small beside the wave: (rho V + A) w_f'.

    Froude and Krylov's on the displaced water rho V, and that of the added mass A. M_z = W / g + A and
    rho V = B / g, so both follow from inertia and net weight W - B: rho V + A = M_z - (W - B) / g.
    """
    return (inertia - net_weight / GRAVITY) * water_acceleration


def acceleration(thrust: float, external: float, restoring: float, drag: float, inertia: float) -> float:
    """Returns w' [m/s2] of (10), restoring = J (W - B)."""
    return (thrust + external + restoring - drag) / inertia
