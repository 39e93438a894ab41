"""Block L1Controller: the law of `law.py` for any plant of second order, with A_m, B_m, C and k_m given.

The start values are the paper's illustrative example (Maalouf et al. (2013), section 3.3), the example of
Hovakimyan and Cao (2010), page 29. Units follow from the plant.
"""

from dataclasses import asdict, dataclass

from controller_fmu import shared_guide
from controller_fmu.l1 import law as l1
from controller_fmu.l1.feedforward import feedforward_requirement, reference_feedforward
from controller_fmu.l1.law import LawState, Measurement
from controller_fmu.l1.matrices import (
    Matrix,
    SampledLawMatrices,
    Vector,
    dot,
    law_matrices,
    sampled_prediction,
)
from controller_fmu.l1.parameters import (
    EQUATIONS,
    LARGEST_BOUND,
    LAW_LIMITS,
    Augmentation,
    LawParameters,
    Regressor,
    Threshold,
    law_requirements,
)
from fmus.block import Block, variable
from fmus.block.guide import Experiment, Guide, Source
from fmus.numerics import clip

_BOOK = "Hovakimyan and Cao (2010), page 29, and public MATLAB programs; not printed in the paper"


@dataclass(frozen=True)
class Parameters(LawParameters):
    """Parameters: gains are tunable at communication points, structural choices are fixed."""

    regressor: Regressor = variable(
        Regressor.STATE, "Regressor that theta_hat multiplies", variability="fixed"
    )
    augmentation: Augmentation = variable(
        Augmentation.NONLINEAR_P, "Extension u_p of the control law", variability="fixed"
    )
    threshold: Threshold = variable(
        Threshold.PROPORTIONAL_TO_REFERENCE,
        "Kind of the threshold of the nonlinear P",
        variability="fixed",
        source="published, (9)",
    )
    filter_bandwidth: float = variable(
        160.0, "Bandwidth w of the low-pass filter C(s)", unit="rad/s", min=1e-6, max=1e6, source="published"
    )
    state_matrix: Matrix = variable(
        ((0.0, 1.0), (-1.0, -1.4)), "A_m, desired dynamics, Hurwitz", source=_BOOK
    )
    input_vector: Vector = variable((0.0, 1.0), "B_m, input column", source=_BOOK)
    output_vector: Vector = variable((1.0, 0.0), "C, output row", source=_BOOK)
    feedback_gain: Vector = variable((0.0, 0.0), "k_m, state feedback", source="published: k_m = 0")
    lyapunov_weight: Vector = variable(
        (1.0, 1.0), "Diagonal of Q in the Lyapunov equation", min=1e-9, max=1e9, source=_BOOK
    )
    theta_bound: Vector = variable(
        (10.0, 10.0), "Bound of |theta_hat|", min=0.0, max=LARGEST_BOUND, source=_BOOK
    )
    sigma_bound: float = variable(
        0.0, "Bound of |sigma_hat|; 0 holds it at zero", min=0.0, max=1e6, source="published: sigma = 0"
    )
    initial_u_a: float = variable(0.0, "Adaptive control at the start", variability="fixed", source="assumed")
    initial_sigma_hat: float = variable(
        0.0, "Estimate at the start, within its bound", variability="fixed", source="assumed"
    )
    proportional_gain: float = variable(0.0, "K_P of the PI", min=0.0, max=1e6)
    integral_gain: float = variable(0.0, "K_I of the PI", min=0.0, max=1e6)
    large_error_gain: float = variable(
        25.0, "a_1 of the nonlinear P", min=0.0, max=1e6, source="published, (9)"
    )
    small_error_gain: float = variable(
        100.0, "a_2 of the nonlinear P", min=0.0, max=1e6, source="published, (9)"
    )
    nonlinear_threshold: float = variable(
        0.1, "delta, or delta / |r|; see threshold", min=0.0, max=1e6, source="published, (9)"
    )
    threshold_floor: float = variable(
        1.0,
        "Least delta of the nonlinear P",
        min=1e-9,
        max=1e6,
        source="guess: 1 % of the amplitude of the reference",
    )
    control_limit: float = variable(1e6, "Largest |u| that the actuator delivers", min=1e-9, max=1e12)


@dataclass(frozen=True)
class Inputs:
    reference: float = variable(0.0, "Reference r")
    reference_rate: float = variable(0.0, "Its rate r', used by reference_feedforward")
    reference_acceleration: float = variable(0.0, "Its acceleration r'', used by reference_feedforward")
    measured_state: Vector = variable((0.0, 0.0), "Measured state x")


@dataclass(frozen=True)
class State:
    law: LawState = LawState()


@dataclass(frozen=True)
class Outputs:
    control: float = variable(0.0, "u = u_m + u_a + u_p + u_f, saturated")
    u_m: float = variable(0.0, "State feedback -k_m x")
    u_a: float = variable(0.0, "Adaptive control")
    u_p: float = variable(0.0, "Extension: PI or nonlinear P")
    u_f: float = variable(0.0, "Reference feedforward outside the filter")
    theta_hat: Vector = variable((0.0, 0.0), "Estimate theta_hat")
    sigma_hat: float = variable(0.0, "Estimate sigma_hat")
    omega_hat: float = variable(1.0, "Estimate omega_hat of the input gain")
    sigma_u: float = variable(0.0, "Estimate of the unmatched disturbance, piecewise-constant law")
    predicted_state: Vector = variable((0.0, 0.0), "Predicted state x_hat")
    prediction_error: Vector = variable((0.0, 0.0), "x_tilde = x_hat - x")
    tracking_error: float = variable(0.0, "e = y - r")


def calculate(p: Parameters) -> SampledLawMatrices:
    law = law_matrices(p.state_matrix, p.input_vector, p.output_vector, p.lyapunov_weight)
    error = sampled_prediction(p.input_vector, p.prediction_error_matrix, p.adaptation_period)
    return SampledLawMatrices(**(asdict(law) | asdict(error)))


def requirements(p: Parameters, matrices: SampledLawMatrices) -> tuple:
    return (
        *law_requirements(p, p.state_matrix),
        feedforward_requirement(p.reference_feedforward, p.input_vector, p.output_vector),
    )


def initial_state(t: float, inputs: Inputs, p: Parameters, matrices: SampledLawMatrices) -> State:
    return State(l1.initial_law(_measurement(inputs, p, matrices), p))


def step(
    t: float, h: float, state: State, inputs: Inputs, p: Parameters, matrices: SampledLawMatrices
) -> State:
    u = l1.control(state.law, p.feedback_gain, p)
    delivered = _saturated(u.total, p)
    saturation_error, now = delivered - u.total, _measurement(inputs, p, matrices)
    return State(l1.law_step(h, state.law, now, u, delivered, saturation_error, p.feedback_gain, p, matrices))


def output(t: float, state: State, p: Parameters, matrices: SampledLawMatrices) -> Outputs:
    law, u = state.law, l1.control(state.law, p.feedback_gain, p)
    return Outputs(
        **l1.outputs(law, u),
        control=_saturated(u.total, p),
        predicted_state=l1.predicted_state(law),
        prediction_error=law.estimates.x_tilde,
        tracking_error=law.measured.error,
    )


def _saturated(u: float, p: Parameters) -> float:
    return clip(u, -p.control_limit, p.control_limit)


def _measurement(inputs: Inputs, p: Parameters, matrices: SampledLawMatrices) -> Measurement:
    r, x = inputs.reference, inputs.measured_state
    f = reference_feedforward(r, inputs.reference_rate, inputs.reference_acceleration, matrices)
    return Measurement(x=x, y=dot(p.output_vector, x), r=r, f=f)


GUIDE = Guide(
    equations=EQUATIONS
    + """
y            = C x,   u saturated at +-control_limit
""",
    conventions=(
        "All quantities are in the units of the plant at hand, time in s; the description calls them"
        " dimensionless.",
        "tracking_error is e = y - r: positive when the output is above the reference.",
        "prediction_error is x_hat - x at the time of the last measurement.",
    ),
    tuning=(
        "state_matrix (A_m, Hurwitz), input_vector (B_m) and output_vector (C) are the desired dynamics,"
        " with feedback_gain k_m: A_m is the matrix of the loop that u_m closes.",
        "theta_bound, sigma_bound and input_gain_uncertainty limit the estimates; a bound of 0 freezes"
        " the estimate.",
        "The L1-norm condition requires a filter_bandwidth of at least 44.5 rad/s for the start values with"
        " the first-order filter, 36.4 rad/s with the third-order one.",
        "adaptation_gain may be large: a step solves the oscillation of prediction error and estimates"
        " exactly.",
        "Without augmentation, the lag comes from A_m, not from the filter; augmentation removes most. With"
        " nonlinear_p, a_1 = a_2 avoids a jump at |e| = delta; threshold_floor keeps delta above 0"
        " where the reference crosses zero.",
        "If the derivatives of the reference are known, connect reference_rate and reference_acceleration and"
        " set reference_feedforward: 'inside' leaves the lag of the filter, 'outside' no lag."
        " Both need C B_m = 0.",
        "adaptation_law piecewise_constant has no fast loop and needs no gain or bounds; set"
        " adaptation_period to the communication step, and prediction_error_matrix A_s so slow that"
        " e^(A_s Ts) is near I.",
    ),
    limits=(
        *LAW_LIMITS,
        "For second-order plants with one input, one output and measured state.",
        "Start values are the paper's illustrative example, a_1 and a_2 as printed: u_p then jumps by a"
        " factor of 4 at |e| = delta.",
    ),
    sources=(
        shared_guide.PAPER,
        Source("N. Hovakimyan and C. Cao: L1 Adaptive Control Theory, SIAM, 2010 (the example, page 29)."),
    ),
    experiment=Experiment(
        stop_time=4.0,
        stimuli=(
            ("reference", ((0.0, 1.175), (2.0, 1.425), (2.1, 1.5), (2.4, 1.5), (4.0, 1.675))),
            ("measured_state[1]", ((0.0, 1.0), (4.0, 1.5))),
            ("measured_state[2]", ((0.0, 0.125), (3.0, 0.125), (3.2, 0.13))),
        ),
    ),
)


BLOCK = Block.of_module(
    __name__,
    "L1Controller",
    "Extended L1 adaptive controller for a plant of second order",
    calculated=SampledLawMatrices,
    stop_time=94.25,
    step_size=1e-3,
    license="MIT",
)
