"""Block MracDepthController: direct model reference adaptive control of the depth: EQUATIONS.

On x' = A x + B_m (u_d + theta |x|_inf + sigma), with ideal measurements, the error x - x_m and the errors of
the estimates make V = (x - x_m)^T P (x - x_m) + (theta_err^2 + sigma_err^2) / Gamma fall at the rate
(x - x_m)^T Q (x - x_m) at least, also under saturation, which changes no estimate.
No loop inside the controller is fast: the plant closes the loop of the estimates, so the lags of the real
loop bound Gamma. The explicit step of the estimates adds half a step to these lags.
Source: Ioannou and Sun, Robust Adaptive Control (1996), chapter 6; Lavretsky and Wise, Robust and Adaptive
Control (2013), chapter 9 to 11 (projection, saturation in the reference model).
"""

from dataclasses import dataclass, replace

from controller_fmu import depth_interface, shared_guide
from controller_fmu.depth_interface import DepthInputs, DepthMeasurement, DepthOutputs, DepthState
from controller_fmu.depth_model import DepthMatrices, depth_matrices
from controller_fmu.l1.feedforward import reference_feedforward
from controller_fmu.l1.matrices import Vector, dot, is_hurwitz, relaxed
from controller_fmu.l1.projection import keep_within, project
from fmus.block import variable
from fmus.block.guide import Source
from fmus.numerics import absolute, maximum

EQUATIONS = """\
u          = -k_m x + f - theta_hat |x|_inf - sigma_hat,   x = (z, v)
f          = M r'' + (D + k_m2) r' + k_m1 r                which is k_g r where r' and r'' are 0
x_m'       = A_m x_m + B_m (f + u_d - u)                   u_d - u: what saturation withholds
theta_hat' = Gamma Proj(theta_hat, (x - x_m)^T P B_m |x|_inf)
sigma_hat' = Gamma Proj(sigma_hat, (x - x_m)^T P B_m),     A_m^T P + P A_m = -Q
"""

_POLES = "both poles of A_m at w = 1 rad/s: "

# of a parameter, and of the estimate that it bounds [N]
_LARGEST_BOUND = 1e6


@dataclass(frozen=True)
class Parameters(depth_interface.DesignParameters):
    depth_gain: float = variable(
        5.5,
        "State feedback k_m of the depth",
        unit="N/m",
        min=1e-6,
        max=1e6,
        source=_POLES + "M w^2 for M = 5.5 kg",
    )
    rate_gain: float = variable(
        8.5,
        "State feedback k_m of the depth rate",
        unit="N.s/m",
        min=0.0,
        max=1e6,
        source=_POLES + "2 M w - D for D = 2.5 N.s/m",
    )
    estimate_gain: float = variable(
        30.0,
        "Adaptation gain Gamma",
        min=0.0,
        max=1e9,
        source="M^2: with A_m and Q it puts the poles of the loop of sigma_hat at -1 and -0.5 +- 0.5j rad/s",
    )
    projection_tolerance: float = variable(
        0.1, "Width eps of the boundary layer of the projection", min=1e-6, max=10.0, source="guess"
    )
    lyapunov_weight: Vector = variable(
        (1.0, 1.0), "Diagonal of Q in the Lyapunov equation", min=1e-9, max=1e9, source="guess"
    )
    theta_bound: float = variable(
        5.0,
        "Bound of |theta_hat|",
        unit="N",
        min=0.0,
        max=_LARGEST_BOUND,
        source="as in L1DepthController; per SI unit of the regressor",
    )
    sigma_bound: float = variable(
        10.0, "Bound of |sigma_hat|", unit="N", min=0.0, max=_LARGEST_BOUND, source="as in L1DepthController"
    )


@dataclass(frozen=True)
class Adaptive:
    """Adaptive part of the state."""

    model: Vector = variable((0.0, 0.0), "State x_m of the model", unit=("m", "m/s"))
    theta_hat: float = variable(
        0.0, "Estimate theta_hat, per SI unit of x", unit="N", min=-_LARGEST_BOUND, max=_LARGEST_BOUND
    )
    sigma_hat: float = variable(0.0, "Estimate sigma_hat", unit="N", min=-_LARGEST_BOUND, max=_LARGEST_BOUND)


@dataclass(frozen=True)
class State:
    interface: DepthState = DepthState()
    adaptive: Adaptive = Adaptive()


@dataclass(frozen=True)
class Outputs(DepthOutputs):
    theta_hat: float = variable(0.0, "Estimate theta_hat, per SI unit of the regressor", unit="N")
    sigma_hat: float = variable(0.0, "Estimate sigma_hat", unit="N")
    model_depth: float = variable(0.0, "Depth of the reference model x_m", unit="m")
    model_depth_rate: float = variable(0.0, "Depth rate of the reference model x_m", unit="m/s")


def regressor(x: Vector) -> float:
    """Returns |x|_inf of the numbers in SI units."""
    return maximum(absolute(x[0]), absolute(x[1]))


def feedforward(now: DepthMeasurement, matrices: DepthMatrices) -> float:
    """Returns f [N], the control with which the assumed vehicle under -k_m x follows the reference."""
    return reference_feedforward(now.reference, now.reference_rate, now.reference_acceleration, matrices)


def control(now: DepthMeasurement, adaptive: Adaptive, p: Parameters, matrices: DepthMatrices) -> float:
    """Returns u [N]."""
    feedback = p.depth_gain * now.depth + p.rate_gain * now.rate
    known = adaptive.theta_hat * regressor((now.depth, now.rate)) + adaptive.sigma_hat
    return -feedback + feedforward(now, matrices) - known


def adapt(h: float, before: Adaptive, x: Vector, p: Parameters, matrices: DepthMatrices) -> Adaptive:
    """Returns the estimates h s later; x and `before.model` are of the beginning of the step."""
    error, phi, eps = (x[0] - before.model[0], x[1] - before.model[1]), regressor(x), p.projection_tolerance
    slope = dot(error, matrices.adaptation_vector)
    change = h * p.estimate_gain
    theta = before.theta_hat + change * project(before.theta_hat, slope * phi, p.theta_bound, eps)
    sigma = before.sigma_hat + change * project(before.sigma_hat, slope, p.sigma_bound, eps)
    return replace(
        before, theta_hat=keep_within(theta, p.theta_bound), sigma_hat=keep_within(sigma, p.sigma_bound)
    )


def next_model(h: float, model: Vector, drive: float, matrices: DepthMatrices) -> Vector:
    """Returns x_m h s later under a held drive [N], by the implicit midpoint rule."""
    half = 0.5 * h * matrices.predictor_input[0] * drive, 0.5 * h * matrices.predictor_input[1] * drive
    after = relaxed(matrices.predictor_matrix, h, (model[0] + half[0], model[1] + half[1]))
    return after[0] + half[0], after[1] + half[1]


def calculate(p: Parameters) -> DepthMatrices:
    return depth_matrices((p.depth_gain, p.rate_gain), p.lyapunov_weight, p)


def requirements(p: Parameters, matrices: DepthMatrices) -> tuple:
    return (
        (is_hurwitz(matrices.predictor_matrix), "a Hurwitz A_m (trace < 0 and determinant > 0)"),
        *depth_interface.requirements(p, matrices),
    )


def initial_state(t: float, inputs: DepthInputs, p: Parameters, matrices: DepthMatrices) -> State:
    """Returns the reference model at the measured state, and estimates of 0."""
    interface = depth_interface.first_state(t, inputs, p)
    return State(interface, Adaptive(model=(interface.measured.depth, interface.measured.rate)))


def step(
    t: float, h: float, state: State, inputs: DepthInputs, p: Parameters, matrices: DepthMatrices
) -> State:
    """Returns the state h s later; the part f of the control that the vehicle receives drives x_m."""
    before, adaptive = state.interface.measured, state.adaptive
    given = depth_interface.deliver(control(before, adaptive, p, matrices), state.interface.j, p)
    interface = depth_interface.next_state(t, state.interface, inputs, p)
    now = interface.measured
    adapted = adapt(h, adaptive, (now.depth, now.rate), p, matrices)
    model = next_model(h, adaptive.model, feedforward(before, matrices) + given.saturation_error, matrices)
    return State(interface, replace(adapted, model=model))


def output(t: float, state: State, p: Parameters, matrices: DepthMatrices) -> Outputs:
    measured, adaptive = state.interface.measured, state.adaptive
    u = control(measured, adaptive, p, matrices)
    return Outputs(
        **depth_interface.outputs(u, measured, state.interface.j, p),
        theta_hat=adaptive.theta_hat,
        sigma_hat=adaptive.sigma_hat,
        model_depth=adaptive.model[0],
        model_depth_rate=adaptive.model[1],
    )


GUIDE = shared_guide.depth_guide(
    EQUATIONS,
    tuning=(
        "depth_gain and rate_gain determine A_m, the desired dynamics of the loop: M w^2 and 2 M w - D give"
        " two poles at w.",
        "estimate_gain Gamma: with Q = I and both poles of A_m at 1 rad/s, M^2 puts the poles of the loop of"
        " sigma_hat at -1 and -0.5 +- 0.5j rad/s. A larger gain is faster and less damped. The vehicle and"
        " its lags are in that loop, so the very high Gamma of the L1 law is not possible.",
        "theta_bound and sigma_bound limit the estimates, in N; sigma_bound must exceed the net buoyancy.",
    ),
    limits=(
        "There is no low-pass filter between estimates and control: Gamma trades robustness for speed.",
        "While the thrusters saturate, the reference model gets the delivered force, so that saturation"
        " changes no estimate.",
        shared_guide.HELD_CONTROL,
        shared_guide.REFERENCE_RATES,
    ),
    sources=(
        Source("P. Ioannou and J. Sun: Robust Adaptive Control, Prentice Hall, 1996, chapter 6."),
        Source("E. Lavretsky and K. Wise: Robust and Adaptive Control, Springer, 2013."),
    ),
)


BLOCK = depth_interface.depth_controller(
    __name__, "MracDepthController", "Model reference adaptive depth controller", calculated=DepthMatrices
)
