"""Block SuperTwistingDepthController: second-order sliding mode control by super-twisting: EQUATIONS.

On M z'' + D z' = u + d, with ideal measurements and thrusters, M s' = -k_1 sqrt(|s|) g + nu + d. With eps = 0
(g is the sign of s) and |d'| <= L below k_2, s and s' reach 0 in finite time for a k_1 that is large enough,
whatever d is; with eps > 0 they reach a neighbourhood of 0.

The g of a step is the explicit law, unless it would lead the s of the assumed vehicle beyond 0: then s ends
at 0. So the control does not switch for ever at eps = 0, as it would with the explicit step alone. For every
eps that is large beside h^2 k_1^2 / M^2, g is the law.
Source: A. Levant, Sliding order and sliding accuracy in sliding mode control, Int. J. Control 58 (1993);
J. Moreno and M. Osorio, Strict Lyapunov functions for the super-twisting algorithm, IEEE TAC 57 (2012); after
B. Brogliato, A. Polyakov and D. Efimov, The implicit discretization of the supertwisting sliding-mode control
algorithm, IEEE TAC 65 (2020), whose step leads to 0 where it can.
"""

from dataclasses import dataclass

from controller_fmu import depth_interface, shared_guide
from controller_fmu.anti_windup import widens
from controller_fmu.depth_interface import DepthInputs, DepthMeasurement, DepthOutputs, DepthState
from fmus.block import NoValues, variable
from fmus.block.guide import Source
from fmus.numerics import absolute, maximum, sqrt, where

EQUATIONS = """\
s = e' + lambda e,   e = z - r,   e' = v - r',   g = s / (|s| + eps)
u = M (r'' - lambda e') + D v - k_1 sqrt(|s|) g + nu,   nu' = -k_2 g
g = s / max(|s| + eps, (h / M) (k_1 sqrt(|s|) + h k_2))   in a step of h s
"""

# of eps: the root is held below it, so that it has a derivative at 0; g is smaller there
_LEAST_ROOT = 1e-3


@dataclass(frozen=True)
class Parameters(depth_interface.DesignParameters):
    error_bandwidth: float = variable(
        1.0,
        "lambda, the pole of the error on s = 0",
        unit="rad/s",
        min=1e-6,
        max=1e3,
        source="1 rad/s: slow beside observer (8 rad/s) and thrusters (20 rad/s)",
    )
    root_gain: float = variable(
        1.5,
        "k_1, in N per (m/s)^0.5",
        min=0.0,
        max=1e6,
        source="1.5 sqrt(L M), Levant (1998), for |d'| <= L = 0.2 N/s and M = 5.5 kg",
    )
    twisting_gain: float = variable(
        0.22, "k_2", unit="N/s", min=0.0, max=1e6, source="1.1 L, Levant (1998), for |d'| <= L = 0.2 N/s"
    )
    smoothing: float = variable(
        0.02,
        "eps, below which g is linear",
        unit="m/s",
        min=1e-9,
        max=1e6,
        source="the noise of the observed depth rate",
    )


@dataclass(frozen=True)
class State:
    interface: DepthState = DepthState()
    direction: float = variable(0.0, "g of the last step", min=-1.0, max=1.0)
    integral_force: float = variable(0.0, "nu", unit="N")


@dataclass(frozen=True)
class Outputs(DepthOutputs):
    sliding_variable: float = variable(0.0, "s = e' + lambda e", unit="m/s")
    integral_force: float = variable(0.0, "nu, minus the estimated disturbance", unit="N")


def sliding_variable(now: DepthMeasurement, p: Parameters) -> float:
    """Returns s [m/s]."""
    return now.error_rate + p.error_bandwidth * now.error


def direction(h: float, s: float, p: Parameters) -> float:
    """Returns g of a step of h s."""
    root = _root(s, p)
    change = h / p.model_inertia * (p.root_gain * root + h * p.twisting_gain)
    return s / maximum(absolute(s) + p.smoothing, change)


def control(now: DepthMeasurement, g: float, integral_force: float, p: Parameters) -> float:
    """Returns u [N]."""
    acceleration = now.reference_acceleration - p.error_bandwidth * now.error_rate
    equivalent = p.model_inertia * acceleration + p.model_damping * now.rate
    return equivalent - p.root_gain * _root(sliding_variable(now, p), p) * g + integral_force


def _root(s: float, p: Parameters) -> float:
    """Returns sqrt(|s|)."""
    return sqrt(maximum(absolute(s), _LEAST_ROOT * p.smoothing))


def initial_state(t: float, inputs: DepthInputs, p: Parameters, calculated: NoValues) -> State:
    interface = depth_interface.first_state(t, inputs, p)
    return State(interface, direction(0.0, sliding_variable(interface.measured, p), p))


def step(t: float, h: float, state: State, inputs: DepthInputs, p: Parameters, calculated: NoValues) -> State:
    u = control(state.interface.measured, state.direction, state.integral_force, p)
    delivered = depth_interface.deliver(u, state.interface.j, p)
    interface = depth_interface.next_state(t, state.interface, inputs, p)
    g = direction(h, sliding_variable(interface.measured, p), p)
    change = -h * p.twisting_gain * g
    return State(
        interface, g, state.integral_force + where(widens(delivered.saturation_error, change), 0.0, change)
    )


def output(t: float, state: State, p: Parameters, calculated: NoValues) -> Outputs:
    measured, j = state.interface.measured, state.interface.j
    u = control(measured, state.direction, state.integral_force, p)
    return Outputs(
        **depth_interface.outputs(u, measured, j, p),
        sliding_variable=sliding_variable(measured, p),
        integral_force=state.integral_force,
    )


GUIDE = shared_guide.depth_guide(
    EQUATIONS,
    tuning=(
        "For disturbances that change by at most L, in N/s, set root_gain k_1 to 1.5 sqrt(L M) and"
        " twisting_gain k_2 to 1.1 L.",
        "With a delay of T s, the loop oscillates while |s| is below about (k_2 T / k_1)^2 (estimate)."
        " Smaller gains make it quieter, but slower against disturbances.",
        "Set smoothing eps to the order of the noise of the depth rate.",
    ),
    limits=(
        "The error reaches 0 in finite time for eps = 0 and an ideal loop. With eps, noise and lags it stays"
        " near 0.",
        shared_guide.REFERENCE_RATES,
        "nu holds while the thrusters saturate and it would increase the demand.",
    ),
    sources=(
        Source(
            "A. Levant: Sliding order and sliding accuracy in sliding mode control, Int. J. Control 58,"
            " 1993; Robust exact differentiation via sliding mode technique, Automatica 34, 1998."
        ),
        Source(
            "J. Moreno and M. Osorio: Strict Lyapunov functions for the super-twisting algorithm, IEEE"
            " Transactions on Automatic Control 57, 2012."
        ),
        Source(
            "B. Brogliato, A. Polyakov and D. Efimov: The implicit discretization of the supertwisting"
            " sliding-mode control algorithm, IEEE Transactions on Automatic Control 65, 2020."
        ),
    ),
)


BLOCK = depth_interface.depth_controller(
    __name__,
    "SuperTwistingDepthController",
    "Super-twisting depth controller",
    requirements=depth_interface.requirements,
)
