"""Model of the vehicle that a design assumes, under the state feedback u_m = -k_m x, with x = (z, z').

    A = [[0, 1], [0, -D / M]],   B_m = [0, 1 / M],   A_m = A - B_m k_m,   C = [1, 0]                    (13)

M is the inertia with added mass, D the linear damping, z the depth, positive down.
Source: Maalouf et al. (2013), section 4.
"""

from dataclasses import asdict, dataclass

from controller_fmu.depth_interface import DesignParameters
from controller_fmu.l1.matrices import LawMatrices, Matrix, Vector, law_matrices
from fmus.block import variable


@dataclass(frozen=True)
class DepthMatrices(LawMatrices):
    """The calculated parameters with the vehicle's units."""

    predictor_matrix: Matrix = variable(
        ((0.0, 1.0), (-1.0, -1.0)), "A_m, desired dynamics", unit=(("1/s", "1"), ("1/s2", "1/s"))
    )
    predictor_input: Vector = variable((0.0, 1.0), "B_m, input column", unit=("s/kg", "1/kg"))
    feedforward_gain: float = variable(1.0, "k_g = -1 / (C A_m^-1 B_m)", unit="N/m")
    feedforward_rate_gain: float = variable(1.0, "Gain of r' in f, D_z + k_m2", unit="N.s/m")
    feedforward_acceleration_gain: float = variable(1.0, "Gain of r'' in f, M_z", unit="kg")


def depth_matrices(k_m: Vector, q: Vector, p: DesignParameters) -> DepthMatrices:
    """Returns A_m, B_m, P, k_g and the gains of f of the assumed vehicle under k_m [N/m, N.s/m]; q: of Q."""
    inverse_inertia = 1.0 / p.model_inertia
    a_m = (
        (0.0, 1.0),
        (-k_m[0] * inverse_inertia, -(p.model_damping + k_m[1]) * inverse_inertia),
    )
    matrices = law_matrices(a_m, (0.0, inverse_inertia), (1.0, 0.0), q)
    return DepthMatrices(**asdict(matrices))
