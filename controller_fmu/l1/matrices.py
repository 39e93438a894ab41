"""What follows from a design alone: P, P B_m and k_g of A_m, B_m, C and Q.

    A_m' P + P A_m = -Q,    k_g = -1 / (C A_m^-1 B_m)

In closed form for second order, so that a block computes them from its parameters with nothing but
arithmetic; `design.py` gives the same from SciPy. Source: Maalouf et al. (2013), section 2.
"""

from dataclasses import dataclass
from typing import Any

from fmus.block import variable
from fmus.numerics import maximum

Vector = tuple[float, float]
Matrix = tuple[Vector, Vector]


@dataclass(frozen=True)
class LawMatrices:
    """What follows from the parameters alone."""

    predictor_matrix: Matrix = variable(((0.0, 1.0), (-1.0, -1.4)), "A_m, desired dynamics")
    predictor_input: Vector = variable((0.0, 1.0), "B_m, input column")
    lyapunov_matrix: Matrix = variable(((1.0, 0.0), (0.0, 1.0)), "P, solution of A_m' P + P A_m = -Q")
    adaptation_vector: Vector = variable((0.0, 1.0), "P B_m, weight of the prediction error")
    feedforward_gain: float = variable(1.0, "k_g = -1 / (C A_m^-1 B_m)")


def dot(first: Vector, second: Vector) -> float:
    """Scalar product."""
    return first[0] * second[0] + first[1] * second[1]


def lyapunov_solution(a_m: Matrix, q: Vector) -> Matrix:
    """P of A_m' P + P A_m = -diag(q), by Cramer's rule on (p_11, p_12, p_22)."""
    (a, b), (c, d) = a_m
    trace, determinant = a + d, a * d - b * c
    scale = -0.5 / (trace * determinant)
    p_11 = scale * (q[0] * (determinant + d * d) + q[1] * c * c)
    p_12 = -scale * (q[0] * b * d + q[1] * a * c)
    p_22 = scale * (q[0] * b * b + q[1] * (determinant + a * a))
    return (p_11, p_12), (p_12, p_22)


def law_matrices(a_m: Matrix, b: Vector, c: Vector, q: Vector) -> LawMatrices:
    """P, P B_m and k_g of a design; A_m must be Hurwitz and C A_m^-1 B_m not zero."""
    (a_11, a_12), (a_21, a_22) = a_m
    determinant = a_11 * a_22 - a_12 * a_21
    p = lyapunov_solution(a_m, q)
    steady_state = (
        (a_22 * b[0] - a_12 * b[1]) / determinant,
        (a_11 * b[1] - a_21 * b[0]) / determinant,
    )
    return LawMatrices(
        predictor_matrix=a_m,
        predictor_input=b,
        lyapunov_matrix=p,
        adaptation_vector=(dot(p[0], b), dot(p[1], b)),
        feedforward_gain=-1.0 / dot(c, steady_state),
    )


def hurwitz_requirement(a_m: Matrix) -> tuple[Any, str]:
    """A_m is Hurwitz: trace < 0 < determinant."""
    (a, b), (c, d) = a_m
    trace, determinant = a + d, a * d - b * c
    return (maximum(trace, -determinant) < 0.0, "a Hurwitz A_m (trace < 0 and determinant > 0)")


def law_requirements(parameters: Any, a_m: Matrix) -> tuple[tuple[Any, str], ...]:
    """A_m is Hurwitz and omega_hat cannot reach zero."""
    return (
        hurwitz_requirement(a_m),
        (
            parameters.input_gain_uncertainty < parameters.input_gain,
            "input_gain_uncertainty below input_gain, so that omega_hat stays positive",
        ),
    )


def relaxed(a_m: Matrix, h: float, vector: Vector) -> Vector:
    """The vector h seconds later under x' = A_m x, by the implicit midpoint rule."""
    half = 0.5 * h
    (a_11, a_12), (a_21, a_22) = a_m
    m_11, m_12, m_21, m_22 = 1 - half * a_11, -half * a_12, -half * a_21, 1 - half * a_22
    m = m_11 * m_22 - m_12 * m_21
    middle = (m_22 * vector[0] - m_12 * vector[1]) / m, (m_11 * vector[1] - m_21 * vector[0]) / m
    return 2.0 * middle[0] - vector[0], 2.0 * middle[1] - vector[1]
