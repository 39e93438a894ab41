"""Model reference adaptive control: its Lyapunov function falls, x tends to x_m, saturation is not learnt."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller_fmu.baselines.mrac import (
    BLOCK,
    Adaptive,
    Parameters,
    adapt,
    calculate,
    control,
    next_model,
    regressor,
)
from controller_fmu.depth_interface import DepthMeasurement
from controller_fmu.observer import VelocitySource
from tests.controller_fmu.assumed_vehicle import DAMPING, INERTIA, closed_loop

START = Parameters(velocity_source=VelocitySource.MEASURED)
H = 1e-7  # s: a rate is the change in a step, divided by it
NUMBER = st.floats(-1.0, 1.0)


@given(st.lists(NUMBER, min_size=12, max_size=12))
def test_the_lyapunov_function_falls_whatever_the_thrusters_withhold(numbers: list[float]) -> None:
    """V' = -e' Q e where no projection acts, less where one does, for true parameters within the bounds."""
    p, matrices = START, calculate(START)
    z, v, r, rate, acceleration, depth, speed, theta_hat, sigma_hat, theta, sigma, withheld = numbers
    x, model = np.array([z, v]), np.array([depth, speed])
    estimates, true = np.array([5.0 * theta_hat, 10.0 * sigma_hat]), np.array([4.0 * theta, 8.0 * sigma])
    adaptive = Adaptive((depth, speed), *estimates)
    now = DepthMeasurement(z, v, r, rate, acceleration)

    u, phi = control(now, adaptive, p, matrices), regressor((z, v))
    force = u + 5.0 * withheld + true @ [phi, 1.0]
    x_rate = np.array([v, (force - DAMPING * v) / INERTIA])
    f = INERTIA * acceleration + (DAMPING + p.rate_gain) * rate + p.depth_gain * r
    drive = f + 5.0 * withheld
    model_rate = (np.array(next_model(H, (depth, speed), drive, matrices)) - model) / H
    after = adapt(H, adaptive, (z, v), p, matrices)
    estimates_rate = (np.array([after.theta_hat, after.sigma_hat]) - estimates) / H

    e, wrong = x - model, estimates - true
    lyapunov = np.array(matrices.lyapunov_matrix)
    fall = 2.0 * e @ lyapunov @ (x_rate - model_rate) + 2.0 / p.estimate_gain * wrong @ estimates_rate
    assert fall <= -e @ e + 1e-4  # Q = I; quotients of differences of 1e-7
    is_inside = np.all(abs(estimates) < [4.7, 9.5])  # the boundary layer of the projection begins at 0.953
    assert not is_inside or fall == pytest.approx(-e @ e, abs=1e-4)


def test_the_state_tends_to_that_of_the_model() -> None:
    loop = closed_loop(
        BLOCK, START, h=0.01, stop_time=40.0, depth=0.3,
        reference=lambda t: (0.5, 0.0, 0.0), disturbance=lambda t: -1.2,
    )  # fmt: skip
    error = abs(loop.depth - loop.outputs["model_depth"])
    assert max(error) > 0.02
    assert max(error[-100:]) < 1e-5  # e^(-0.5 t) of the loop of sigma_hat
    assert loop.depth[-1] == pytest.approx(0.5, abs=1e-5)


def test_without_rates_of_the_reference_the_model_is_driven_by_k_g_r() -> None:
    matrices = calculate(START)
    u = control(DepthMeasurement(reference=0.7), Adaptive(), START, matrices)
    assert u == pytest.approx(0.7 * matrices.feedforward_gain)
    assert matrices.feedforward_gain == pytest.approx(START.depth_gain)


@pytest.mark.parametrize("limit", [12.0, 1.0])
def test_the_estimates_do_not_learn_the_saturation(limit: float) -> None:
    """The vehicle is the assumed one, without a disturbance: there is nothing to learn."""
    p = replace(START, voltage_limit=limit)
    loop = closed_loop(BLOCK, p, h=5e-3, stop_time=6.0, reference=lambda t: (1.0, 0.0, 0.0))
    is_saturated = np.any(loop.outputs["demanded_force"] > 0.5 * limit)
    assert is_saturated == (limit == 1.0)
    assert max(abs(loop.outputs["sigma_hat"])) < 0.02  # the steps; 0.5 N where the model is driven by f alone


def test_the_estimates_stay_within_their_bounds() -> None:
    p = replace(START, sigma_bound=0.5, theta_bound=0.2)
    loop = closed_loop(BLOCK, p, h=5e-3, stop_time=10.0, disturbance=lambda t: -3.0)
    assert max(abs(loop.outputs["sigma_hat"])) == pytest.approx(0.5, rel=0.05)
    assert max(abs(loop.outputs["sigma_hat"])) <= 0.5
    assert max(abs(loop.outputs["theta_hat"])) <= 0.2


def test_an_estimate_near_its_bound_grows_less_and_a_long_step_ends_on_it() -> None:
    p, matrices, h = START, calculate(START), 0.02
    free, near = (adapt(h, Adaptive(sigma_hat=sigma), (0.3, 0.0), p, matrices) for sigma in (0.0, 9.8))
    part = 1.0 - (1.1 * 9.8**2 - 100.0) / 10.0  # 1 - f of the projection, for eps = 0.1 and a bound of 10
    assert near.sigma_hat - 9.8 == pytest.approx(part * free.sigma_hat)
    assert near.theta_hat == free.theta_hat > 0.0
    fast = replace(p, estimate_gain=1e6)
    beyond = adapt(h, Adaptive(sigma_hat=9.0), (0.3, 0.0), fast, matrices)
    assert (beyond.sigma_hat, beyond.theta_hat) == (p.sigma_bound, p.theta_bound)


def test_the_model_begins_at_the_measured_state(driver: Any) -> None:
    controller = driver(BLOCK, measured_depth=0.4, measured_depth_rate=0.1, velocity_source=2).begin()
    assert (controller["model_depth"], controller["model_depth_rate"]) == (0.4, 0.1)
