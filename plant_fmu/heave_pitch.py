"""Heave and pitch of a vehicle in its vertical plane.

    M v' = W - B(z) + cos(theta) sum F_i + F_ext + (rho V + A) w_f' - D v_r - D_q |v_r| v_r
    I q' = -sum x_i F_i - W BG sin(theta) + M_ext - D_M q - D_Mq |q| q
    z' = v,   theta' = q,   v_r = v - v_c - w_f

z [m] is the depth, positive down, v [m/s] its rate; theta [rad] the pitch angle, positive bow up, q [rad/s]
its rate. F_i [N] is the force of a thruster along the body's z axis, positive down, x_i [m] its lever,
positive forward of the centre of gravity; BG [m] the height of the centre of buoyancy above it.
Surge is neglected: it neither moves the depth nor turns the vehicle.
Source: Fossen, Marine Control Systems (2002), the vertical plane of a vehicle that is symmetric in it, its
origin in the centre of gravity.
"""

from collections.abc import Sequence

from fmus.numerics import cos, sin


def vertical_thrust(forces: Sequence[float], pitch: float) -> float:
    """Returns the vertical force of the thrusters.

    Parameters
    ----------
    forces : sequence of float
        Force F_i of each thruster [N].
    pitch : float
        Pitch angle theta [rad].

    Returns
    -------
    float
        Force [N], positive down.
    """
    return cos(pitch) * sum(forces)


def thrust_moment(forces: Sequence[float], levers: Sequence[float]) -> float:
    """Returns the moment of the thrusters; a force down at the bow is negative.

    Parameters
    ----------
    forces : sequence of float
        Force F_i of each thruster [N].
    levers : sequence of float
        Lever x_i of each thruster [m], positive forward of the centre of gravity.

    Returns
    -------
    float
        Moment [N.m], positive bow up.

    Examples
    --------
    >>> thrust_moment((2.0, 1.0), levers=(0.5, -0.5))
    -0.5
    """
    # 0 less the sum: the moment of no force is then 0 and not -0
    return 0.0 - sum(x * force for x, force in zip(levers, forces, strict=True))


def righting_moment(pitch: float, weight: float, metacentric_height: float) -> float:
    """Returns the righting moment W BG sin(theta); the buoyancy is assumed to be W.

    Parameters
    ----------
    pitch : float
        Pitch angle theta [rad].
    weight : float
        W [N].
    metacentric_height : float
        BG [m].

    Returns
    -------
    float
        Moment [N.m].
    """
    return weight * metacentric_height * sin(pitch)


def angular_acceleration(moment: float, righting: float, damping: float, inertia: float) -> float:
    """Returns q' under a moment of thrusters and surroundings.

    Parameters
    ----------
    moment, righting, damping : float
        Moment of thrusters and surroundings, W BG sin(theta), and D_M q + D_Mq |q| q [N.m].
    inertia : float
        I [kg.m2].

    Returns
    -------
    float
        q' [rad/s2].
    """
    return (moment - righting - damping) / inertia


def depth_at(depth: float, pitch: float, forward: float, below: float = 0.0) -> float:
    """Returns the depth of a point of the vehicle, which on an even keel is the vehicle's depth.

    Parameters
    ----------
    depth : float
        Depth of the vehicle [m].
    pitch : float
        Pitch angle theta [rad].
    forward, below : float
        Distances of the point from the centre of gravity [m].

    Returns
    -------
    float
        Depth of the point [m].
    """
    return depth - forward * sin(pitch) - below * (1.0 - cos(pitch))
