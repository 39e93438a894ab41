"""Prediction and adaptation between two measurements against the equations that they solve."""

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from controller_fmu.l1 import siso_controller
from controller_fmu.l1.adaptation import Estimates, Interval, adapt, regressor
from controller_fmu.l1.parameters import InputGainRegressor, Regressor
from controller_fmu.l1.projection import project

A_M, B = np.array([[0.0, 1.0], [-1.0, -1.4]]), np.array([0.0, 1.0])
BOTH = InputGainRegressor.ADAPTIVE_CONTROL_AND_EXTENSION
START = Estimates(x_tilde=(0.1, -0.2), theta_hat=(0.5, -0.3), sigma_hat=0.2, omega_hat=1.0)
WIDE = {"theta_bound": (1e3, 1e3), "sigma_bound": 1e3}


def parameters(**values: Any) -> siso_controller.Parameters:
    return replace(siso_controller.Parameters(), **({"adaptation_gain": 50.0, "sigma_bound": 5.0} | values))


def x_of(t: float) -> tuple[float, float]:
    """A measured state that moves; its first component is always the larger."""
    return 2.0 + math.sin(3.0 * t), math.cos(2.0 * t)


def x_rate_of(t: float) -> np.ndarray:
    return np.array([3.0 * math.cos(3.0 * t), -2.0 * math.sin(2.0 * t)])


def u_of(t: float) -> tuple[float, float]:
    """u_a + u_p, and u_a."""
    return 2.0 + math.sin(t), 1.0 + 0.5 * math.cos(t)


def continuous(p: siso_controller.Parameters, duration: float) -> np.ndarray:
    """(4) and (5) integrated by SciPy: x_tilde, theta_hat, sigma_hat, omega_hat and the integral of eta."""
    pb = np.array(siso_controller.calculate(p).adaptation_vector)

    def derivative(t: float, state: np.ndarray) -> np.ndarray:
        x_tilde, theta, sigma, omega = state[:2], state[2:4], state[4], state[5]
        x, (u, u_a), eps = x_of(t), u_of(t), p.projection_tolerance
        phi, s = regressor(p.regressor, x), float(x_tilde @ pb)
        u_omega = u if p.input_gain_regressor == BOTH else u_a
        known = theta @ phi + sigma
        x_tilde_rate = A_M @ (x_tilde + x) + np.array(p.input_vector) * (omega * u + known) - x_rate_of(t)
        gamma, away = p.adaptation_gain, float(omega - p.input_gain)
        return np.array([
            *x_tilde_rate,
            *(gamma * project(float(theta[i]), -s * phi[i], p.theta_bound[i], eps) for i in (0, 1)),
            gamma * project(float(sigma), -s, p.sigma_bound, eps),
            gamma * project(away, -s * u_omega, p.input_gain_uncertainty, eps),
            known,
        ])  # fmt: skip

    start = [*START.x_tilde, *START.theta_hat, START.sigma_hat, p.input_gain, 0.0]
    return solve_ivp(derivative, (0.0, duration), start, rtol=1e-11, atol=1e-12, method="DOP853").y[:, -1]


def stepped(p: siso_controller.Parameters, duration: float, steps: int) -> np.ndarray:
    """The same by `adapt`, the control of each interval being that of its middle."""
    estimates, h = replace(START, omega_hat=p.input_gain), duration / steps
    matrices = siso_controller.calculate(p)
    integral = 0.0
    for i in range(steps):
        over = Interval(h, x_of(i * h), x_of((i + 1) * h), *u_of((i + 0.5) * h))
        before = estimates
        estimates, known = adapt(before, over, p, matrices)
        middle, end = (np.array(regressor(p.regressor, x_of((i + part) * h))) for part in (0.5, 1.0))
        theta = 0.5 * (np.array(before.theta_hat) + np.array(estimates.theta_hat))
        integral += h * (known - float(theta @ (end - middle)))  # the mean belongs to the newest regressor
    e = estimates
    return np.array([*e.x_tilde, *e.theta_hat, e.sigma_hat, e.omega_hat, integral])


def order(p: siso_controller.Parameters, steps: int) -> float:
    exact = continuous(p, 1.0)
    coarse, fine = (np.abs(stepped(p, 1.0, n) - exact).max() for n in (steps, 2 * steps))
    assert fine < 0.01 * np.abs(exact).max()
    return math.log2(coarse / fine)


@pytest.mark.parametrize(
    "chosen",
    [
        {},
        {"regressor": Regressor.INFINITY_NORM},
        {"input_gain_uncertainty": 0.99},
        {"input_gain": 3.0, "input_gain_uncertainty": 2.9, "input_gain_regressor": BOTH},
        {"adaptation_gain": 1e4},
        {"input_vector": (-0.4, 1.0)},
    ],
)
def test_a_step_is_of_second_order_where_the_projection_is_not_active(chosen: dict[str, Any]) -> None:
    p = parameters(**WIDE, **chosen)
    assert order(p, 400) == pytest.approx(2.0, abs=0.15)  # higher terms are smaller by the step


def test_with_an_active_projection_a_step_is_of_first_order() -> None:
    """Its factors are those of the beginning of the step."""
    assert order(parameters(theta_bound=(0.9, 0.6), sigma_bound=0.3), 800) == pytest.approx(1.0, abs=0.2)


def test_learning_from_another_control_than_acts_is_explicit_where_the_two_oppose(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """First order there, second elsewhere."""
    p = parameters(**WIDE, input_gain_uncertainty=0.99)
    monkeypatch.setitem(globals(), "u_of", lambda t: (-2.0 - math.sin(t), 1.0 + 0.5 * math.cos(t)))
    assert order(p, 800) == pytest.approx(1.0, abs=0.2)


@pytest.mark.parametrize("angle", [pytest.param(0.1, marks=pytest.mark.slow), 1.0, 8.0, 33.0])
def test_frequency_and_damping_of_the_fast_loop_do_not_depend_on_the_step(angle: float) -> None:
    """x rests: x_tilde and eta are linear, and their oscillation follows from a matrix exponential.

    `angle` [rad] is what one step turns them by. The energy of the oscillation shows its damping.
    """
    x = (100.0, 0.0)
    p = parameters(**WIDE, adaptation_gain=1e4)
    pb = np.array(siso_controller.calculate(p).adaptation_vector)
    kappa = 1e4 * (x[0] ** 2 + 1.0)
    h = angle / math.sqrt(kappa * pb[1])
    steps = round(0.5 / h)
    estimates, matrices = Estimates(x_tilde=(0.0, 0.05)), siso_controller.calculate(p)
    for _ in range(steps):
        estimates, _ = adapt(estimates, Interval(h, x, x, x[0], 0.0), p, matrices)  # u holds x at rest
    system = np.block([[A_M, B.reshape(2, 1)], [-kappa * pb.reshape(1, 2), np.zeros((1, 1))]])
    exact = expm(system * h * steps) @ [0.0, 0.05, 0.0]

    def energy(x_tilde: np.ndarray, eta: float) -> float:
        return kappa * float(pb @ x_tilde) ** 2 + pb[1] * eta**2

    eta = estimates.theta_hat[0] * x[0] + estimates.sigma_hat
    exact_energy, start = energy(exact[:2], exact[2]), energy(np.array([0.0, 0.05]), 0.0)
    assert exact_energy < 0.8 * start
    # what splitting leaves: A_m is small against the frequency of the loop, 1.4 against 8452 rad/s
    assert energy(np.array(estimates.x_tilde), eta) == pytest.approx(exact_energy, rel=1e-4)


@given(
    gain=st.floats(0.0, 1e6),
    h=st.floats(0.0, 1.0),
    states=st.lists(st.tuples(st.floats(-400.0, 400.0), st.floats(-400.0, 400.0)), min_size=20, max_size=20),
    controls=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
    kinds=st.tuples(st.sampled_from(Regressor), st.sampled_from(InputGainRegressor)),
)
def test_no_step_gain_or_measurement_makes_an_estimate_leave_its_bound(
    gain: float, h: float, states: list[tuple[float, float]], controls: tuple[float, float], kinds: tuple
) -> None:
    p = parameters(adaptation_gain=gain, input_gain_uncertainty=0.5, theta_bound=(10.0, 3.0))
    p = replace(p, regressor=kinds[0], input_gain_regressor=kinds[1])
    estimates, matrices = Estimates(), siso_controller.calculate(p)
    for before, after in pairwise(states):
        estimates, known = adapt(estimates, Interval(h, before, after, *controls), p, matrices)
        assert abs(estimates.theta_hat[0]) <= 10.0
        assert abs(estimates.theta_hat[1]) <= 3.0
        assert abs(estimates.sigma_hat) <= 5.0
        assert 0.5 <= estimates.omega_hat <= 1.5
        assert all(math.isfinite(value) for value in (*estimates.x_tilde, known))


def lyapunov_function(kind: InputGainRegressor) -> np.ndarray:
    """V = x_tilde' P x_tilde + (sigma_tilde^2 + omega_tilde^2) / Gamma over 4 s, on a plant with omega = 1.3.

    u_p opposes u_a most of the time, and is the larger of the two.
    """
    omega, sigma, h = 1.3, 0.4, 1e-3
    p = parameters(**WIDE, input_gain_uncertainty=0.99, input_gain_regressor=kind)
    p = replace(p, theta_bound=(0.0, 0.0))
    matrices, estimates = siso_controller.calculate(p), Estimates()
    step = expm(np.block([[A_M, B.reshape(2, 1)], [np.zeros((1, 3))]]) * h)
    x, values = (0.0, 0.0), []
    for i in range(4000):
        u_a, u_p = 1.0 + math.sin(2.0 * i * h), -3.0 * math.sin(2.0 * i * h + 1.0)
        errors = estimates.sigma_hat - sigma, estimates.omega_hat - omega
        x_tilde = np.array(estimates.x_tilde)
        p_of_v = np.array(matrices.lyapunov_matrix)
        values.append(x_tilde @ p_of_v @ x_tilde + np.dot(errors, errors) / p.adaptation_gain)
        before, (x_1, x_2, _) = x, (step @ [*x, omega * (u_a + u_p) + sigma]).tolist()
        x = x_1, x_2
        estimates, _ = adapt(estimates, Interval(h, before, x, u_a + u_p, u_a), p, matrices)
    return np.array(values)


def test_learning_from_the_whole_control_makes_the_lyapunov_function_fall() -> None:
    """V' = -x_tilde' Q x_tilde; learning from u_a leaves a term with omega_tilde u_p."""
    assert np.diff(lyapunov_function(BOTH)).max() < 0.0
    of_the_paper = lyapunov_function(InputGainRegressor.ADAPTIVE_CONTROL)
    assert of_the_paper.max() > 10.0 * of_the_paper[0]


def test_the_regressor_is_the_state_or_the_larger_of_its_components() -> None:
    assert regressor(Regressor.STATE, (-2.0, 1.0)) == (-2.0, 1.0)
    assert regressor(Regressor.INFINITY_NORM, (-2.0, 1.0)) == (2.0, 0.0)
    assert regressor(Regressor.INFINITY_NORM, (2.0, -3.0)) == (3.0, 0.0)


def test_no_time_changes_nothing_but_the_measurement() -> None:
    """The first step of a run has no interval behind it."""
    p = parameters()
    after, known = adapt(
        START, Interval(0.0, (1.0, 2.0), (1.0, 2.0), 3.0, 4.0), p, siso_controller.calculate(p)
    )
    assert after == START
    assert known == pytest.approx(0.5 * 1.0 - 0.3 * 2.0 + 0.2)


@pytest.mark.parametrize("free", [0, 1])
def test_each_parameter_stays_where_its_bound_is_zero(free: int) -> None:
    p = parameters(theta_bound=(0.0, 10.0) if free else (10.0, 0.0), sigma_bound=0.0)
    start = replace(START, theta_hat=(0.0, 0.0), sigma_hat=0.0)
    after, _ = adapt(start, Interval(0.1, (1.0, 2.0), (1.0, 2.0), 3.0, 4.0), p, siso_controller.calculate(p))
    assert (after.theta_hat[1 - free], after.sigma_hat, after.omega_hat) == (0.0, 0.0, 1.0)
    assert after.theta_hat[free] != 0.0


def test_the_projection_goes_by_the_middle_of_a_step_in_which_s_changes_its_sign() -> None:
    """s grows from -3/4 to 1/4 of `growth`: its mean moves sigma_hat upwards."""
    p = parameters(theta_bound=(0.0, 0.0), sigma_bound=5.0)
    matrices, h = siso_controller.calculate(p), 1e-4
    pb = np.array(matrices.adaptation_vector)
    growth = h * float(pb @ B)  # with eta = 1
    x_1, x_2 = (-0.75 * growth * pb / (pb @ pb)).tolist()
    moved = {}
    for sigma in (4.9, -4.9):
        start = Estimates(x_tilde=(x_1, x_2), sigma_hat=sigma)
        after, _ = adapt(start, Interval(h, (0.0, 0.0), (0.0, 0.0), 1.0 - sigma, 0.0), p, matrices)
        moved[sigma] = after.sigma_hat - sigma
    slowed = project(4.9, 1.0, p.sigma_bound, p.projection_tolerance)
    assert moved[4.9] == pytest.approx(slowed * moved[-4.9], rel=1e-3)  # A_m acts for h, of 3/4 and 1/4
    assert moved[-4.9] > 0.0


@pytest.mark.parametrize("u_a", [2.0, -2.0])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_projection_slows_an_input_gain_that_moves_outwards_whatever_the_sign_of_u_a(
    side: float, u_a: float
) -> None:
    p = parameters(theta_bound=(0.0, 0.0), sigma_bound=0.0, input_gain_uncertainty=0.5)
    matrices, omega = siso_controller.calculate(p), 1.0 + 0.49 * side
    moved = {}
    for sign in (1.0, -1.0):  # of the prediction error; the rate of omega_hat is -s u_a
        start = Estimates(x_tilde=(0.0, 0.1 * sign), omega_hat=omega)
        after, _ = adapt(start, Interval(1e-4, (0.0, 0.0), (0.0, 0.0), 0.0, u_a), p, matrices)
        moved[-math.copysign(1.0, sign * u_a * side)] = after.omega_hat - omega
    slowed = project(omega - 1.0, side, 0.5, p.projection_tolerance) / side
    assert moved[1.0] == pytest.approx(-slowed * moved[-1.0], rel=1e-6)
    assert 0.0 < slowed < 0.5


@pytest.mark.parametrize("x", [(1.0, 2.0), (1.0, -2.0), (-1.0, 2.0)])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_projection_slows_nothing_that_moves_inwards(x: tuple[float, float], side: float) -> None:
    """Estimates on their bounds, which x_tilde moves back: as if there were no bounds."""
    at_bound = tuple(math.copysign(0.6, side * component) for component in x)
    start = Estimates(x_tilde=(side, side), theta_hat=(at_bound[0], at_bound[1]), sigma_hat=0.3 * side)
    bounded, free = parameters(theta_bound=(0.6, 0.6), sigma_bound=0.3), parameters(**WIDE)
    over, matrices = Interval(1e-4, x, x, 0.0, 0.0), siso_controller.calculate(free)
    after, _ = adapt(start, over, bounded, matrices)
    assert after == adapt(start, over, free, matrices)[0]
    assert after.sigma_hat * side < 0.3
