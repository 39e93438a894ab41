"""Block AdrcDepthController: linear active disturbance rejection control of the depth, after Gao: EQUATIONS.

z is the measured depth, u_d the force that the thrusters deliver, z_3 the estimate of everything else that
accelerates the vehicle: damping, buoyancy, disturbances. The observer has two poles at -w_o and one at
-q w_o, the loop with a perfect observer two at -w_c. A small q filters the disturbance's estimate and leaves
the state's fast; with q = 1 it is Gao's. A step is exact for a held z and u_d, hence stable for any length:
the error from the steady state (z, 0, -u_d / M) is multiplied by the exponential of h A_o, in Newton's form

    e^(h A_o) = e^(-w_o h) (I + h N + c h^2 N^2),   N = A_o + w_o I
    c         = (e^d - 1 - d) / d^2,   d = (1 - q) w_o h;   1/2 for q = 1, where N^3 = 0
Source: J. Han, From PID to active disturbance rejection control, IEEE Trans. Industrial Electronics 56
(2009); Z. Gao, Scaling and bandwidth-parameterization based controller tuning, ACC 2003; N. J. Higham,
Functions of Matrices, SIAM 2008, chapter 4 (Newton's form).
"""

import math
from dataclasses import dataclass

from controller_fmu import depth_interface, shared_guide
from controller_fmu.depth_interface import DepthInputs, DepthMeasurement, DepthOutputs
from fmus.block import NoValues, variable
from fmus.block.guide import Source
from fmus.numerics import absolute, exp, where

EQUATIONS = """\
z_1' = z_2 + (2 + q) w_o (z - z_1)
z_2' = z_3 + u_d / M + (1 + 2 q) w_o^2 (z - z_1)
z_3' = q w_o^3 (z - z_1)
u    = M (w_c^2 (r - z_1) + 2 w_c (r' - z_2) + r'' - z_3)
"""


@dataclass(frozen=True)
class Parameters(depth_interface.InertiaParameter, depth_interface.ActuatorParameters):
    control_bandwidth: float = variable(
        1.0,
        "w_c, both poles of the loop",
        unit="rad/s",
        min=1e-6,
        max=1e3,
        source="1 rad/s: slow beside the observer and the thrusters (20 rad/s)",
    )
    observer_bandwidth: float = variable(
        4.0,
        "w_o, the poles of the observer",
        unit="rad/s",
        min=1e-6,
        max=1e3,
        source="4 w_c; Gao (2003) takes 3 to 5 w_c",
    )
    disturbance_ratio: float = variable(
        1.0,
        "q, pole of the disturbance's estimate over the other two",
        min=1e-3,
        max=1e3,
        source="1: three equal poles, Gao (2003)",
    )


@dataclass(frozen=True)
class Estimate:
    """Estimate of the extended state observer."""

    depth: float = variable(0.0, "z_1", unit="m")
    rate: float = variable(0.0, "z_2", unit="m/s")
    disturbance: float = variable(0.0, "z_3", unit="m/s2")


@dataclass(frozen=True)
class State:
    """State of the controller; `measured` has the rate of the extended state observer."""

    measured: DepthMeasurement = DepthMeasurement()
    estimate: Estimate = Estimate()
    j: float = variable(1.0, "J = cos(roll) cos(pitch)", min=-1.0, max=1.0)


@dataclass(frozen=True)
class Outputs(DepthOutputs):
    estimated_depth: float = variable(0.0, "z_1, depth of the extended state observer", unit="m")
    estimated_disturbance: float = variable(0.0, "M z_3, force of all but the thrusters", unit="N")


def observe(
    h: float, estimate: Estimate, depth: float, acceleration: float, bandwidth: float, ratio: float
) -> Estimate:
    """Returns the estimate h s later, measured depth [m] and u_d / M [m/s2] held.

    bandwidth: w_o [rad/s]; ratio: q
    """

    def turned(x: tuple[float, float, float]) -> tuple[float, float, float]:
        """Returns h N x."""
        return (
            h * (x[1] - (1.0 + ratio) * bandwidth * x[0]),
            h * (x[2] + bandwidth * x[1] - (1.0 + 2.0 * ratio) * bandwidth**2 * x[0]),
            h * (bandwidth * x[2] - ratio * bandwidth**3 * x[0]),
        )

    error = estimate.depth - depth, estimate.rate, estimate.disturbance + acceleration
    once = turned(error)
    twice = turned(once)
    left = exp(-bandwidth * h)
    # left (c - 1/2): near d = 0 by the series of the exponential, elsewhere without an overflow of e^d
    d = (1.0 - ratio) * bandwidth * h
    series = left * sum(d**k / math.factorial(k + 2) for k in range(1, 9))
    is_small = absolute(d) < 0.1
    divisor = where(is_small, 1.0, d)
    apart = (exp(-ratio * bandwidth * h) - left * (1.0 + d + 0.5 * d * d)) / (divisor * divisor)
    rest = where(is_small, series, apart)
    after = [left * (a + b + 0.5 * c) + rest * c for a, b, c in zip(error, once, twice, strict=True)]
    return Estimate(depth + after[0], after[1], after[2] - acceleration)


def control(now: DepthMeasurement, estimate: Estimate, p: Parameters) -> float:
    """Returns u [N]."""
    bandwidth = p.control_bandwidth
    return p.model_inertia * (
        bandwidth**2 * (now.reference - estimate.depth)
        + 2.0 * bandwidth * (now.reference_rate - estimate.rate)
        + now.reference_acceleration
        - estimate.disturbance
    )


def initial_state(t: float, inputs: DepthInputs, p: Parameters, calculated: NoValues) -> State:
    """Returns the observer at rest on the first measurement, without a disturbance."""
    estimate = Estimate(inputs.measured_depth)
    measured = depth_interface.measurement(inputs, estimate.rate)
    return State(measured, estimate, depth_interface.body_to_earth(inputs))


def step(t: float, h: float, state: State, inputs: DepthInputs, p: Parameters, calculated: NoValues) -> State:
    # the delivered force, not the demand: z_3 then does not wind up while the thrusters saturate
    delivered = depth_interface.deliver(control(state.measured, state.estimate, p), state.j, p)
    acceleration = delivered.force / p.model_inertia
    estimate = observe(
        h, state.estimate, inputs.measured_depth, acceleration, p.observer_bandwidth, p.disturbance_ratio
    )
    measured = depth_interface.measurement(inputs, estimate.rate)
    return State(measured, estimate, depth_interface.body_to_earth(inputs))


def output(t: float, state: State, p: Parameters, calculated: NoValues) -> Outputs:
    u = control(state.measured, state.estimate, p)
    return Outputs(
        **depth_interface.outputs(u, state.measured, state.j, p),
        estimated_depth=state.estimate.depth,
        estimated_disturbance=p.model_inertia * state.estimate.disturbance,
    )


GUIDE = shared_guide.depth_guide(
    EQUATIONS,
    tuning=(
        "Set control_bandwidth to the desired speed of the loop, then observer_bandwidth to 3 to 5 times it,"
        " if noise and lags of the loop allow.",
        "disturbance_ratio below 1 filters the disturbance's estimate, without a slower state. It need not be"
        " tuned: searched within total variations of 1000, 125 and 62.5 N it ends at 1.11, 1.01 and 0.98.",
        "model_inertia M is the only number of the vehicle's dynamics; b_0 = 1 / M in the literature.",
    ),
    limits=(
        "The extended state observer replaces the alpha-beta observer: the law uses measured_depth, not"
        " measured_depth_rate. estimated_depth_rate is its z_2.",
        "A step is exact for a held measurement, so it is stable for any step and any w_o.",
        "The observer gets the delivered force: its estimate z_3 of the disturbance does not wind up while"
        " the thrusters saturate.",
        shared_guide.HELD_CONTROL,
        shared_guide.REFERENCE_RATES,
    ),
    sources=(
        Source(
            "J. Han: From PID to active disturbance rejection control, IEEE Transactions on Industrial"
            " Electronics 56, 2009."
        ),
        Source(
            "Z. Gao: Scaling and bandwidth-parameterization based controller tuning, American Control"
            " Conference, 2003."
        ),
    ),
    has_observer=False,
)


BLOCK = depth_interface.depth_controller(
    __name__,
    "AdrcDepthController",
    "Active disturbance rejection depth controller with an extended state observer",
    requirements=depth_interface.table_requirements,
)
