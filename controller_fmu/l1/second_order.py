"""Algebra of systems of second order in closed form: arithmetic that runs on floats and on CasADi symbols."""

from fmus.numerics import absolute, cos, cosh, exp, expm1, matmul, maximum, sin, sinh, solve, sqrt, where

Vector = tuple[float, float]
Matrix = tuple[Vector, Vector]

_SMALL_SQUARE = 1e-16  # rad2; of an angle a for which sin(a) / a is 1 to the last bit


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

    which subtracts nothing that is nearly equal, however short the period T [s].
    """
    (a_11, a_12), (a_21, a_22) = a
    mean, half_difference, half = 0.5 * (a_11 + a_22), 0.5 * (a_11 - a_22), 0.5 * period
    d = half_difference * half_difference + a_12 * a_21
    angle = sqrt(maximum(half * half * absolute(d), _SMALL_SQUARE))
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
