"""The equations of the law, its choices, and the parameters that every block with this law has."""

from dataclasses import dataclass
from enum import IntEnum

from controller_fmu.l1.matrices import FASTEST, Matrix, Vector, can_be_sampled, is_hurwitz
from fmus.block import variable

EQUATIONS = """\
x'           = A_m x + B_m (omega (u - u_m) + theta^T phi + sigma)           assumed plant
u            = u_m + u_a + u_p + u_f,   u_m = -k_m x
x_hat'       = A_m x_hat + B_m (omega_hat (u_a + u_p + u_f) + theta_hat^T phi + sigma_hat)  (5)
theta_hat_i' = Gamma Proj(theta_hat_i, -(x_tilde^T P B_m) phi_i),   x_tilde = x_hat - x     (4)
sigma_hat'   = Gamma Proj(sigma_hat, -(x_tilde^T P B_m))
omega_hat'   = Gamma Proj(omega_hat, -(x_tilde^T P B_m) u_omega)
u_a(s)       = -k D(s) (omega_hat u_a + theta_hat^T phi + sigma_hat - v)                    (6)
C(s)         = k D / (1 + k D)
Proj(a, b)   = (1 - p) b   where a b > 0 and p = ((1 + eps) a^2 / a_max^2 - 1) / eps > 0, else b
             a_max: bound of a; for omega_hat, a = omega_hat - input_gain
A_m^T P + P A_m = -Q,   k_g = -1 / (C A_m^-1 B_m)

phi          = (|x|_inf, 0)    regressor infinity_norm
               x               regressor state
u_omega      = u_a + u_f        input_gain_regressor adaptive_control
               u_a + u_f + u_p  input_gain_regressor adaptive_control_and_extension
C(s)         = w / (s + w)                         filter_order first
               (3 w^2 s + w^3) / (s + w)^3         filter_order third

v = k_g r, u_f = 0                                 reference_feedforward none
v = f, u_f = 0                                     reference_feedforward inside
v = (1 - omega_hat) f, u_f = f                     reference_feedforward outside
f            = k_g (r - (tr(A_m) r' - r'') / det(A_m)),   for C B_m = 0

u_p          = 0                                   augmentation none
               -K_P e - int K_I e dt,   e = y - r  augmentation pi            (7)
               -a_1 |e|^alpha sgn(e)               augmentation nonlinear_p   (8), |e| > delta
               -a_2 e / delta^(1 - alpha)                                     (8), elsewhere

With adaptation_law piecewise_constant, theta_hat = 0, omega_hat = input_gain; new estimates at every Ts:
x_hat'       = A_m x + A_s x_tilde + B_m (omega_hat (u_a + u_p + u_f) + sigma_hat) + B_u sigma_u
(sigma_hat, sigma_u) = -[B_m, B_u]^-1 Phi^-1 e^(A_s Ts) x_tilde,   Phi = A_s^-1 (e^(A_s Ts) - I)
"""


LAW_LIMITS = (
    "The L1-norm condition, which the proof of stability needs, assumes perfect measurements, no extension"
    " u_p, no delay and no lag of an actuator. The FMU does not check it. The paper proves nothing about"
    " the loop with the extension.",
    "With input_gain_uncertainty above 0, omega_hat multiplies u_a + u_p + u_f but is estimated from"
    " u_a + u_f, which the proof does not cover. Set input_gain_regressor to adaptive_control_and_extension"
    " to estimate it from all three: the proof then covers omega_hat, not the loop; tracking is not better.",
    "In saturation, the predictor gets the limited control. The states of the filter and the integral of the"
    " PI are held if their change would increase the demand. Noise near the limit holds them, too: keep the"
    " demand and its noise below the limit.",
    "The reference feedforward and the piecewise-constant law are not from the paper. The feedforward"
    " inverts A_m exactly, given the derivatives of the reference; it leaves out the impulse of"
    " acceleration at a corner. The piecewise-constant law estimates e^(A_s Ts) times the disturbance,"
    " without bounds.",
    "A communication step should not be longer than internal_step. In a longer step, the predictor gets the"
    " control of each internal step, the plant only the last one, so the control varies more. For a"
    " Gauss-Seidel master, which sets the inputs of a step's end, set inputs_at_step_end.",
)


class AdaptationLaw(IntEnum):
    """Law by which the estimates follow from the prediction error."""

    PROJECTION = 1
    PIECEWISE_CONSTANT = 2


class Regressor(IntEnum):
    """Regressor that theta_hat multiplies."""

    INFINITY_NORM = 1
    STATE = 2


class InputGainRegressor(IntEnum):
    """Regressor of the input gain: the control from which omega_hat is estimated."""

    ADAPTIVE_CONTROL = 1
    ADAPTIVE_CONTROL_AND_EXTENSION = 2


class FilterOrder(IntEnum):
    """Order of C(s) in the control law."""

    FIRST = 1
    THIRD = 3


class Augmentation(IntEnum):
    """The extension u_p of the control law."""

    NONE = 1
    PI = 2
    NONLINEAR_P = 3


class Threshold(IntEnum):
    """Kind of the threshold delta of the nonlinear P."""

    FIXED = 1
    PROPORTIONAL_TO_REFERENCE = 2


class ReferenceFeedforward(IntEnum):
    """Place of the reference feedforward f: none, inside the filter instead of k_g r, or added behind it."""

    NONE = 1
    INSIDE = 2
    OUTSIDE = 3


class PlantParameters:
    """Parameters of the law that each block declares itself, in the units of its plant."""

    theta_bound: Vector
    sigma_bound: float
    initial_u_a: float
    initial_sigma_hat: float
    proportional_gain: float
    integral_gain: float
    nonlinear_threshold: float
    threshold_floor: float
    large_error_gain: float
    small_error_gain: float


# Limits of parameters, from which ranges of states follow: s, bound of theta_hat, input gain.
LONGEST_STEP, LARGEST_BOUND, LARGEST_GAIN = 10.0, 1e6, 1e3


@dataclass(frozen=True)
class LawParameters(PlantParameters):
    """Parameters of every block with this law."""

    internal_step: float = variable(
        10.0,
        "Longest internal step; best not below the communication step",
        unit="s",
        min=1e-7,
        max=LONGEST_STEP,
        variability="fixed",
    )
    regressor: Regressor = variable(
        Regressor.INFINITY_NORM, "Regressor that theta_hat multiplies", variability="fixed"
    )
    filter_order: FilterOrder = variable(
        FilterOrder.FIRST, "Order of the low-pass filter C(s)", variability="fixed"
    )
    augmentation: Augmentation = variable(
        Augmentation.PI, "Extension u_p of the control law", variability="fixed"
    )
    threshold: Threshold = variable(
        Threshold.FIXED, "Kind of the threshold of the nonlinear P", variability="fixed"
    )
    adaptation_gain: float = variable(
        1e4, "Adaptation gain Gamma", min=0.0, max=1e9, source="published for the example"
    )
    projection_tolerance: float = variable(
        0.1, "Width eps of the boundary layer of the projection", min=1e-6, max=10.0, source="guess"
    )
    input_gain: float = variable(
        1.0,
        "Centre of the range of omega_hat, and its initial value",
        min=1e-3,
        max=LARGEST_GAIN,
        variability="fixed",
        source="published: omega = 1",
    )
    input_gain_uncertainty: float = variable(
        0.0,
        "Half-width of the range of omega_hat; 0 fixes it",
        min=0.0,
        max=LARGEST_GAIN,
        source="published: omega is known",
    )
    filter_bandwidth: float = variable(
        1.0, "Bandwidth w of the low-pass filter C(s)", unit="rad/s", min=1e-6, max=1e6
    )
    nonlinear_exponent: float = variable(
        0.1, "Exponent alpha of the nonlinear P", min=1e-3, max=1.0, source="published, (9)"
    )
    input_gain_regressor: InputGainRegressor = variable(
        InputGainRegressor.ADAPTIVE_CONTROL,
        "Control from which omega_hat is estimated",
        variability="fixed",
        source="published: u_a, as in (4), which has no extension",
    )
    inputs_at_step_end: bool = variable(
        False,
        "Whether inputs belong to the end of a step (Gauss-Seidel), not to its beginning (Jacobi)",
        variability="fixed",
    )
    reference_feedforward: ReferenceFeedforward = variable(
        ReferenceFeedforward.NONE, "Where the feedforward f of the reference acts", variability="fixed"
    )
    adaptation_law: AdaptationLaw = variable(
        AdaptationLaw.PROJECTION, "How the estimates follow from the prediction error", variability="fixed"
    )
    adaptation_period: float = variable(
        1e-3,
        "Sampling period Ts of the piecewise-constant law",
        unit="s",
        min=1e-6,
        max=LONGEST_STEP,
        variability="fixed",
        source="guess",
    )
    prediction_error_matrix: Matrix = variable(
        ((-1.0, 0.0), (0.0, -1.0)),
        "A_s of the piecewise-constant law, Hurwitz",
        min=-1e6,
        max=1e6,
        source="guess: estimates are e^(A_s Ts) times the disturbance, 0.1 % less here",
    )


def law_requirements(parameters: LawParameters, a_m: Matrix) -> tuple[tuple[bool, str], ...]:
    """Returns the requirements: A_m and A_s Hurwitz, A_s not too fast for its period, omega_hat above 0."""
    p = parameters
    return (
        (is_hurwitz(a_m), "a Hurwitz A_m (trace < 0 and determinant > 0)"),
        (
            is_hurwitz(p.prediction_error_matrix),
            "a Hurwitz prediction_error_matrix A_s (trace < 0 and determinant > 0)",
        ),
        (
            can_be_sampled(p.prediction_error_matrix, p.adaptation_period),
            f"a trace of prediction_error_matrix above -{FASTEST:g} / adaptation_period: the estimates are"
            " e^(A_s Ts) times the disturbance",
        ),
        (
            p.input_gain_uncertainty < p.input_gain,
            "input_gain_uncertainty below input_gain, so that omega_hat stays positive",
        ),
    )
