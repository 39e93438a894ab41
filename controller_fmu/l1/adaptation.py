"""Prediction and adaptation from one measurement to the next.

The prediction error x_tilde = x_hat - x and the matched part eta of the prediction obey

    x_tilde' = A_m x_tilde + B_m eta + (A_m x - x'),   eta = omega_hat u + theta_hat' phi + sigma_hat
    eta'     = -kappa s,   s = x_tilde' P B_m,   kappa = Gamma (g_theta |phi|^2 + g_sigma + g_omega u_omega u)

between two measurements, with x a straight line, u the control that the plant received, and phi and the
projection factors g constant. Without A_m x_tilde this turns s and eta by the angle h sqrt(kappa B_m' P B_m),
which is exact for any angle; A_m x_tilde acts for half the time before and half after (Strang).
docs/explanation/theory.md describes the step.
"""

from dataclasses import dataclass

from controller_fmu.l1.matrices import LawMatrices, Vector, dot, relaxed
from controller_fmu.l1.parameters import (
    LARGEST_BOUND,
    LARGEST_GAIN,
    InputGainRegressor,
    LawParameters,
    Regressor,
)
from controller_fmu.l1.projection import keep_within, projection_factor
from fmus.block import variable
from fmus.numerics import absolute, maximum, sin, sqrt, where

# of an angle: below it sin(a) / a is 1 to the last bit
_SMALL_SQUARE = 1e-16
# s; the mean over a shorter time is the value
_SHORTEST = 1e-9
# keeps the share of omega_hat finite where all gains are 0
_SMALLEST = 1e-300


@dataclass(frozen=True)
class Estimates:
    """Prediction error and the estimates, at the time of a measurement of x.

    Only the piecewise-constant law estimates sigma_u. Its estimates have no bounds.
    """

    x_tilde: Vector = variable((0.0, 0.0), "Prediction error x_hat - x")
    theta_hat: Vector = variable((0.0, 0.0), "Estimate theta_hat", min=-LARGEST_BOUND, max=LARGEST_BOUND)
    sigma_hat: float = variable(0.0, "Estimate sigma_hat")
    omega_hat: float = variable(1.0, "Estimate of the input gain", min=0.0, max=2.0 * LARGEST_GAIN)
    sigma_u: float = variable(0.0, "Estimate of the unmatched disturbance")


@dataclass(frozen=True)
class Interval:
    """Interval between two measurements.

    duration [s]; x at both ends; u_ap: the control that the plant received less u_m, hence u_a + u_p + u_f
    plus the saturation error; u_a: its part that precedes the extension
    """

    duration: float
    x_0: Vector
    x_1: Vector
    u_ap: float
    u_a: float


def regressor(kind: Regressor, x: Vector) -> Vector:
    """Returns phi, the vector that theta_hat multiplies: (|x|_inf, 0) of numbers in SI units, or x."""
    by_norm = kind == Regressor.INFINITY_NORM
    norm = maximum(absolute(x[0]), absolute(x[1]))
    return where(by_norm, norm, x[0]), where(by_norm, 0.0, x[1])


def adapt(
    before: Estimates, over: Interval, parameters: LawParameters, matrices: LawMatrices
) -> tuple[Estimates, float]:
    """Returns the estimates at the end of the interval, and the mean of theta_hat' phi + sigma_hat over it.

    The mean has the phi of the end of the interval, the newest one.
    """
    # The turn is exact in h: neither frequency nor damping of the fast loop depends on the step.
    p, h, u = parameters, over.duration, over.u_ap
    pb, b = matrices.adaptation_vector, matrices.predictor_input
    pbb = dot(pb, b)
    x = 0.5 * (over.x_0[0] + over.x_1[0]), 0.5 * (over.x_0[1] + over.x_1[1])
    phi = regressor(p.regressor, x)
    u_omega = where(p.input_gain_regressor == InputGainRegressor.ADAPTIVE_CONTROL, over.u_a, u)

    # without adaptation: x_tilde grows by drift + h B_m eta, s by `growth`
    x_tilde = relaxed(matrices.predictor_matrix, 0.5 * h, before.x_tilde)
    drift = (
        h * dot(matrices.predictor_matrix[0], x) - (over.x_1[0] - over.x_0[0]),
        h * dot(matrices.predictor_matrix[1], x) - (over.x_1[1] - over.x_0[1]),
    )
    eta = dot(before.theta_hat, phi) + before.sigma_hat + before.omega_hat * u
    s, growth = dot(pb, x_tilde), dot(pb, drift) + h * pbb * eta

    g = _projection_factors(before, phi, s + 0.5 * growth, u_omega, p)
    # omega_hat acts on u and may learn from another control: only where both have one sign is this damping
    learnt = maximum(u_omega * u, 0.0)
    kappa = g.theta[0] * phi[0] ** 2 + g.theta[1] * phi[1] ** 2 + g.sigma + g.omega * learnt
    square = h * h * p.adaptation_gain * kappa * pbb
    half_turn, turn = _sinc(0.25 * square), _sinc(square)
    integral_of_s = h * (s * turn + 0.5 * growth * half_turn**2)
    integral_of_eta = (growth * turn - dot(pb, drift) - 0.5 * s * square * half_turn**2) / pbb

    change = -p.adaptation_gain * integral_of_s
    theta_1 = before.theta_hat[0] + change * g.theta[0] * phi[0]
    theta_2 = before.theta_hat[1] + change * g.theta[1] * phi[1]
    away = before.omega_hat + change * g.omega * u_omega - p.input_gain
    unrelaxed = (
        x_tilde[0] + drift[0] + b[0] * integral_of_eta,
        x_tilde[1] + drift[1] + b[1] * integral_of_eta,
    )
    after = Estimates(
        x_tilde=relaxed(matrices.predictor_matrix, 0.5 * h, unrelaxed),
        theta_hat=(keep_within(theta_1, p.theta_bound[0]), keep_within(theta_2, p.theta_bound[1])),
        sigma_hat=keep_within(before.sigma_hat + change * g.sigma, p.sigma_bound),
        omega_hat=p.input_gain + keep_within(away, p.input_gain_uncertainty),
    )
    mean_eta = where(h > _SHORTEST, integral_of_eta / maximum(h, _SHORTEST), eta)
    not_by_omega = 1.0 - g.omega * learnt / maximum(kappa, _SMALLEST)
    known = eta - before.omega_hat * u + not_by_omega * (mean_eta - eta)
    return after, _with_newest(known, before, after, phi, regressor(p.regressor, over.x_1), p)


def _with_newest(
    known: float,
    before: Estimates,
    after: Estimates,
    phi: Vector,
    newest: Vector,
    parameters: LawParameters,
) -> float:
    """Returns theta_hat' phi + sigma_hat with the newest phi, limited by the bounds of the estimates."""
    p, change = parameters, (newest[0] - phi[0], newest[1] - phi[1])
    known = known + 0.5 * (dot(before.theta_hat, change) + dot(after.theta_hat, change))
    largest = p.theta_bound[0] * absolute(newest[0]) + p.theta_bound[1] * absolute(newest[1]) + p.sigma_bound
    return keep_within(known, largest)


@dataclass(frozen=True)
class _Factors:
    theta: Vector
    sigma: float
    omega: float


def _projection_factors(
    estimates: Estimates, phi: Vector, s: float, u_omega: float, parameters: LawParameters
) -> _Factors:
    """Returns Proj(th, y) / y of each estimate, for rates with the signs of -s phi, -s and -s u_omega."""
    p, eps = parameters, parameters.projection_tolerance
    away = estimates.omega_hat - p.input_gain
    return _Factors(
        theta=(
            projection_factor(estimates.theta_hat[0], -s * phi[0], p.theta_bound[0], eps),
            projection_factor(estimates.theta_hat[1], -s * phi[1], p.theta_bound[1], eps),
        ),
        sigma=projection_factor(estimates.sigma_hat, -s, p.sigma_bound, eps),
        omega=projection_factor(away, -s * u_omega, p.input_gain_uncertainty, eps),
    )


def _sinc(square: float) -> float:
    """Returns sin(a) / a for the square of a."""
    angle = sqrt(maximum(square, _SMALL_SQUARE))
    return sin(angle) / angle
