"""The rules of a design against closed forms, and against second ways to compute what they state."""

import cmath
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov
from scipy.optimize import brentq

from controller_fmu.design import FilterOrder, l1_condition
from orchestration.errors import OrchestrationError
from orchestration.studies.design import rules
from orchestration.studies.design.parameter_file import DesignCheck
from orchestration.studies.design.rules import Conditions, L1Design, PidDesign, beta_of
from orchestration.studies.design.vehicle_data import VehicleData, data_of, draws_of
from orchestration.studies.margins.l1_loop import Plant, loop
from orchestration.studies.vehicle import Vehicle

TOO_NOISY = r"the sensor's noise gives a demand of .* N, 0.3 N are"
ONE_CORNER = {"inertia": (6.0, 6.0), "damping": (4.0, 4.0), "gain": (1.0, 1.0)}


def ideal_plant(inertia: float, damping: float) -> Plant:
    return Plant(((0.0, 1.0), (0.0, -damping / inertia)), (0.0, 1.0 / inertia))


def observed_rate(w: float, alpha: float, period: float) -> complex:
    """Of a depth that oscillates with 1 m at w [rad/s], by the sampled observer."""
    q, beta = cmath.exp(1j * w * period), beta_of(alpha)
    return beta / period * q * (q - 1.0) / (q**2 + (alpha + beta - 2.0) * q + 1.0 - alpha)


@pytest.mark.parametrize("extended", [False, True])
def test_the_poles_of_the_designed_loop_are_those_of_the_rules(l1: L1Design, extended: bool) -> None:
    """On the assumed vehicle, with fast adaptation and the true state: A_m or the poles of the PI, and -w."""
    law = replace(l1.law(0.04, math.inf, extended), observer=None)
    poles = np.sort_complex(loop(law, ideal_plant(l1.inertia, l1.damping)).poles())
    w_m = l1.bandwidth
    stated = [2.0 * w_m / 3.0] * 3 if extended else [w_m] * 2
    # the limit adds the mode p_12 / p_22 = w_m / 5 of the prediction error, which the loop does not show
    expected = np.sort_complex(np.array([-l1.filter, -0.2 * w_m, *(-w for w in stated)], dtype=complex))
    # a root of multiplicity 3 moves by the cube root of rounding, 6e-6
    np.testing.assert_allclose(poles, expected, atol=1e-4)


def test_the_poles_of_the_designed_pid_are_three_at_its_bandwidth(pid: PidDesign) -> None:
    k_p, k_i, k_d = pid.gains
    roots = np.roots([pid.inertia, pid.damping + k_d, k_p, k_i])
    np.testing.assert_allclose(roots, -pid.bandwidth, rtol=1e-4)  # as above


def second_phase_margin(pid: PidDesign, data: VehicleData, corner: tuple[float, float, float]) -> float:
    """The phase margin [deg] by the exact response of the sampled observer, with the known delays."""
    inertia, damping, gain = corner
    k_p, k_i, k_d = pid.gains
    delay = data.delay + 0.5 * data.period + 1.5 * 0.02

    def response(w: float) -> complex:
        s = 1j * w
        rate = observed_rate(w, pid.alpha, data.period)
        plant = gain / (1.0 + data.lag * s) / (s * (inertia * s + damping))
        return (k_p + k_i / s + k_d * rate) * plant * cmath.exp(-s * delay)

    crossover = brentq(lambda w: abs(response(w)) - 1.0, 0.5 * pid.bandwidth, 20.0)
    return math.degrees(cmath.phase(-response(float(crossover))))  # type: ignore[arg-type]


def test_the_margin_of_the_designed_pid_is_the_one_that_is_stated(pid: PidDesign, data: VehicleData) -> None:
    corners = itertools.product(data.inertia, data.damping, data.gain)
    smallest = min(second_phase_margin(pid, data, corner) for corner in corners)
    # the rule takes the bilinear equivalent of the observer, (w T)^2 / 12 of a phase of about 30 degrees
    assert pid.phase == pytest.approx(smallest, abs=0.5)
    assert pid.phase >= rules.PHASE_MARGIN


@pytest.fixture
def _longer_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """A design is searched for in the same range, in steps that are longer."""
    monkeypatch.setattr(rules, "_RATIO", 2.25)
    monkeypatch.setattr(rules, "_STEPS", 7)


@pytest.mark.usefixtures("_longer_steps")
def test_a_higher_bandwidth_does_not_leave_the_margin(
    pid: PidDesign, l1: L1Design, data: VehicleData, conditions: Conditions
) -> None:
    for design, name in ((rules.design_pid, pid.bandwidth), (rules.design_l1, l1.bandwidth)):
        with pytest.raises(OrchestrationError, match="20 deg are asked for"):
            design(data, conditions, 1.15 * name)


def test_the_norm_condition_holds_over_the_ranges_and_not_with_a_slower_filter(
    l1: L1Design, data: VehicleData
) -> None:
    ends = data.gain[0] * l1.inertia / data.inertia[1], data.gain[1] * l1.inertia / data.inertia[0]
    assert sum(ends) == pytest.approx(2.0)  # the box of omega is about 1
    common = np.array(l1.a_m), np.array([0.0, 1.0 / l1.inertia]), FilterOrder.FIRST
    omegas = np.linspace(*ends, 9).tolist()
    assert l1_condition(*common, l1.filter, l1.lipschitz, omegas=omegas) < 1.0
    assert l1_condition(*common, 0.9 * l1.filter, l1.lipschitz, omegas=omegas) > rules.NORM


def test_the_lipschitz_constant_bounds_the_uncertainty_of_every_vehicle(
    l1: L1Design, data: VehicleData
) -> None:
    """The uncertainty is what M x'' has besides the desired dynamics and omega u_a, from both equations."""
    random, largest = np.random.default_rng(1), 0.0
    k_1, k_2 = l1.state_feedback
    for _ in range(2000):
        m_z, d_z, d_q, gain = (
            random.uniform(*ends) for ends in (data.inertia, data.damping, data.drag, data.gain)
        )
        z, v = random.uniform(-0.8, 0.8), random.uniform(-0.04, 0.04)
        acceleration = (gain * (-k_1 * z - k_2 * v) - d_z * v - d_q * abs(v) * v) / m_z
        desired = (-k_1 * z - (k_2 + l1.damping) * v) / l1.inertia
        size = abs(l1.inertia * (acceleration - desired)) / max(abs(z), abs(v))
        largest = max(largest, size)
    assert 0.1 * l1.lipschitz < largest <= l1.lipschitz


@pytest.mark.parametrize("crossover", [1.0, 4.0, 8.0])
def test_the_observer_takes_the_stated_phase_at_the_crossover(crossover: float) -> None:
    period = 0.04
    rate = observed_rate(crossover, rules.observer_alpha(crossover, period), period)
    lost = 90.0 - math.degrees(cmath.phase(rate))
    # the newest sample is half a period newer than the mean of a difference, which the lag leaves out
    assert lost <= rules.OBSERVER_PHASE
    assert lost >= rules.OBSERVER_PHASE - math.degrees(crossover * period)


@pytest.mark.parametrize("alpha", [0.2, 0.6, 0.95])
def test_the_noise_of_the_rate_is_the_stationary_covariance(alpha: float) -> None:
    period, beta = 0.04, beta_of(alpha)
    transition = np.array([[1.0 - alpha, (1.0 - alpha) * period], [-beta / period, 1.0 - beta]])
    entering = np.array([[alpha], [beta / period]])
    covariance = solve_discrete_lyapunov(transition, 0.002**2 * entering @ entering.T)
    assert rules.rate_noise(alpha, period, 0.002) == pytest.approx(math.sqrt(covariance[1, 1]))


def test_the_fast_loop_makes_a_quarter_of_a_turn_in_a_sample(l1: L1Design, data: VehicleData) -> None:
    """Its frequency is that of the predictor's poles, with the state held: A_m, b and -kappa P b."""
    law = l1.law(data.period, math.inf, False)
    p_b = rules.lyapunov_matrix(np.array(law.a_m), np.diag(law.q)) @ np.array(law.b)
    kappa = l1.adaptation_gain * (1.0 + 0.8**2)
    matrix = np.block(
        [[np.array(law.a_m), np.array(law.b)[:, None]], [-kappa * p_b[None, :], np.zeros((1, 1))]]
    )
    poles = np.linalg.eigvals(matrix)
    fastest = poles[np.argmax(poles.imag)]
    assert abs(fastest) * data.period == pytest.approx(0.5 * math.pi, rel=0.01)
    # (a / 2)^2 of Omega^2 is left out; the damping a is 90 % of 2 w_m
    assert -2.0 * fastest.real == pytest.approx(1.8 * l1.bandwidth, rel=0.01)


@pytest.mark.parametrize(
    ("changed", "bandwidth", "message"),
    [
        ({"gain": (0.3, 1.7)}, 0.0, "the loop leaves -.* deg in a corner, 20 deg are asked"),
        ({"delay": 0.6}, 0.0, r"\|G\|_L1 L of the L1-norm condition is .* less delay \(700 ms\)$"),
        ({"noise": 0.05, **ONE_CORNER}, 0.6, TOO_NOISY),
        pytest.param({"noise": 0.05}, 0.6, TOO_NOISY, marks=pytest.mark.slow),
    ],
)
@pytest.mark.usefixtures("_longer_steps")
def test_ranges_for_which_there_is_no_design_are_refused(
    data: VehicleData,
    conditions: Conditions,
    changed: dict[str, object],
    bandwidth: float,
    message: str,
) -> None:
    with pytest.raises(OrchestrationError, match=f"^no L1 for RovDepthPlant: {message}"):
        rules.design_l1(replace(data, **changed), conditions, bandwidth)


@pytest.mark.parametrize("settling", [[40.0, math.nan, 50.0], [math.nan, 40.0, 50.0]])
def test_a_run_that_does_not_settle_is_the_longest_and_the_worst(settling: list[float]) -> None:
    checked = DesignCheck("PID", [{}] * 3, [1.0, 2.0, 3.0], settling, {})
    assert math.isnan(checked.longest_settling)
    assert math.isnan(settling[checked.worst])
    settled = replace(checked, settling=[40.0, 60.0, 50.0])
    assert (settled.longest_settling, settled.worst) == (60.0, 2)


@pytest.fixture
def unequal() -> VehicleData:
    """A pitching vehicle with unequal thrusters."""
    vehicle = Vehicle.of("RovHeavePitchPlant")
    return data_of(vehicle, draws_of(vehicle))


@pytest.mark.slow
def test_a_pitching_vehicle_with_unequal_thrusters_has_no_design(
    unequal: VehicleData, conditions: Conditions
) -> None:
    """The page on design gives these numbers."""
    with pytest.raises(OrchestrationError) as refused:
        rules.design_l1(unequal, conditions, 0.524)
    assert "the loop leaves 17.9 deg in a corner, 20 deg are asked for, and the" in str(refused.value)
    assert "noise gives a demand of 0.368 N, 0.3 N are allowed, at 0.524 rad/s: " in str(refused.value)
    assert str(refused.value).endswith(", or a smaller --phase-margin and a sensor with less noise (2.08 mm)")


@pytest.mark.slow
def test_what_a_refusal_asks_for_gives_a_design(unequal: VehicleData, conditions: Conditions) -> None:
    """Followed; and with one thruster that is at most 5 % weaker."""
    quiet = replace(unequal, noise=0.0)
    best = rules.design_l1(quiet, replace(conditions, phase_margin=15.0), 0.524).phase
    assert best == pytest.approx(17.89, abs=5e-3)  # of all corners
    lower = replace(conditions, phase_margin=17.5)
    assert rules.design_l1(replace(unequal, noise=0.0015), lower, 0.524).phase == best
    assert rules.design_l1(replace(unequal, gain=(0.78, 1.2)), conditions, 0.635).phase > 20.0
