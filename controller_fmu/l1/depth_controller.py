"""Block L1DepthController: measured depth and reference in, two thruster voltages out.

z points down. Source: Maalouf et al. (2013), section 4.
"""

from dataclasses import asdict, dataclass

from controller_fmu import depth_interface, shared_guide
from controller_fmu.depth_interface import (
    Delivery,
    DepthInputs,
    DepthMeasurement,
    DepthOutputs,
    DepthState,
    Vector,
)
from controller_fmu.depth_model import DepthMatrices, depth_matrices
from controller_fmu.l1 import law as l1
from controller_fmu.l1.feedforward import reference_feedforward
from controller_fmu.l1.law import Control, LawState, Measurement
from controller_fmu.l1.matrices import Matrix, SampledLawMatrices, sampled_prediction
from controller_fmu.l1.parameters import (
    EQUATIONS,
    LARGEST_BOUND,
    LAW_LIMITS,
    LawParameters,
    law_requirements,
)
from fmus.block import variable
from fmus.block.guide import Guide, Source


@dataclass(frozen=True)
class Parameters(depth_interface.DesignParameters, LawParameters):
    """Parameters: gains are tunable at communication points, structural choices are fixed."""

    depth_feedback_gain: float = variable(
        1.895,
        "State feedback k_m of the depth",
        unit="N/m",
        min=1e-6,
        max=1e6,
        source="identified, docs/fidelity.md",
    )
    rate_feedback_gain: float = variable(
        20.23,
        "State feedback k_m of the depth rate",
        unit="N.s/m",
        min=0.0,
        max=1e6,
        source="identified, docs/fidelity.md",
    )
    adaptation_gain: float = variable(
        100.0,
        "Adaptation gain Gamma",
        min=0.0,
        max=1e9,
        source="guess: the paper calls it very high and gives 1e4 for the example; docs/fidelity.md",
    )
    filter_bandwidth: float = variable(
        0.3017,
        "Bandwidth w of the low-pass filter C(s)",
        unit="rad/s",
        min=1e-6,
        max=1e6,
        source="identified, docs/fidelity.md",
    )
    lyapunov_weight: Vector = variable(
        (1.0, 1.0), "Diagonal of Q in the Lyapunov equation", min=1e-9, max=1e9, source="guess"
    )
    theta_bound: Vector = variable(
        (5.0, 5.0),
        "Bound of |theta_hat|",
        unit="N",
        min=0.0,
        max=LARGEST_BOUND,
        source="guess within the L1-norm condition; N per SI unit of the regressor",
    )
    sigma_bound: float = variable(10.0, "Bound of |sigma_hat|", unit="N", min=0.0, max=1e6, source="guess")
    initial_u_a: float = variable(
        0.0, "Adaptive control at the start", unit="N", variability="fixed", source="assumed"
    )
    initial_sigma_hat: float = variable(
        0.0,
        "Estimate at the start, within its bound",
        unit="N",
        variability="fixed",
        source="published: zero",
    )
    proportional_gain: float = variable(
        3.967, "K_P of the PI", unit="N/m", min=0.0, max=1e6, source="identified, docs/fidelity.md"
    )
    integral_gain: float = variable(
        0.00499, "K_I of the PI", unit="N/(m.s)", min=0.0, max=1e6, source="identified, docs/fidelity.md"
    )
    large_error_gain: float = variable(
        1.0, "a_1 of the nonlinear P, in N per m^alpha", min=0.0, max=1e6, source="guess"
    )
    small_error_gain: float = variable(
        1.0, "a_2 of the nonlinear P, in N per m^alpha", min=0.0, max=1e6, source="guess"
    )
    nonlinear_threshold: float = variable(
        0.1, "delta in m, or delta / |r|; see threshold", min=0.0, max=1e6, source="guess"
    )
    threshold_floor: float = variable(
        0.01, "Least delta of the nonlinear P", unit="m", min=1e-9, max=1e6, source="guess"
    )
    adaptation_period: float = variable(
        0.04,
        "Sampling period Ts of the piecewise-constant law",
        unit="s",
        min=1e-6,
        max=10.0,
        variability="fixed",
        source="guess: the period of the depth sensor",
    )
    prediction_error_matrix: Matrix = variable(
        ((-0.1, 0.0), (0.0, -0.1)),
        "A_s of the piecewise-constant law, Hurwitz",
        unit=(("1/s", "1"), ("1/s2", "1/s")),
        min=-1e6,
        max=1e6,
        source="guess: estimates are e^(A_s Ts) times the disturbance, 0.4 % less here",
    )


@dataclass(frozen=True)
class Matrices(DepthMatrices, SampledLawMatrices):
    """The calculated parameters with the vehicle's units."""

    error_transition: Matrix = variable(
        ((1.0, 0.0), (0.0, 1.0)), "e^(A_s Ts)", unit=(("1", "s"), ("1/s", "1"))
    )
    error_input: Matrix = variable(
        ((1.0, 0.0), (0.0, 1.0)), "Phi = A_s^-1 (e^(A_s Ts) - I)", unit=(("s", "s2"), ("1", "s"))
    )
    estimation_gain: Matrix = variable(
        ((0.0, 1.0), (1.0, 0.0)),
        "-[B_m, B_u]^-1 Phi^-1 e^(A_s Ts), prediction error to estimates",
        unit=(("N/m", "N.s/m"), ("1/s", "1")),
    )


@dataclass(frozen=True)
class State:
    law: LawState = LawState()
    interface: DepthState = DepthState()


@dataclass(frozen=True)
class Outputs(DepthOutputs):
    demanded_force: float = variable(0.0, "u = u_m + u_a + u_p + u_f, earth frame, positive down", unit="N")
    u_m: float = variable(0.0, "State feedback -k_m x", unit="N")
    u_a: float = variable(0.0, "Adaptive control", unit="N")
    u_p: float = variable(0.0, "Extension: PI or nonlinear P", unit="N")
    u_f: float = variable(0.0, "Reference feedforward outside the filter", unit="N")
    theta_hat: Vector = variable((0.0, 0.0), "Estimate theta_hat, per SI unit of the regressor", unit="N")
    sigma_hat: float = variable(0.0, "Estimate sigma_hat", unit="N")
    omega_hat: float = variable(1.0, "Estimate omega_hat of the input gain")
    sigma_u: float = variable(
        0.0, "Estimate of the unmatched disturbance, piecewise-constant law", unit="m/s"
    )
    predicted_depth: float = variable(0.0, "Predicted state x_hat, depth", unit="m")
    predicted_depth_rate: float = variable(0.0, "Predicted state x_hat, depth rate", unit="m/s")
    depth_prediction_error: float = variable(0.0, "x_tilde = x_hat - x, depth", unit="m")
    depth_rate_prediction_error: float = variable(0.0, "x_tilde = x_hat - x, depth rate", unit="m/s")


def calculate(p: Parameters) -> Matrices:
    vehicle = depth_matrices(_state_feedback(p), p.lyapunov_weight, p)
    sampled = sampled_prediction(vehicle.predictor_input, p.prediction_error_matrix, p.adaptation_period)
    return Matrices(**(asdict(vehicle) | asdict(sampled)))


def requirements(p: Parameters, matrices: Matrices) -> tuple:
    return (
        *law_requirements(p, matrices.predictor_matrix),
        *depth_interface.requirements(p, matrices),
    )


def initial_state(t: float, inputs: DepthInputs, p: Parameters, matrices: Matrices) -> State:
    """Returns the state at rest on the first measurement."""
    interface = depth_interface.first_state(t, inputs, p)
    return State(l1.initial_law(_measurement(interface.measured, matrices), p), interface)


def step(t: float, h: float, state: State, inputs: DepthInputs, p: Parameters, matrices: Matrices) -> State:
    u = control(state.law, p)
    given = depth_interface.deliver(u.total, state.interface.j, p)
    return after_delivery(t, h, state, inputs, u, given, p, matrices)


def after_delivery(
    t: float,
    h: float,
    state: State,
    inputs: DepthInputs,
    u: Control,
    given: Delivery,
    p: Parameters,
    matrices: Matrices,
) -> State:
    """Returns the state h seconds later; given: the delivery of the thrusters for its control u meanwhile."""
    interface = depth_interface.next_state(t, state.interface, inputs, p)
    now, k_m = _measurement(interface.measured, matrices), _state_feedback(p)
    law = l1.law_step(h, state.law, now, u, given.force, given.saturation_error, k_m, p, matrices)
    return State(law, interface)


def output(t: float, state: State, p: Parameters, matrices: Matrices) -> Outputs:
    law, interface, u = state.law, state.interface, control(state.law, p)
    predicted, x_tilde = l1.predicted_state(law), law.estimates.x_tilde
    return Outputs(
        **depth_interface.outputs(u.total, interface.measured, interface.j, p),
        **l1.outputs(law, u),
        predicted_depth=predicted[0],
        predicted_depth_rate=predicted[1],
        depth_prediction_error=x_tilde[0],
        depth_rate_prediction_error=x_tilde[1],
    )


def _measurement(measured: DepthMeasurement, matrices: Matrices) -> Measurement:
    z, r = measured.depth, measured.reference
    f = reference_feedforward(r, measured.reference_rate, measured.reference_acceleration, matrices)
    return Measurement(x=(z, measured.rate), y=z, r=r, f=f)


def _state_feedback(p: Parameters) -> Vector:
    return p.depth_feedback_gain, p.rate_feedback_gain


def control(law: LawState, p: Parameters) -> Control:
    """Returns the control until the next step."""
    return l1.control(law, _state_feedback(p), p)


GUIDE = Guide(
    equations=EQUATIONS
    + """
x            = (z, z'),   A_m = [[0, 1], [-k_m1 / M_z, -(D_z + k_m2) / M_z]],   B_m = [0, 1 / M_z]   (13)
y            = C x = z
"""
    + shared_guide.ALLOCATION
    + shared_guide.OBSERVER,
    conventions=shared_guide.CONVENTIONS,
    tuning=(
        "Begin with the vehicle: model_inertia with added mass, model_damping, thruster_gain (measure it) and"
        " voltage_limit. The adaptation has to compensate their errors.",
        "depth_feedback_gain and rate_feedback_gain determine A_m, the desired dynamics of the loop. Without"
        " augmentation, the depth lags on a ramp by about"
        " (model_damping + rate_feedback_gain) / depth_feedback_gain + 1 / filter_bandwidth seconds.",
        "A larger filter_bandwidth makes the adaptive control faster and noisier, with less delay margin.",
        "A larger adaptation_gain makes the estimates faster and noisier; it needs no shorter step. The"
        " sensor delay that the loop with RovDepthPlant tolerates is not monotonic: 204 ms with a gain of"
        " 100, 17 ms with 1000, 131 ms with 1e4. Watch sigma_hat and the voltages as well as the depth.",
        "theta_bound and sigma_bound limit the estimates, in N; sigma_bound must exceed the net buoyancy."
        " If an estimate stays on its bound, the bound is too small or the adaptation too fast.",
        "augmentation reduces the lag. With pi, raise proportional_gain first, then integral_gain a little."
        " With nonlinear_p, large_error_gain = small_error_gain avoids a jump at nonlinear_threshold.",
        "If the derivatives of the reference are known, connect depth_reference_rate and"
        " depth_reference_acceleration and set reference_feedforward: 'inside' leaves the lag of the"
        " filter, 'outside' no lag. augmentation then acts on the remaining error.",
        "adaptation_law piecewise_constant needs no adaptation_gain and no bounds. It differentiates the"
        " depth rate over adaptation_period, so its estimates are noisier. Slow eigenvalues of"
        " prediction_error_matrix A_s give the least bias; an adaptation_period below observer_period"
        " only adds noise.",
        shared_guide.OBSERVER_TUNING,
    ),
    limits=(
        *LAW_LIMITS,
        "The paper publishes no gains for its vehicle. In the column Source, identified means fitted to the"
        " nominal rows of its Table 1; most other gains are guesses. All were chosen on RovDepthPlant.",
        "The sensor delays stated for adaptation_gain are limits: beyond, a depth held at 0.8 m oscillates,"
        " with a standard deviation above 3 mm.",
        shared_guide.VEHICLE_LIMIT,
    ),
    sources=(
        shared_guide.PAPER,
        shared_guide.OBSERVER_SOURCE,
        Source(
            "T. Benedict and G. Bordner: Synthesis of an optimal set of radar track-while-scan smoothing"
            " equations, IRE Transactions on Automatic Control, 1962 (beta_o from alpha_o)."
        ),
    ),
    experiment=shared_guide.EXPERIMENT,
)


BLOCK = depth_interface.depth_controller(
    __name__,
    "L1DepthController",
    "Extended L1 adaptive depth controller for an underwater vehicle",
    calculated=Matrices,
)
