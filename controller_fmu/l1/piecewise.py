"""Piecewise-constant adaptation law, which computes its estimates anew at every sample.

    x_hat'             = A_m x + A_s x_tilde + B_m (omega u + sigma_hat) + B_u sigma_u,   x_tilde = x_hat - x
    (sigma_hat, sigma_u) = -[B_m, B_u]^-1 Phi^-1 e^(A_s Ts) x_tilde   at every sample, constant between two
    Phi                = A_s^-1 (e^(A_s Ts) - I)

sigma_hat is the matched disturbance, which the filter of the law compensates, and sigma_u the unmatched one,
which only the prediction uses. With x' = A_m x + B_m omega u + d and d constant over an interval,
x_tilde goes from one sample to the next as

    x_tilde <- e^(A_s Ts) x_tilde + Phi (B_m sigma_hat + B_u sigma_u - d) = -Phi d

so the estimates are e^(A_s Ts) d, one interval late. A_s and Ts are parameters, so that these matrices are
calculated once. Source: Hovakimyan and Cao (2010), chapter 3; docs/explanation/theory.md.
"""

from dataclasses import dataclass

from controller_fmu.l1.adaptation import Estimates, Interval
from controller_fmu.l1.matrices import SampledLawMatrices, Vector, dot
from controller_fmu.l1.parameters import LONGEST_STEP, LawParameters
from fmus.block import variable
from fmus.numerics import matmul, maximum, where

# of a period: sums of communication steps are rounded
_EARLY = 1e-6
# s; keeps a mean over no time finite
_SHORTEST = 1e-300


@dataclass(frozen=True)
class Sample:
    """Sample, and integrals since then."""

    x: Vector = variable((0.0, 0.0), "State x at the sample")
    duration: float = variable(0.0, "Time since the sample", unit="s", min=0.0, max=LONGEST_STEP)
    x_integral: Vector = variable((0.0, 0.0), "Integral of x since the sample")
    u_integral: float = variable(0.0, "Integral of u since the sample")


def adapt_at_samples(
    before: Estimates,
    sample: Sample,
    over: Interval,
    parameters: LawParameters,
    matrices: SampledLawMatrices,
) -> tuple[Estimates, float, Sample]:
    """Returns the estimates, the matched one of them, and the sample for the next interval.

    A sample is due at the first measurement Ts or more after the last. The estimates follow from the mean
    disturbance since the last sample, also after more than Ts.
    """
    h, x_0, x_1 = over.duration, over.x_0, over.x_1
    since = Sample(
        x=sample.x,
        duration=sample.duration + h,
        x_integral=(
            sample.x_integral[0] + 0.5 * h * (x_0[0] + x_1[0]),
            sample.x_integral[1] + 0.5 * h * (x_0[1] + x_1[1]),
        ),
        u_integral=sample.u_integral + h * over.u_ap,
    )
    is_due = since.duration >= parameters.adaptation_period * (1.0 - _EARLY)
    new = _estimates(before, since, x_1, parameters.input_gain, matrices)
    estimates, after = where(is_due, (new, Sample(x=x_1)), (before, since))
    return estimates, estimates.sigma_hat, after


def _estimates(
    before: Estimates, since: Sample, x: Vector, omega: float, matrices: SampledLawMatrices
) -> Estimates:
    """Returns the estimates at a sample with the state x."""
    m, duration = matrices, maximum(since.duration, _SHORTEST)
    b, b_u = m.predictor_input, m.unmatched_input

    def excess(i: int) -> float:
        """Returns the excess of the estimates over the mean disturbance, component i."""
        explained = dot(m.predictor_matrix[i], since.x_integral) + b[i] * omega * since.u_integral
        disturbance = (x[i] - since.x[i] - explained) / duration
        return b[i] * before.sigma_hat + b_u[i] * before.sigma_u - disturbance

    free = matmul(m.error_transition, before.x_tilde)
    driven = matmul(m.error_input, (excess(0), excess(1)))
    x_tilde = free[0] + driven[0], free[1] + driven[1]
    sigma_hat, sigma_u = matmul(m.estimation_gain, x_tilde)
    return Estimates(x_tilde=x_tilde, sigma_hat=sigma_hat, omega_hat=omega, sigma_u=sigma_u)
