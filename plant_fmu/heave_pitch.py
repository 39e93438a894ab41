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
    """Returns the vertical force of the thrusters [N], positive down."""
    return cos(pitch) * sum(forces)


def thrust_moment(forces: Sequence[float], levers: Sequence[float]) -> float:
    """Returns the moment of the thrusters [N.m], positive bow up; a force down at the bow is negative."""
    # 0 less the sum: the moment of no force is then 0 and not -0
    return 0.0 - sum(x * force for x, force in zip(levers, forces, strict=True))


def righting_moment(pitch: float, weight: float, metacentric_height: float) -> float:
    """Returns the righting moment W BG sin(theta) [N.m]; the buoyancy is assumed to be W."""
    return weight * metacentric_height * sin(pitch)


def angular_acceleration(moment: float, righting: float, damping: float, inertia: float) -> float:
    """Returns q' [rad/s2] under a moment [N.m] of thrusters and surroundings."""
    return (moment - righting - damping) / inertia


def depth_at(depth: float, pitch: float, forward: float, below: float = 0.0) -> float:
    """Returns the depth [m] of a point of the vehicle, which on an even keel is the vehicle's depth.

    forward, below: distances of the point from the centre of gravity [m]
    """
    return depth - forward * sin(pitch) - below * (1.0 - cos(pitch))
