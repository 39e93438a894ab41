"""Block PidDepthController: PID control of the depth with two degrees of freedom: EQUATIONS.

beta weighs the reference in the derivative, 0 to 1; its weight in the proportional part is 1. z / r holds for
the assumed vehicle, M z'' + D z' = u + d, with ideal measurements and thrusters: beta moves zeros and no
pole, and with beta = 1, e / r is -M s^3 over the same denominator.
Source: Astrom and Hagglund, Advanced PID Control (2006), chapter 3 (set-point weighting) and 5 (two degrees
of freedom, feedforward).
"""

from dataclasses import dataclass

from controller_fmu import depth_interface, shared_guide
from controller_fmu.anti_windup import integrate_error
from controller_fmu.depth_interface import DepthInputs, DepthMeasurement, DepthOutputs, DepthState
from fmus.block import NoValues, variable
from fmus.block.guide import Source

EQUATIONS = """\
u     = -k_p e - int k_i e dt - k_d (v - beta r') + beta D r',   e = z - r
z / r = (beta (k_d + D) s^2 + k_p s + k_i) / (M s^3 + (D + k_d) s^2 + k_p s + k_i)
"""

_POLES = "three poles at w = 1 rad/s for M = 5.5 kg and D = 2.5 N.s/m: "


@dataclass(frozen=True)
class Parameters(depth_interface.DampingParameter, depth_interface.ObserverParameters):
    kp: float = variable(16.5, "k_p", unit="N/m", min=0.0, max=1e6, source=_POLES + "3 M w^2")
    ki: float = variable(5.5, "k_i", unit="N/(m.s)", min=0.0, max=1e6, source=_POLES + "M w^3")
    kd: float = variable(14.0, "k_d", unit="N.s/m", min=0.0, max=1e6, source=_POLES + "3 M w - D")
    beta: float = variable(
        1.0,
        "beta, weight of the reference in the derivative",
        min=0.0,
        max=1.0,
        source="1: no error on a ramp of known rate",
    )


@dataclass(frozen=True)
class State:
    interface: DepthState = DepthState()
    # with the gain inside, a change of k_i during a run makes no jump of the control
    integral: float = variable(0.0, "int k_i e dt", unit="N")


@dataclass(frozen=True)
class Outputs(DepthOutputs):
    integral_force: float = variable(0.0, "Integral part -int k_i e dt of the demand", unit="N")


def control(now: DepthMeasurement, integral: float, p: Parameters) -> float:
    """Returns u [N]."""
    return (
        -p.kp * now.error
        - integral
        - p.kd * (now.rate - p.beta * now.reference_rate)
        + p.beta * p.model_damping * now.reference_rate
    )


def initial_state(t: float, inputs: DepthInputs, p: Parameters, calculated: NoValues) -> State:
    return State(depth_interface.first_state(t, inputs, p))


def step(t: float, h: float, state: State, inputs: DepthInputs, p: Parameters, calculated: NoValues) -> State:
    u = control(state.interface.measured, state.integral, p)
    delivered = depth_interface.deliver(u, state.interface.j, p)
    interface = depth_interface.next_state(t, state.interface, inputs, p)
    change = p.ki * interface.measured.error
    integral = integrate_error(h, state.integral, change, delivered.saturation_error)
    return State(interface, integral)


def output(t: float, state: State, p: Parameters, calculated: NoValues) -> Outputs:
    measured, j = state.interface.measured, state.interface.j
    u = control(measured, state.integral, p)
    return Outputs(
        **depth_interface.outputs(u, measured, j, p),
        integral_force=-state.integral,
    )


GUIDE = shared_guide.depth_guide(
    EQUATIONS,
    tuning=(
        "k_p = 3 M w^2, k_i = M w^3 and k_d = 3 M w - D give three poles at w.",
        "beta = 1 follows a ramp of known rate without error; beta = 0 removes the rate of the reference from"
        " the law. beta moves zeros, no pole.",
    ),
    limits=(
        shared_guide.REFERENCE_RATES,
        "The integral holds while the thrusters saturate and it would increase the demand. A change of ki in"
        " a run acts on later errors alone.",
    ),
    sources=(Source("K. J. Astrom and T. Hagglund: Advanced PID Control, ISA, 2006."),),
)


BLOCK = depth_interface.depth_controller(
    __name__,
    "PidDepthController",
    "PID depth controller with two degrees of freedom",
    requirements=depth_interface.requirements,
)
