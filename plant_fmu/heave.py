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


def buoyancy(z: float, submerged: float, density: float, waterplane_area: float) -> float:
    """Returns the buoyancy B(z) [N] of a vehicle with vertical sides, never negative.

    Parameters
    ----------
    z : float
        Depth of the vehicle's top [m], positive down; the vehicle emerges by -z.
    submerged : float
        Buoyancy under water [N].
    density : float
        Density of the water [kg/m3].
    waterplane_area : float
        Horizontal section of the vehicle [m2].

    Returns
    -------
    float

    Examples
    --------
    >>> buoyancy(1.0, 30.0, 1000.0, 0.02), round(buoyancy(-0.1, 30.0, 1000.0, 0.02), 2)
    (30.0, 10.38)
    """
    emerged = clip(-z, 0.0, height(submerged, density, waterplane_area))
    return submerged - density * GRAVITY * waterplane_area * emerged


def height(submerged: float, density: float, waterplane_area: float) -> float:
    """Returns the height [m] of a vehicle with vertical sides.

    Parameters
    ----------
    submerged : float
        Buoyancy under water [N].
    density : float
        Density of the water [kg/m3].
    waterplane_area : float
        Horizontal section of the vehicle [m2].

    Returns
    -------
    float
    """
    return submerged / (density * GRAVITY * waterplane_area)


def damping(relative_velocity: float, linear: float, quadratic: float) -> float:
    """Returns the damping D_z w_r + D_q |w_r| w_r [N], which opposes the motion through the water.

    Parameters
    ----------
    relative_velocity : float
        Velocity w_r of the vehicle in the water [m/s].
    linear, quadratic : float
        D_z [N.s/m] and D_q [N.s2/m2].

    Returns
    -------
    float

    Examples
    --------
    >>> damping(-0.5, 2.0, 4.0)
    -2.0
    """
    return (linear + quadratic * absolute(relative_velocity)) * relative_velocity


def wave_force(water_acceleration: float, inertia: float, net_weight: float) -> float:
    """Returns the force (rho V + A) w_f' [N] of accelerated water on a body that is small beside the wave.

    It is the force of Froude and Krylov on the displaced water rho V, and the force on the added mass A.

    Parameters
    ----------
    water_acceleration : float
        Vertical acceleration w_f' of the water [m/s2].
    inertia : float
        Inertia with added mass M_z [kg].
    net_weight : float
        W - B [N].

    Returns
    -------
    float
    """
    # M_z = W / g + A and rho V = B / g give rho V + A = M_z - (W - B) / g
    return (inertia - net_weight / GRAVITY) * water_acceleration


def acceleration(thrust: float, external: float, restoring: float, drag: float, inertia: float) -> float:
    """Returns the acceleration w' [m/s2] of (10).

    Parameters
    ----------
    thrust, external, restoring, drag : float
        tau_z, w_dz, J (W - B) and damping [N].
    inertia : float
        Inertia with added mass M_z [kg].

    Returns
    -------
    float
    """
    return (thrust + external + restoring - drag) / inertia
