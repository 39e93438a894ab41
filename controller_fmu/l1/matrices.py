"""Systems of second order: their algebra in closed form, and the matrices and gains of a design.

    A_m^T P + P A_m = -Q,   k_g = -1 / (C A_m^-1 B_m)

A design is P, P B_m and k_g of A_m, B_m, C and Q, and the gains of two additions. A block computes them
from its parameters with arithmetic alone, on floats and on CasADi symbols; `design.py` with SciPy.
Source: Maalouf et al. (2013), section 2.
"""

from dataclasses import dataclass

from fmus.block import variable
from fmus.numerics import cos, cosh, exp, expm1, logical_and, matmul, maximum, sin, sinh, solve, sqrt, where

Vector = tuple[float, float]
Matrix = tuple[Vector, Vector]

# of -tr(A_s) Ts: the estimate would be e^-10 of a disturbance, hence nothing
FASTEST = 20.0
# rad2; of an angle a for which sin(a) / a is 1 to the last bit
_SMALL_SQUARE = 1e-16


def dot(first: Vector, second: Vector) -> float:
    """Returns the scalar product."""
    return first[0] * second[0] + first[1] * second[1]


def is_hurwitz(a: Matrix) -> bool:
    """Whether both eigenvalues have negative real parts: trace < 0 < determinant."""
    (a_11, a_12), (a_21, a_22) = a
    return maximum(a_11 + a_22, a_12 * a_21 - a_11 * a_22) < 0.0


def lyapunov_solution(a_m: Matrix, q: Vector) -> Matrix:
    """Returns P of A_m' P + P A_m = -diag(q), by Cramer's rule on (p_11, p_12, p_22)."""
    (a, b), (c, d) = a_m
    trace, determinant = a + d, a * d - b * c
    scale = -0.5 / (trace * determinant)
    p_11 = scale * (q[0] * (determinant + d * d) + q[1] * c * c)
    p_12 = -scale * (q[0] * b * d + q[1] * a * c)
    p_22 = scale * (q[0] * b * b + q[1] * (determinant + a * a))
    return (p_11, p_12), (p_12, p_22)


def sampled_system(a: Matrix, period: float) -> tuple[Matrix, Matrix, Matrix]:
    """Returns E = e^(A T), Phi = A^-1 (E - I) and Phi^-1 E of a Hurwitz matrix, whatever its eigenvalues.

    With D = A - m I, m half the trace, D^2 is d I, and with c = cosh(sqrt(d) T / 2) and
    s = sinh(sqrt(d) T / 2) / sqrt(d), or cos and sin where d < 0,

        e^(A T / 2) = e^(m T / 2) (c I + s D)
        E - I       = (c I + s D) N,   N = (e^(m T) - 1) c I + (e^(m T) + 1) s D

    period: T [s]
    """
    # This form subtracts no nearly equal numbers, however short the period is.
    (a_11, a_12), (a_21, a_22) = a
    mean, half_difference, half = 0.5 * (a_11 + a_22), 0.5 * (a_11 - a_22), 0.5 * period
    d = half_difference * half_difference + a_12 * a_21
    angle = sqrt(maximum(half * half * abs(d), _SMALL_SQUARE))
    c = where(d > 0.0, lambda: cosh(angle), lambda: cos(angle))
    s = half * where(d > 0.0, lambda: sinh(angle), lambda: sin(angle)) / angle

    def combined(of_identity: float, of_d: float) -> Matrix:
        diagonal = of_d * half_difference
        return (of_identity + diagonal, of_d * a_12), (of_d * a_21, of_identity - diagonal)

    growth, root = exp(mean * period), combined(c, s)
    difference = combined(expm1(mean * period) * c, (growth + 1.0) * s)
    transition = _scaled(growth, matmul(root, root))
    return (
        transition,
        solve(a, matmul(root, difference)),
        _scaled(growth, matmul(root, solve(difference, a))),
    )


def _scaled(factor: float, a: Matrix) -> Matrix:
    (a_11, a_12), (a_21, a_22) = a
    return (factor * a_11, factor * a_12), (factor * a_21, factor * a_22)


def relaxed(a_m: Matrix, h: float, vector: Vector) -> Vector:
    """Returns the vector h seconds later under x' = A_m x, by the implicit midpoint rule."""
    half = 0.5 * h
    (a_11, a_12), (a_21, a_22) = a_m
    m_11, m_12, m_21, m_22 = 1 - half * a_11, -half * a_12, -half * a_21, 1 - half * a_22
    m = m_11 * m_22 - m_12 * m_21
    middle = (m_22 * vector[0] - m_12 * vector[1]) / m, (m_11 * vector[1] - m_21 * vector[0]) / m
    return 2.0 * middle[0] - vector[0], 2.0 * middle[1] - vector[1]


@dataclass(frozen=True)
class LawMatrices:
    """Matrices and gains of the law, calculated from the parameters alone."""

    predictor_matrix: Matrix = variable(((0.0, 1.0), (-1.0, -1.4)), "A_m of the predictor")
    predictor_input: Vector = variable((0.0, 1.0), "B_m, input column")
    lyapunov_matrix: Matrix = variable(((1.0, 0.0), (0.0, 1.0)), "P, solution of A_m^T P + P A_m = -Q")
    adaptation_vector: Vector = variable((0.0, 1.0), "P B_m, weight of the prediction error")
    feedforward_gain: float = variable(1.0, "k_g = -1 / (C A_m^-1 B_m)")
    feedforward_rate_gain: float = variable(1.0, "-k_g tr(A_m) / det(A_m), gain of r' in f")
    feedforward_acceleration_gain: float = variable(1.0, "k_g / det(A_m), gain of r'' in f")


@dataclass(frozen=True)
class SampledPrediction:
    """Further matrices for the piecewise-constant law: of the sampled prediction."""

    unmatched_input: Vector = variable((1.0, 0.0), "B_u, unit vector at right angles to B_m")
    error_transition: Matrix = variable(((1.0, 0.0), (0.0, 1.0)), "e^(A_s Ts)")
    error_input: Matrix = variable(((1.0, 0.0), (0.0, 1.0)), "Phi = A_s^-1 (e^(A_s Ts) - I)")
    estimation_gain: Matrix = variable(
        ((0.0, 1.0), (1.0, 0.0)), "-[B_m, B_u]^-1 Phi^-1 e^(A_s Ts), prediction error to estimates"
    )


@dataclass(frozen=True)
class SampledLawMatrices(LawMatrices, SampledPrediction):
    """Matrices of both laws."""


def law_matrices(a_m: Matrix, b: Vector, c: Vector, q: Vector) -> LawMatrices:
    """Returns P, P B_m, k_g and the gains of f; A_m must be Hurwitz and C A_m^-1 B_m not zero."""
    (a_11, a_12), (a_21, a_22) = a_m
    determinant = a_11 * a_22 - a_12 * a_21
    p = lyapunov_solution(a_m, q)
    steady_state = (
        (a_22 * b[0] - a_12 * b[1]) / determinant,
        (a_11 * b[1] - a_21 * b[0]) / determinant,
    )
    k_g = -1.0 / dot(c, steady_state)
    return LawMatrices(
        predictor_matrix=a_m,
        predictor_input=b,
        lyapunov_matrix=p,
        adaptation_vector=(dot(p[0], b), dot(p[1], b)),
        feedforward_gain=k_g,
        feedforward_rate_gain=-k_g * (a_11 + a_22) / determinant,
        feedforward_acceleration_gain=k_g / determinant,
    )


def sampled_prediction(b: Vector, a_s: Matrix, period: float) -> SampledPrediction:
    """Returns the matrices of the prediction error x_tilde' = A_s x_tilde + ..., sampled at a period [s]."""
    # The requirements refuse an A_s that cannot be sampled, after the matrices are calculated: until then,
    # another one keeps them finite.
    a_s = where(can_be_sampled(a_s, period), a_s, ((-1.0 / period, 0.0), (0.0, -1.0 / period)))
    transition, error_input, inverse = sampled_system(a_s, period)
    square = dot(b, b)
    length = sqrt(square)
    unmatched = b[1] / length, -b[0] / length
    to_estimates = (-b[0] / square, -b[1] / square), (-unmatched[0], -unmatched[1])
    return SampledPrediction(
        unmatched_input=unmatched,
        error_transition=transition,
        error_input=error_input,
        estimation_gain=matmul(to_estimates, inverse),
    )


def can_be_sampled(a_s: Matrix, period: float) -> bool:
    """Whether A_s is Hurwitz, and slow enough for its sampling period [s] to estimate a disturbance."""
    return logical_and(is_hurwitz(a_s), (a_s[0][0] + a_s[1][1]) * period > -FASTEST)
