"""Block SlidingModeDepthController: integral sliding mode control of depth with a boundary layer: EQUATIONS.

On M z'' + D z' = u + d, with ideal measurements and thrusters, M s' = d - K sat(s / phi). With |d| <= d_max
below K, the boundary layer |s| <= phi is reached after M (|s(0)| - phi) / (K - d_max) s at the latest, and
not left. Inside it the law is linear: a PID with poles at -lambda, -lambda and -K / (M phi).
Source: Slotine and Li, Applied Nonlinear Control (1991), section 7.1 (integral in s) and 7.2 (boundary
layer); Utkin, Guldner and Shi, Sliding Mode Control in Electro-Mechanical Systems (2009).
"""

from dataclasses import dataclass

from controller_fmu import depth_interface, shared_guide
from controller_fmu.anti_windup import integrate_error
from controller_fmu.depth_interface import DepthInputs, DepthMeasurement, DepthOutputs, DepthState
from fmus.block import NoValues, variable
from fmus.block.guide import Source
from fmus.numerics import clip

EQUATIONS = """\
s = e' + 2 lambda e + lambda^2 int e dt,   e = z - r,   e' = v - r'
u = M (r'' - 2 lambda e' - lambda^2 e) + D v - K sat(s / phi)
"""


@dataclass(frozen=True)
class Parameters(depth_interface.DesignParameters):
    error_bandwidth: float = variable(
        1.0,
        "lambda, both poles of the error on s = 0",
        unit="rad/s",
        min=1e-6,
        max=1e3,
        source="poles at 1 rad/s: slow beside observer (8 rad/s) and thrusters (20 rad/s)",
    )
    switching_gain: float = variable(
        4.0,
        "K, above the largest disturbance",
        unit="N",
        min=0.0,
        max=1e6,
        source="buoyancy 1.4 N, a step of 2 N, and 0.6 N for the damping; below the 6 N of the thrusters",
    )
    boundary_layer: float = variable(
        0.5,
        "phi, half the width of the boundary layer",
        unit="m/s",
        min=1e-9,
        max=1e6,
        source="K / (M phi) = 1.5 rad/s, the third pole, for M = 5.5 kg",
    )


@dataclass(frozen=True)
class State:
    interface: DepthState = DepthState()
    error_integral: float = variable(0.0, "int e dt", unit="m.s")


@dataclass(frozen=True)
class Outputs(DepthOutputs):
    sliding_variable: float = variable(0.0, "s = e' + 2 lambda e + lambda^2 int e dt", unit="m/s")


def sliding_variable(now: DepthMeasurement, error_integral: float, p: Parameters) -> float:
    """Returns s [m/s]."""
    bandwidth = p.error_bandwidth
    return now.error_rate + 2.0 * bandwidth * now.error + bandwidth**2 * error_integral


def control(now: DepthMeasurement, error_integral: float, p: Parameters) -> float:
    """Returns u [N]."""
    bandwidth = p.error_bandwidth
    acceleration = now.reference_acceleration - 2.0 * bandwidth * now.error_rate - bandwidth**2 * now.error
    s = sliding_variable(now, error_integral, p)
    return (
        p.model_inertia * acceleration
        + p.model_damping * now.rate
        - p.switching_gain * clip(s / p.boundary_layer, -1.0, 1.0)
    )


def initial_state(t: float, inputs: DepthInputs, p: Parameters, calculated: NoValues) -> State:
    return State(depth_interface.first_state(t, inputs, p))


def step(t: float, h: float, state: State, inputs: DepthInputs, p: Parameters, calculated: NoValues) -> State:
    u = control(state.interface.measured, state.error_integral, p)
    delivered = depth_interface.deliver(u, state.interface.j, p)
    interface = depth_interface.next_state(t, state.interface, inputs, p)
    integral = integrate_error(h, state.error_integral, interface.measured.error, delivered.saturation_error)
    return State(interface, integral)


def output(t: float, state: State, p: Parameters, calculated: NoValues) -> Outputs:
    measured, j = state.interface.measured, state.interface.j
    u = control(measured, state.error_integral, p)
    return Outputs(
        **depth_interface.outputs(u, measured, j, p),
        sliding_variable=sliding_variable(measured, state.error_integral, p),
    )


GUIDE = shared_guide.depth_guide(
    EQUATIONS,
    tuning=(
        "switching_gain K must be above the largest disturbance, buoyancy included, and below the force of"
        " both thrusters.",
        "With boundary_layer phi, K / (M phi) is the third pole inside the layer. In a thin layer it is as"
        " fast as the lags of the loop, and the voltages chatter.",
        "error_bandwidth lambda is the two other poles.",
    ),
    limits=(
        "Inside the boundary layer the law is a PID with k_p = M lambda^2 + 2 lambda K / phi,"
        " k_i = lambda^2 K / phi and k_d = 2 lambda M + K / phi - D; it differs only outside the"
        " layer.",
        "A change of error_bandwidth in a run makes u jump: it multiplies the integral of past errors.",
        shared_guide.REFERENCE_RATES,
        "The integral holds while the thrusters saturate and it would increase the demand.",
    ),
    sources=(
        Source("J.-J. Slotine and W. Li: Applied Nonlinear Control, Prentice Hall, 1991, chapter 7."),
        Source("V. Utkin, J. Guldner and J. Shi: Sliding Mode Control in Electro-Mechanical Systems, 2009."),
    ),
)


BLOCK = depth_interface.depth_controller(
    __name__,
    "SlidingModeDepthController",
    "Integral sliding mode depth controller with a boundary layer",
    requirements=depth_interface.requirements,
)
