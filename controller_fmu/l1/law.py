"""The L1 adaptive control law for a second-order plant with one input and one output: EQUATIONS.

The wiring that decides everything: the prediction receives u_a + u_p, eta_hat holds omega_hat u_a
alone. With either wrong the filter cancels u_p and the response is plain L1 again.

Source: Maalouf, Chemori and Creuze (2013); errata and additions in docs/fidelity.md. The step is
derived in docs/explanation/theory.md.
"""

from dataclasses import dataclass
from typing import Any

from controller_fmu.anti_windup import integrate_error
from controller_fmu.l1 import augmentation, lowpass
from controller_fmu.l1.adaptation import Estimates, InputGainRegressor, Interval, Regressor, adapt
from controller_fmu.l1.augmentation import Augmentation, Threshold
from controller_fmu.l1.lowpass import FilterOrder, FilterState
from controller_fmu.l1.matrices import LawMatrices, Vector, dot
from fmus.block import variable
from fmus.numerics import where

EQUATIONS = """\
u            = u_m + u_a + u_p,   u_m = -k_m x
x_hat'       = A_m x_hat + B_m (omega_hat (u_a + u_p) + theta_hat^T phi + sigma_hat)      (5)
theta_hat_i' = Gamma Proj(theta_hat_i, -(x_tilde^T P B_m) phi_i),   x_tilde = x_hat - x   (4)
sigma_hat'   = Gamma Proj(sigma_hat, -(x_tilde^T P B_m))
omega_hat'   = Gamma Proj(omega_hat, -(x_tilde^T P B_m) u_omega)
u_a(s)       = -k D(s) (omega_hat u_a + theta_hat^T phi + sigma_hat - k_g r)              (6)
A_m^T P + P A_m = -Q,   k_g = -1 / (C A_m^-1 B_m)

phi          = (|x|_inf, 0)   regressor infinity_norm
               x              regressor state
u_omega      = u_a            input_gain_regressor adaptive_control
               u_a + u_p      input_gain_regressor adaptive_control_and_extension
C(s)         = w / (s + w)                         filter_order first
               (3 w^2 s + w^3) / (s + w)^3         filter_order third

u_p          = 0                                   augmentation none
               -K_P e - K_I int e dt,   e = y - r  augmentation pi            (7)
               -a_1 |e|^alpha sgn(e)               augmentation nonlinear_p   (8), |e| > delta
               -a_2 e / delta^(1 - alpha)                                     (8), elsewhere
"""


@dataclass(frozen=True)
class LawParameters:
    """What every block with this law has in common; units that depend on the plant are added there."""

    internal_step: float = variable(
        10.0, "Longest internal step; one for each communication step is best", unit="s", min=1e-7, max=10.0,
        variability="fixed",
    )  # fmt: skip
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
    input_gain_regressor: InputGainRegressor = variable(
        InputGainRegressor.ADAPTIVE_CONTROL, "Control that omega_hat learns from", variability="fixed",
        source="published: u_a, which precedes the extension",
    )  # fmt: skip
    inputs_at_step_end: bool = variable(
        False, "Inputs are those of the end of a step (Gauss-Seidel), not of its beginning (Jacobi)",
        variability="fixed",
    )  # fmt: skip


@dataclass(frozen=True)
class Measurement:
    """What the law is given at one time: state x, output y and reference r."""

    x: Vector = (0.0, 0.0)
    y: float = 0.0
    r: float = 0.0

    @property
    def error(self) -> float:
        """Tracking error e = y - r."""
        return self.y - self.r


@dataclass(frozen=True)
class Held:
    """The control u that the plant received, its adaptive part u_a, and for how long [s]."""

    duration: float = 0.0
    u: float = 0.0
    u_a: float = 0.0


@dataclass(frozen=True)
class LawState:
    """What evolves.

    `estimates` are those of the time of `measured`, the last measurement, and `held` is the control that
    the plant received from then on. Filter and integral belong to the end of the last step.
    """

    measured: Measurement = Measurement()
    estimates: Estimates = Estimates()
    held: Held = Held()
    filter: FilterState = FilterState()
    error_integral: float = 0.0


@dataclass(frozen=True)
class Control:
    """The three parts of the control u."""

    u_m: float
    u_a: float
    u_p: float

    @property
    def total(self) -> float:
        return self.u_m + self.u_a + self.u_p


def initial_law(measured: Measurement, omega: float) -> LawState:
    """The prediction begins at the measured state, theta_hat and sigma_hat at zero."""
    return LawState(measured=measured, estimates=Estimates(omega_hat=omega))


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


def control(law: LawState, k_m: Vector, parameters: Any) -> Control:
    """u = u_m + u_a + u_p, until the next step."""
    last = law.measured
    return Control(
        u_m=-dot(k_m, last.x),
        u_a=law.filter.u_a,
        u_p=extension(parameters, last.error, law.error_integral, last.r),
    )


def predicted_state(law: LawState) -> Vector:
    """x_hat at the time of the last measurement."""
    x, x_tilde = law.measured.x, law.estimates.x_tilde
    return x[0] + x_tilde[0], x[1] + x_tilde[1]


def law_step(
    h: float,
    law: LawState,
    now: Measurement,
    u: Control,
    delivered: float,
    shortfall: float,
    k_m: Vector,
    parameters: Any,
    matrices: LawMatrices,
) -> LawState:
    """The law h seconds later: estimates of the time of `now`, filter and integral of the step's end.

    u: the control of `law`, demanded during this step
    delivered: what the actuator makes of it, by which the prediction is driven
    shortfall: delivered minus demanded, exactly 0 unless the actuator saturates; integrators stop where
        they would demand still more

    The prediction is driven by the control that the plant received between the last measurement and this
    one. `now` is of the step's beginning, so that is the control of the step before; with
    `inputs_at_step_end`, `now` is of the step's end and that control is `u`.
    """
    p, at_end = parameters, parameters.inputs_at_step_end
    given = Held(h, delivered, u.u_a)
    duration = where(at_end, given.duration, law.held.duration)
    before = law.measured
    # u_m that belongs to A_m: of the state during the interval, not of the measurement before it
    midway_u_m = -0.5 * (dot(k_m, before.x) + dot(k_m, now.x))
    u_ap = where(at_end, given.u, law.held.u) - midway_u_m
    interval = Interval(duration, before.x, now.x, u_ap, where(at_end, given.u_a, law.held.u_a))
    estimates, known = adapt(law.estimates, interval, p, matrices)

    # the filter's own midpoint: v = omega_hat u_a + known - k_g r
    drive, omega = known - matrices.feedforward_gain * now.r, estimates.omega_hat
    free, gain = lowpass.midpoint_response(p.filter_order, p.filter_bandwidth, law.filter, 0.5 * h)
    v = omega * (free - gain * drive) / (1.0 + gain * omega) + drive
    return LawState(
        measured=now,
        estimates=estimates,
        held=given,
        filter=lowpass.advance(p.filter_order, p.filter_bandwidth, law.filter, 0.5 * h, v, shortfall),
        error_integral=integrate_error(h, law.error_integral, now.error, shortfall),
    )
