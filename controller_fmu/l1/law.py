"""The L1 adaptive control law for a second-order plant of one input and output: `parameters.EQUATIONS`.

The prediction receives u_a + u_p + u_f; eta_hat contains omega_hat u_a alone. With either wrong the filter
cancels u_p and u_f, and the response is plain L1, or no response.

Source: Maalouf, Chemori and Creuze (2013); errata and additions in docs/fidelity.md. The step is
derived in docs/explanation/theory.md.
"""

from dataclasses import asdict, dataclass
from typing import Any

from controller_fmu.anti_windup import integrate_error
from controller_fmu.l1 import augmentation, lowpass
from controller_fmu.l1.adaptation import Estimates, Interval, adapt
from controller_fmu.l1.lowpass import FilterState
from controller_fmu.l1.matrices import LawMatrices, SampledLawMatrices, Vector, dot
from controller_fmu.l1.parameters import (
    LONGEST_STEP,
    AdaptationLaw,
    Augmentation,
    LawParameters,
    ReferenceFeedforward,
)
from controller_fmu.l1.piecewise import Sample, adapt_at_samples
from controller_fmu.l1.projection import keep_within
from fmus.block import variable
from fmus.numerics import where


@dataclass(frozen=True)
class Measurement:
    """Measurement at one time; y and r have one unit, f has the unit of the control."""

    x: Vector = variable((0.0, 0.0), "State x of the plant")
    y: float = variable(0.0, "Output y")
    r: float = variable(0.0, "Reference r of the output")
    f: float = variable(0.0, "Feedforward f of the reference")

    @property
    def error(self) -> float:
        """Tracking error e = y - r."""
        return self.y - self.r


@dataclass(frozen=True)
class Held:
    """Held control; its part u_a has a feedforward outside the filter."""

    # 1e-8: equal parts of a communication step pass internal_step by rounding
    duration: float = variable(0.0, "How long u was held", unit="s", min=0.0, max=LONGEST_STEP * (1.0 + 1e-8))
    u: float = variable(0.0, "Control u that the plant received")
    u_a: float = variable(0.0, "Part of u that precedes the extension")


@dataclass(frozen=True)
class LawState:
    """State of the law.

    Parameters
    ----------
    measured : Measurement
        The last measurement.
    estimates : Estimates
        At the time of `measured`, or of the last sample of the piecewise-constant law.
    held : Held
        Control that the plant received since `measured`.
    filter : FilterState
        At the end of the last step.
    sample : Sample
        `sample.x` is the state at the time of the estimates.
    """

    measured: Measurement = Measurement()
    estimates: Estimates = Estimates()
    held: Held = Held()
    filter: FilterState = FilterState()
    # with the gain inside, a change of K_I during a run makes no jump of the control
    integral: float = variable(0.0, "int K_I e dt at the end of the last step")
    sample: Sample = Sample()


@dataclass(frozen=True)
class Control:
    """The four parts of the control u, in its unit.

    Parameters
    ----------
    u_m : float
        State feedback.
    u_a : float
        Adaptive control, behind the filter.
    u_p : float
        Extension.
    u_f : float
        Feedforward outside the filter.
    """

    u_m: float
    u_a: float
    u_p: float
    u_f: float

    @property
    def total(self) -> float:
        """The control u."""
        return self.u_m + self.u_a + self.u_p + self.u_f


def initial_law(measured: Measurement, parameters: LawParameters) -> LawState:
    """Returns the state with the prediction at the measured state and theta_hat at zero.

    Parameters
    ----------
    measured : Measurement
        First measurement.
    parameters : LawParameters

    Returns
    -------
    LawState
    """
    p = parameters
    # the limit has a kink at a bound of 0, where its derivatives have no meaning
    sigma_hat = where(p.sigma_bound > 0.0, keep_within(p.initial_sigma_hat, p.sigma_bound), 0.0)
    estimates = Estimates(sigma_hat=sigma_hat, omega_hat=p.input_gain)
    return LawState(measured, estimates, filter=FilterState(p.initial_u_a), sample=Sample(measured.x))


def extension(parameters: LawParameters, e: float, integral: float, r: float) -> float:
    """Returns u_p of the chosen augmentation.

    Parameters
    ----------
    parameters : LawParameters
    e : float
        Tracking error.
    integral : float
        int K_I e dt.
    r : float
        Reference.

    Returns
    -------
    float
        u_p in the unit of the control.
    """
    p = parameters
    pi = augmentation.proportional_integral(e, integral, p.proportional_gain)
    delta = augmentation.threshold(p.threshold, p.nonlinear_threshold, p.threshold_floor, r)
    nonlinear = augmentation.nonlinear_proportional(
        e, delta, p.nonlinear_exponent, p.large_error_gain, p.small_error_gain
    )
    other = where(p.augmentation == Augmentation.NONLINEAR_P, nonlinear, 0.0)
    return where(p.augmentation == Augmentation.PI, pi, other)


def control(law: LawState, k_m: Vector, parameters: LawParameters) -> Control:
    """Returns the control u = u_m + u_a + u_p + u_f until the next step.

    Parameters
    ----------
    law : LawState
    k_m : tuple of two floats
        State feedback gain.
    parameters : LawParameters

    Returns
    -------
    Control
    """
    last, is_outside = law.measured, parameters.reference_feedforward == ReferenceFeedforward.OUTSIDE
    return Control(
        u_m=-dot(k_m, last.x),
        u_a=law.filter.u_a,
        u_p=extension(parameters, last.error, law.integral, last.r),
        u_f=where(is_outside, last.f, 0.0),
    )


def predicted_state(law: LawState) -> Vector:
    """Returns x_hat at the time of the prediction error.

    Parameters
    ----------
    law : LawState

    Returns
    -------
    tuple of two floats
    """
    x, x_tilde = law.sample.x, law.estimates.x_tilde
    return x[0] + x_tilde[0], x[1] + x_tilde[1]


def outputs(law: LawState, u: Control) -> dict[str, Any]:
    """Returns the outputs of every block with this law by name: parts of the control, estimates.

    Parameters
    ----------
    law : LawState
    u : Control

    Returns
    -------
    dict
        Name -> value.
    """
    estimates = asdict(law.estimates)
    # each block has own variables for it, with the names and units of its plant
    del estimates["x_tilde"]
    return asdict(u) | estimates


def law_step(
    h: float,
    law: LawState,
    now: Measurement,
    u: Control,
    delivered: float,
    saturation_error: float,
    k_m: Vector,
    parameters: LawParameters,
    matrices: SampledLawMatrices,
) -> LawState:
    """Returns the law h seconds later: estimates at the time of `now`, filter and integral at the step's end.

    Parameters
    ----------
    h : float
        Step [s].
    law : LawState
        The law at the step's beginning.
    now : Measurement
        Measurement at the step's beginning; with `inputs_at_step_end`, at its end.
    u : Control
        The control of `law`, demanded during this step.
    delivered : float
        The actuator's control, which drives the prediction.
    saturation_error : float
        Delivered minus demanded control, exactly 0 unless the actuator saturates. Integrators hold where
        they would demand still more.
    k_m : tuple of two floats
        State feedback gain.
    parameters : LawParameters
    matrices : SampledLawMatrices

    Returns
    -------
    LawState
    """
    # The control that the plant received between the last measurement and `now` drives the prediction. `now`
    # is from the step's beginning, so this control was held in the step before; with `inputs_at_step_end` it
    # is `u`.
    p, at_end = parameters, parameters.inputs_at_step_end
    given = Held(h, delivered, u.u_a + u.u_f)
    duration = where(at_end, given.duration, law.held.duration)
    before = law.measured
    # A_m contains the u_m of the state during the interval, not of the measurement before it
    midway_u_m = -0.5 * (dot(k_m, before.x) + dot(k_m, now.x))
    u_ap = where(at_end, given.u, law.held.u) - midway_u_m
    interval = Interval(duration, before.x, now.x, u_ap, where(at_end, given.u_a, law.held.u_a))
    estimates, known, sample = where(
        p.adaptation_law == AdaptationLaw.PIECEWISE_CONSTANT,
        lambda: adapt_at_samples(law.estimates, law.sample, interval, p, matrices),
        lambda: (*adapt(law.estimates, interval, p, matrices), Sample(now.x)),
    )

    # implicit, as the input contains the output omega_hat u_a: an explicit step of a fast filter diverges
    omega = estimates.omega_hat
    drive = known - _filter_reference(now, omega, p, matrices)
    free, gain = lowpass.midpoint_response(p.filter_order, p.filter_bandwidth, law.filter, 0.5 * h)
    v = omega * (free - gain * drive) / (1.0 + gain * omega) + drive
    return LawState(
        measured=now,
        estimates=estimates,
        held=given,
        filter=lowpass.advance(p.filter_order, p.filter_bandwidth, law.filter, 0.5 * h, v, saturation_error),
        integral=integrate_error(h, law.integral, p.integral_gain * now.error, saturation_error),
        sample=sample,
    )


def _filter_reference(
    now: Measurement, omega: float, parameters: LawParameters, matrices: LawMatrices
) -> float:
    """Returns v, the value to which the filter drives eta_hat."""
    # with f outside, the part of f that the input gain takes away
    kind = parameters.reference_feedforward
    without = where(
        kind == ReferenceFeedforward.OUTSIDE, (1.0 - omega) * now.f, matrices.feedforward_gain * now.r
    )
    return where(kind == ReferenceFeedforward.INSIDE, now.f, without)
