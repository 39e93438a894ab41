"""Block L1DepthController: measured depth and reference in, two thruster voltages out.

The plant as the controller knows it is (13): state (z, z'), A = [[0, 1], [0, -D/M]],
B_m = [0, 1/M], A_m = A - B_m k_m. z points down. Source: Maalouf et al. (2013), section 4.
"""

from dataclasses import dataclass

from controller_fmu import allocation
from controller_fmu.l1 import law as l1
from controller_fmu.l1.depth_controller_guide import GUIDE
from controller_fmu.l1.law import Control, LawParameters, LawState, Measurement
from controller_fmu.l1.matrices import LawMatrices, Matrix, Vector, law_matrices, law_requirements
from controller_fmu.observer import ObserverState, VelocitySource, sample_when_due
from fmus.block import Block, variable
from fmus.numerics import Clock, where


@dataclass(frozen=True)
class Parameters(LawParameters):
    """Gains are tunable at communication points, structural choices fixed."""

    internal_step: float = variable(
        0.02, "Longest internal step; one for each communication step is best", unit="s", min=1e-6, max=10.0,
        variability="fixed",
    )  # fmt: skip
    velocity_source: VelocitySource = variable(
        VelocitySource.ALPHA_BETA_OBSERVER, "Where the depth rate comes from", variability="fixed"
    )
    model_inertia: float = variable(
        5.5, "Inertia with added mass M_z that the design assumes", unit="kg", min=0.1, max=1e6,
        source="estimate: 3 kg and the added mass of a box",
    )  # fmt: skip
    model_damping: float = variable(
        2.5, "Linear damping D_z that the design assumes", unit="N.s/m", min=0.0, max=1e6,
        source="guess: the paper gives none",
    )  # fmt: skip
    depth_feedback_gain: float = variable(
        1.895, "k_m of the depth", unit="N/m", min=1e-6, max=1e6, source="identified, docs/fidelity.md"
    )
    rate_feedback_gain: float = variable(
        20.23, "k_m of the depth rate", unit="N.s/m", min=0.0, max=1e6, source="identified, docs/fidelity.md"
    )
    adaptation_gain: float = variable(
        100.0, "Adaptation gain Gamma", min=0.0, max=1e9,
        source="guess: the paper calls it very high and gives 1e4 for the example; docs/fidelity.md",
    )  # fmt: skip
    filter_bandwidth: float = variable(
        0.3017, "Bandwidth w of the low-pass filter C(s)", unit="rad/s", min=1e-6, max=1e6,
        source="identified, docs/fidelity.md",
    )  # fmt: skip
    lyapunov_weight: Vector = variable(
        (1.0, 1.0), "Diagonal of Q in the Lyapunov equation", min=1e-9, max=1e9, source="guess"
    )
    theta_bound: Vector = variable(
        (5.0, 5.0), "Bound of |theta_hat|", unit="N", min=0.0, max=1e6,
        source="guess that satisfies the L1-norm condition; per SI unit of the regressor",
    )  # fmt: skip
    sigma_bound: float = variable(10.0, "Bound of |sigma_hat|", unit="N", min=0.0, max=1e6, source="guess")
    proportional_gain: float = variable(
        3.967, "K_P of the PI", unit="N/m", min=0.0, max=1e6, source="identified, docs/fidelity.md"
    )
    integral_gain: float = variable(
        0.00499, "K_I of the PI", unit="N/(m.s)", min=0.0, max=1e6, source="identified, docs/fidelity.md"
    )
    large_error_gain: float = variable(
        1.0, "a_1 of the nonlinear P, in N per m^alpha", min=0.0, max=1e6, source="guess"
    )
    small_error_gain: float = variable(
        1.0, "a_2 of the nonlinear P, in N per m^alpha", min=0.0, max=1e6, source="guess"
    )
    nonlinear_threshold: float = variable(
        0.1, "delta in m, or its ratio to |r|", min=0.0, max=1e6, source="guess"
    )
    threshold_floor: float = variable(
        0.01, "Least delta of the nonlinear P", unit="m", min=1e-9, max=1e6, source="guess"
    )
    observer_alpha: float = variable(
        0.4, "alpha of the observer", min=0.0, max=1.0, source="guess: not published"
    )
    observer_beta: float = variable(
        0.1, "beta of the observer", min=0.0, max=2.0,
        source="alpha^2 / (2 - alpha), Benedict and Bordner (1962); not published",
    )  # fmt: skip
    observer_period: float = variable(
        0.04, "Sampling period of the observer", unit="s", min=1e-4, max=10.0, variability="fixed",
        source="proxy: reading time of a Bar30 depth sensor",
    )  # fmt: skip
    thruster_gain: Vector = variable(
        (0.25, 0.25), "Force coefficient K of each thruster", unit="N/V", min=1e-6, max=1e6,
        source="guess: the paper gives none",
    )  # fmt: skip
    voltage_limit: float = variable(
        12.0, "Largest voltage of a thruster", unit="V", min=1e-6, max=1e6,
        source="guess: the paper gives none",
    )  # fmt: skip


@dataclass(frozen=True)
class Matrices(LawMatrices):
    """The calculated parameters with the vehicle's units."""

    predictor_matrix: Matrix = variable(
        ((0.0, 1.0), (-1.0, -1.0)), "A_m, desired dynamics", unit=(("1/s", "1"), ("1/s2", "1/s"))
    )
    predictor_input: Vector = variable((0.0, 1.0), "B_m, input column", unit=("s/kg", "1/kg"))
    feedforward_gain: float = variable(1.0, "k_g = -1 / (C A_m^-1 B_m)", unit="N/m")


@dataclass(frozen=True)
class Inputs:
    depth_reference: float = variable(0.0, "Reference r of the depth", unit="m")
    measured_depth: float = variable(0.0, "Measured depth z, positive down", unit="m")
    measured_depth_rate: float = variable(
        0.0, "Depth rate z', used when velocity_source is measured", unit="m/s"
    )
    roll: float = variable(0.0, "Roll angle phi", unit="rad")
    pitch: float = variable(0.0, "Pitch angle theta", unit="rad")


@dataclass(frozen=True)
class State:
    law: LawState = LawState()
    observer: ObserverState = ObserverState()
    j: float = 1.0


@dataclass(frozen=True)
class Outputs:
    voltage: Vector = variable((0.0, 0.0), "Voltage of each thruster, saturated", unit="V")
    demanded_force: float = variable(0.0, "u = u_m + u_a + u_p, earth frame, positive down", unit="N")
    u_m: float = variable(0.0, "State feedback -k_m x", unit="N")
    u_a: float = variable(0.0, "Adaptive control", unit="N")
    u_p: float = variable(0.0, "Extension: PI or nonlinear P", unit="N")
    theta_hat: Vector = variable((0.0, 0.0), "Estimate theta_hat, per SI unit of the regressor", unit="N")
    sigma_hat: float = variable(0.0, "Estimate sigma_hat", unit="N")
    omega_hat: float = variable(1.0, "Estimate omega_hat of the input gain")
    predicted_depth: float = variable(0.0, "Predicted state x_hat, depth", unit="m")
    predicted_depth_rate: float = variable(0.0, "Predicted state x_hat, depth rate", unit="m/s")
    depth_prediction_error: float = variable(0.0, "x_tilde = x_hat - x, depth", unit="m")
    depth_rate_prediction_error: float = variable(0.0, "x_tilde = x_hat - x, depth rate", unit="m/s")
    tracking_error: float = variable(0.0, "e = z - r", unit="m")
    estimated_depth_rate: float = variable(0.0, "Depth rate that the law uses", unit="m/s")


def calculate(p: Parameters) -> Matrices:
    """A_m, B_m, P and k_g of the assumed plant under the state feedback k_m."""
    inverse_inertia = 1.0 / p.model_inertia
    a_m = (
        (0.0, 1.0),
        (
            -p.depth_feedback_gain * inverse_inertia,
            -(p.model_damping + p.rate_feedback_gain) * inverse_inertia,
        ),
    )
    matrices = law_matrices(a_m, (0.0, inverse_inertia), (1.0, 0.0), p.lyapunov_weight)
    return Matrices(**vars(matrices))


def requirements(p: Parameters, matrices: LawMatrices) -> tuple:
    return (
        *law_requirements(p, matrices.predictor_matrix),
        (
            p.internal_step <= p.observer_period * (1.0 + 1e-9),
            "internal_step at most observer_period",
        ),
    )


def initial_state(t: float, inputs: Inputs, p: Parameters, matrices: LawMatrices) -> State:
    """At rest on the first measurement: no estimate, no adaptive control, prediction = state."""
    observer = ObserverState(inputs.measured_depth, 0.0, Clock(t + p.observer_period))
    j = allocation.body_to_earth(inputs.roll, inputs.pitch)
    return State(l1.initial_law(_measurement(inputs, observer, p), p.input_gain), observer, j)


def step(t: float, h: float, state: State, inputs: Inputs, p: Parameters, matrices: LawMatrices) -> State:
    observer = sample_when_due(
        t, state.observer, inputs.measured_depth,
        p.observer_alpha, p.observer_beta, p.observer_period,
    )  # fmt: skip
    u = _control(state.law, p)
    demanded = _demanded_voltages(u, state.j, p)
    saturated = allocation.saturate(demanded, p.voltage_limit)
    delivered = allocation.force(saturated, state.j, p.thruster_gain)
    shortfall = allocation.shortfall(demanded, saturated, state.j, p.thruster_gain)
    now = _measurement(inputs, observer, p)
    law = l1.law_step(h, state.law, now, u, delivered, shortfall, _state_feedback(p), p, matrices)
    return State(law, observer, allocation.body_to_earth(inputs.roll, inputs.pitch))


def output(t: float, state: State, p: Parameters, matrices: LawMatrices) -> Outputs:
    law, estimates, last = state.law, state.law.estimates, state.law.measured
    u = _control(law, p)
    predicted = l1.predicted_state(law)
    return Outputs(
        voltage=allocation.saturate(_demanded_voltages(u, state.j, p), p.voltage_limit),
        demanded_force=u.total,
        u_m=u.u_m,
        u_a=u.u_a,
        u_p=u.u_p,
        theta_hat=estimates.theta_hat,
        sigma_hat=estimates.sigma_hat,
        omega_hat=estimates.omega_hat,
        predicted_depth=predicted[0],
        predicted_depth_rate=predicted[1],
        depth_prediction_error=estimates.x_tilde[0],
        depth_rate_prediction_error=estimates.x_tilde[1],
        tracking_error=last.error,
        estimated_depth_rate=last.x[1],
    )


def _measurement(inputs: Inputs, observer: ObserverState, p: Parameters) -> Measurement:
    measured = p.velocity_source == VelocitySource.MEASURED
    rate = where(measured, inputs.measured_depth_rate, observer.rate)
    depth = inputs.measured_depth
    return Measurement(x=(depth, rate), y=depth, r=inputs.depth_reference)


def _state_feedback(p: Parameters) -> Vector:
    return p.depth_feedback_gain, p.rate_feedback_gain


def _control(law: LawState, p: Parameters) -> Control:
    return l1.control(law, _state_feedback(p), p)


def _demanded_voltages(u: Control, j: float, p: Parameters) -> Vector:
    return allocation.allocate(u.total, j, p.thruster_gain)


BLOCK = Block(
    name="L1DepthController",
    description="Extended L1 adaptive depth controller for an underwater vehicle",
    parameters=Parameters,
    calculated=Matrices,
    inputs=Inputs,
    state=State,
    outputs=Outputs,
    calculate=calculate,
    requirements=requirements,
    initial_state=initial_state,
    step=step,
    output=output,
    stop_time=310.0,
    step_size=0.02,
    guide=GUIDE,
    license="MIT",
)
