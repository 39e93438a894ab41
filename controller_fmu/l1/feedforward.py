"""The reference feedforward: the control that makes the reference itself a solution of the desired dynamics.

    x' = A_m x + B_m f,   y = C x,   C B_m = 0
    y'' = C A_m^2 x + C A_m B_m f = tr(A_m) y' - det(A_m) y + C A_m B_m f        (Cayley and Hamilton)
    f   = k_g (r - (tr(A_m) r' - r'') / det(A_m)),   as k_g = det(A_m) / (C A_m B_m)

so if y = r and y' = r' hold once, y = r holds from then on. For the vehicle
f = M r'' + (D + k_m2) r' + k_m1 r.
"""

from controller_fmu.l1.matrices import LawMatrices, Vector, dot
from controller_fmu.l1.parameters import ReferenceFeedforward
from fmus.numerics import absolute, logical_or, sqrt

_ROUNDING = 1e-12  # of |C| |B_m|


def reference_feedforward(r: float, rate: float, acceleration: float, matrices: LawMatrices) -> float:
    """Returns f for the reference r, its rate and its acceleration."""
    m = matrices
    of_rates = m.feedforward_rate_gain * rate + m.feedforward_acceleration_gain * acceleration
    return m.feedforward_gain * r + of_rates


def feedforward_requirement(kind: ReferenceFeedforward, b: Vector, c: Vector) -> tuple[bool, str]:
    """Returns the requirement C B_m = 0 of a feedforward."""
    # with another C B_m, f would depend on the past of r as well
    is_relative_degree_two = absolute(dot(c, b)) <= _ROUNDING * sqrt(dot(c, c) * dot(b, b))
    return (
        logical_or(kind == ReferenceFeedforward.NONE, is_relative_degree_two),
        "C B_m = 0 (output_vector, input_vector) with a reference_feedforward",
    )
