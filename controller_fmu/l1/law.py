"""The L1 adaptive control law for a second-order plant with one input and one output.

    u       = u_m + u_a + u_p,    u_m = -k_m x
    x_hat'  = A_m x_hat + B_m (omega_hat (u_a + u_p) + theta_hat' phi + sigma_hat)          (5)
    theta_hat_i' = Gamma Proj(theta_hat_i, -(x_tilde' P B_m) phi_i)                          (4)
    sigma_hat'   = Gamma Proj(sigma_hat, -(x_tilde' P B_m))
    omega_hat'   = Gamma Proj(omega_hat, -(x_tilde' P B_m) u_a)
    u_a(s)  = -k D(s) (eta_hat(s) - k_g r(s)),   eta_hat = omega_hat u_a + theta_hat' phi + sigma_hat   (6)

with x_tilde = x_hat - x and the regressor phi = x, or phi = (|x|_inf, 0).

The wiring that decides everything: the predictor receives u_a + u_p, eta_hat holds omega_hat u_a
alone. With either wrong the filter cancels u_p and the response is plain L1 again.

Source: Maalouf, Chemori and Creuze (2013); errata and additions in docs/fidelity.md. The step is
derived in docs/explanation/theory.md.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from controller_fmu.l1 import augmentation, lowpass
from controller_fmu.l1.augmentation import Augmentation, Threshold
from controller_fmu.l1.lowpass import FilterOrder, FilterState
from controller_fmu.l1.matrices import LawMatrices, Matrix, Vector, dot
from controller_fmu.l1.projection import keep_within, projection_factor
from fmus.block import variable
from fmus.numerics import absolute, maximum, where


class Regressor(IntEnum):
    """What theta_hat multiplies."""

    INFINITY_NORM = 1
    STATE = 2


@dataclass(frozen=True)
class LawParameters:
    """What every block with this law has in common; units that depend on the plant are added there."""

    internal_step: float = variable(
        0.01, "Longest internal step", unit="s", min=1e-6, max=10.0, variability="fixed"
    )
    regressor: Regressor = variable(
        Regressor.INFINITY_NORM, "Regressor that theta_hat multiplies", variability="fixed"
    )
    filter_order: FilterOrder = variable(
        FilterOrder.FIRST, "Order of the low-pass filter C(s)", variability="fixed"
    )
    augmentation: Augmentation = variable(
        Augmentation.NONE, "Extension u_p of the control law", variability="fixed"
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
        1.0, "Centre of the box of omega_hat, and its initial value", min=1e-3, max=1e3,
        variability="fixed", source="published: omega = 1",
    )  # fmt: skip
    input_gain_uncertainty: float = variable(
        0.0, "Half-width of the box of omega_hat; 0 holds it", min=0.0, max=1e3,
        source="published: omega is known",
    )  # fmt: skip
    filter_bandwidth: float = variable(
        1.0, "Bandwidth w of the low-pass filter C(s)", unit="rad/s", min=1e-6, max=1e6
    )
    nonlinear_exponent: float = variable(
        0.1, "Exponent alpha of the nonlinear P", min=1e-3, max=1.0, source="published, (9)"
    )


@dataclass(frozen=True)
class LawState:
    """What evolves: prediction, estimates, filter, and the integral of the tracking error."""

    x_hat: Vector = (0.0, 0.0)
    theta_hat: Vector = (0.0, 0.0)
    sigma_hat: float = 0.0
    omega_hat: float = 1.0
    filter: FilterState = FilterState()
    error_integral: float = 0.0


@dataclass(frozen=True)
class Measurement:
    """What the law sees during a step: state x, output y and reference r."""

    x: Vector = (0.0, 0.0)
    y: float = 0.0
    r: float = 0.0

    @property
    def error(self) -> float:
        """Tracking error e = y - r."""
        return self.y - self.r


@dataclass(frozen=True)
class Control:
    """The three parts of the control u."""

    u_m: float
    u_a: float
    u_p: float

    @property
    def total(self) -> float:
        return self.u_m + self.u_a + self.u_p


def infinity_norm(x: Vector) -> float:
    """|x|_inf, over the numbers in SI units."""
    return maximum(absolute(x[0]), absolute(x[1]))


def regressor(kind: Regressor, x: Vector) -> Vector:
    """phi, the vector that theta_hat multiplies."""
    by_norm = kind == Regressor.INFINITY_NORM
    return where(by_norm, infinity_norm(x), x[0]), where(by_norm, 0.0, x[1])


def initial_law(x: Vector, omega: float) -> LawState:
    """The prediction begins at the measured state, theta_hat and sigma_hat at zero."""
    return LawState(x_hat=x, omega_hat=omega)


def extension(parameters: Any, e: float, integral: float, r: float) -> float:
    """u_p of the chosen augmentation."""
    p = parameters
    pi = augmentation.proportional_integral(e, integral, p.proportional_gain, p.integral_gain)
    delta = augmentation.threshold(p.threshold, p.nonlinear_threshold, p.threshold_floor, r)
    nonlinear = augmentation.nonlinear_proportional(
        e, delta, p.nonlinear_exponent, p.large_error_gain, p.small_error_gain
    )
    other = where(p.augmentation == Augmentation.NONLINEAR_P, nonlinear, 0.0)
    return where(p.augmentation == Augmentation.PI, pi, other)


def control(law: LawState, seen: Measurement, k_m: Vector, parameters: Any) -> Control:
    """u = u_m + u_a + u_p."""
    return Control(
        u_m=-dot(k_m, seen.x),
        u_a=law.filter.u_a,
        u_p=extension(parameters, seen.error, law.error_integral, seen.r),
    )


def prediction_error(law: LawState, x: Vector) -> Vector:
    """x_tilde = x_hat - x."""
    return law.x_hat[0] - x[0], law.x_hat[1] - x[1]


def law_step(
    h: float,
    law: LawState,
    seen: Measurement,
    shortfall: float,
    parameters: Any,
    matrices: LawMatrices,
) -> LawState:
    """One step of h seconds by the implicit midpoint rule, the measurement held.

    `shortfall` is what the actuator delivers minus what was demanded, 0 unless it saturates: the
    predictor is told, and integrators stop where they would demand still more.

    With x held and the projection factors frozen, the only coupling between prediction,
    estimates and filter is the scalar s = x_tilde' P B_m at the middle of the step, so the
    implicit equations reduce to one linear equation for s. The rule is A-stable: a step longer
    than the period of the fast adaptation loop neither diverges nor limit-cycles.
    """
    p, half = parameters, 0.5 * h
    pb = matrices.adaptation_vector
    phi = regressor(p.regressor, seen.x)
    eta = dot(law.theta_hat, phi) + law.sigma_hat
    feedforward = matrices.feedforward_gain * seen.r
    u_a, omega = law.filter.u_a, law.omega_hat

    # e is held, so its integral grows linearly; the mean over the step is the value midway
    wound_up = shortfall * -seen.error < 0.0
    integral_growth = where(wound_up, 0.0, h * seen.error)
    midway_integral = law.error_integral + 0.5 * integral_growth
    u_p = extension(p, seen.error, midway_integral, seen.r)

    # x_hat = free_x + forced_x (forcing) midway
    free_x = _resolved(matrices.predictor_matrix, half, law.x_hat)
    b_1, b_2 = _resolved(matrices.predictor_matrix, half, matrices.predictor_input)
    forced_x = half * b_1, half * b_2

    # u_a = u_free - gain v midway, v = omega u_a + eta - k_g r; frozen where it winds up
    v_before = omega * u_a + eta - feedforward
    frozen = shortfall * lowpass.rate(p.filter_order, p.filter_bandwidth, law.filter, v_before) < 0.0
    u_free, gain = lowpass.midpoint_response(p.filter_order, p.filter_bandwidth, law.filter, half)
    u_free, gain = where(frozen, u_a, u_free), where(frozen, 0.0, gain)
    loop = 1.0 + gain * omega
    u_without_s = (u_free - gain * (eta - feedforward)) / loop
    forcing_without_s = omega * (u_without_s + u_p + shortfall) + eta

    # s = s_free / (1 + stiffness): its sign is known before the projection factors are
    s_free = dot(pb, free_x) - dot(pb, seen.x) + dot(pb, forced_x) * forcing_without_s
    g = _projection_factors(law, phi, s_free, u_without_s, p)
    rate = half * p.adaptation_gain
    eta_per_s = rate * (g.theta[0] * phi[0] ** 2 + g.theta[1] * phi[1] ** 2 + g.sigma)
    eta_hat_per_s = eta_per_s + rate * g.omega * u_without_s**2
    filtered_share = omega * gain / loop  # of eta_hat_per_s, 0..1
    # omega_hat acts on u_a + u_p but learns from u_a alone: implicit only as far as that is damping
    learnt = maximum(u_without_s * (u_without_s + u_p + shortfall), filtered_share * u_without_s**2)
    forcing_per_s = eta_per_s + rate * g.omega * learnt - filtered_share * eta_hat_per_s
    s = s_free / (1.0 + dot(pb, forced_x) * forcing_per_s)

    u_midway = u_without_s + gain * eta_hat_per_s / loop * s
    v = omega * u_midway + eta - eta_hat_per_s * s - feedforward
    forcing = forcing_without_s - forcing_per_s * s
    change = -2.0 * rate * s
    theta_1 = law.theta_hat[0] + change * g.theta[0] * phi[0]
    theta_2 = law.theta_hat[1] + change * g.theta[1] * phi[1]
    away = omega + change * g.omega * u_without_s - p.input_gain
    return LawState(
        x_hat=(
            2.0 * (free_x[0] + forced_x[0] * forcing) - law.x_hat[0],
            2.0 * (free_x[1] + forced_x[1] * forcing) - law.x_hat[1],
        ),
        theta_hat=(keep_within(theta_1, p.theta_bound[0]), keep_within(theta_2, p.theta_bound[1])),
        sigma_hat=keep_within(law.sigma_hat + change * g.sigma, p.sigma_bound),
        omega_hat=p.input_gain + keep_within(away, p.input_gain_uncertainty),
        filter=lowpass.advance(p.filter_order, p.filter_bandwidth, law.filter, half, v, shortfall),
        error_integral=law.error_integral + integral_growth,
    )


@dataclass(frozen=True)
class _Factors:
    """Proj(th, y) / y of each estimate."""

    theta: Vector
    sigma: float
    omega: float


def _projection_factors(law: LawState, phi: Vector, s: float, u_a: float, parameters: Any) -> _Factors:
    """Factors of the rates -s phi, -s and -s u_a, of which only the direction matters."""
    p, eps = parameters, parameters.projection_tolerance
    away = law.omega_hat - p.input_gain
    return _Factors(
        theta=(
            projection_factor(law.theta_hat[0], -s * phi[0], p.theta_bound[0], eps),
            projection_factor(law.theta_hat[1], -s * phi[1], p.theta_bound[1], eps),
        ),
        sigma=projection_factor(law.sigma_hat, -s, p.sigma_bound, eps),
        omega=projection_factor(away, -s * u_a, p.input_gain_uncertainty, eps),
    )


def _resolved(a_m: Matrix, half: float, vector: Vector) -> Vector:
    """(I - half A_m)^-1 vector."""
    (a_11, a_12), (a_21, a_22) = a_m
    m_11, m_12, m_21, m_22 = 1 - half * a_11, -half * a_12, -half * a_21, 1 - half * a_22
    m = m_11 * m_22 - m_12 * m_21
    return (m_22 * vector[0] - m_12 * vector[1]) / m, (m_11 * vector[1] - m_21 * vector[0]) / m
