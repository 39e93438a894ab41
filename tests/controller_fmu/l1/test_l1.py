"""The law's step solves the equations it states, with the order it states, bounded and stable."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from controller_fmu.l1 import law as l1
from controller_fmu.l1 import siso_controller
from controller_fmu.l1.augmentation import Augmentation
from controller_fmu.l1.law import LawState, Measurement, Regressor
from controller_fmu.l1.lowpass import FilterOrder, FilterState
from controller_fmu.l1.projection import project
from fmus import catalogue

SEEN = Measurement(x=(2.0, -1.0), y=2.0, r=3.0)


def parameters(**values: Any) -> siso_controller.Parameters:
    standard = {"adaptation_gain": 50.0, "filter_bandwidth": 3.0, "sigma_bound": 5.0}
    return replace(siso_controller.Parameters(), **(standard | values))


def continuous(p: siso_controller.Parameters, seen: Measurement, duration: float, omega: float) -> np.ndarray:
    """(4) to (6) integrated by SciPy as they stand, first-order filter."""
    matrices = siso_controller.calculate(p)
    a_m, b, pb = (np.array(m) for m in (p.state_matrix, p.input_vector, matrices.adaptation_vector))
    phi = l1.regressor(p.regressor, seen.x)

    def derivative(t: float, state: np.ndarray) -> np.ndarray:
        x_hat, theta = state[:2], state[2:4].tolist()
        sigma, omega_hat, u_a, integral = state[4:].tolist()
        u_p = l1.extension(p, seen.error, integral, seen.r)
        s = float((x_hat - np.array(seen.x)) @ pb)
        eps = p.projection_tolerance
        d_theta = [p.adaptation_gain * project(theta[i], -s * phi[i], p.theta_bound[i], eps) for i in (0, 1)]
        d_sigma = p.adaptation_gain * project(sigma, -s, p.sigma_bound, eps)
        away = omega_hat - p.input_gain
        d_omega = p.adaptation_gain * project(away, -s * u_a, p.input_gain_uncertainty, eps)
        known = theta[0] * phi[0] + theta[1] * phi[1] + sigma
        forcing = omega_hat * (u_a + u_p) + known
        d_u = -p.filter_bandwidth * (omega_hat * u_a + known - matrices.feedforward_gain * seen.r)
        return np.array([*(a_m @ x_hat + b * forcing), *d_theta, d_sigma, d_omega, d_u, seen.error])

    start = [*seen.x, 0.0, 0.0, 0.0, omega, 0.5, 0.0]
    return solve_ivp(derivative, (0.0, duration), start, rtol=1e-11, atol=1e-12, method="DOP853").y[:, -1]


def stepped(p: siso_controller.Parameters, seen: Measurement, duration: float, steps: int) -> np.ndarray:
    matrices = siso_controller.calculate(p)
    law = replace(l1.initial_law(seen.x, p.input_gain), filter=FilterState(u_a=0.5))
    for _ in range(steps):
        law = l1.law_step(duration / steps, law, seen, 0.0, p, matrices)
    return np.array(
        [*law.x_hat, *law.theta_hat, law.sigma_hat, law.omega_hat, law.filter.u_a, law.error_integral]
    )


@pytest.mark.parametrize(
    "chosen",
    [
        {},
        {"regressor": Regressor.INFINITY_NORM},
        {"augmentation": Augmentation.PI, "proportional_gain": 2.0, "integral_gain": 1.0},
        {"augmentation": Augmentation.NONLINEAR_P},
        {"input_gain_uncertainty": 0.99},
    ],
)
def test_the_step_converges_to_the_equations_with_second_order(chosen: dict[str, Any]) -> None:
    """Inside the boundary layer of no estimate, where the right-hand side is smooth."""
    p = parameters(**chosen, theta_bound=(1e3, 1e3), sigma_bound=1e3)
    exact = continuous(p, SEEN, 0.5, p.input_gain)
    errors = [np.abs(stepped(p, SEEN, 0.5, steps) - exact).max() for steps in (200, 400)]
    assert errors[1] < 1e-4 * np.abs(exact).max()
    assert math.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.15)  # higher terms are smaller by h


def test_the_third_order_filter_settles_where_the_first_does() -> None:
    for order in FilterOrder:
        p = parameters(filter_order=order)
        law = LawState(x_hat=SEEN.x)
        for _ in range(20000):
            law = l1.law_step(2e-3, law, SEEN, 0.0, p, siso_controller.calculate(p))
        eta = law.omega_hat * law.filter.u_a + law.theta_hat[0] * 2.0 - law.theta_hat[1] + law.sigma_hat
        assert eta == pytest.approx(SEEN.r, rel=1e-6)  # eta_hat = k_g r in steady state


@given(
    augmentation=st.sampled_from(Augmentation),
    h=st.floats(1e-5, 0.1),
    gain=st.floats(1.0, 1e6),
    x=st.tuples(st.floats(-400.0, 400.0), st.floats(-400.0, 400.0)),
    r=st.floats(-100.0, 100.0),
)
def test_no_step_size_or_gain_makes_it_leave_its_bounds(
    augmentation: Augmentation, h: float, gain: float, x: tuple[float, float], r: float
) -> None:
    chosen = {"adaptation_gain": gain, "filter_bandwidth": 160.0, "input_gain_uncertainty": 0.5}
    p = parameters(**chosen, augmentation=augmentation, proportional_gain=50.0)
    law = l1.initial_law((0.0, 0.0), 1.0)
    for _ in range(100):
        law = l1.law_step(h, law, Measurement(x, x[0], r), 0.0, p, siso_controller.calculate(p))
        assert all(abs(theta) <= 10.0 for theta in law.theta_hat)
        assert abs(law.sigma_hat) <= 5.0
        assert 0.5 <= law.omega_hat <= 1.5
        assert math.isfinite(law.filter.u_a)


def saturated_controller(driver: Any, **values: Any) -> Any:
    """Held at 0 m for 40 s under a reference of 5 m: the thrusters saturate at 6 N."""
    block = catalogue.load_block("L1DepthController")
    controller = driver(block, augmentation=Augmentation.PI, depth_reference=5.0, **values).begin()
    for _ in range(2000):
        controller.step(0.02)
    assert controller["voltage[1]"] == 12.0
    return controller


def test_estimates_do_not_learn_the_saturation(driver: Any) -> None:
    """The vehicle does not move although 6 N push it: the model explains that by 6 N against."""
    assert saturated_controller(driver)["sigma_hat"] == pytest.approx(-6.0, rel=0.05)


@pytest.mark.parametrize("order", list(FilterOrder))
def test_integrators_do_not_wind_up(driver: Any, order: FilterOrder) -> None:
    """Held in saturation, neither u_a nor the integral of the PI goes on demanding more."""
    controller = saturated_controller(driver, filter_order=order, integral_gain=1.0)
    u_a, u_p = controller["u_a"], controller["u_p"]
    for _ in range(500):
        controller.step(0.02)
    assert controller["u_a"] <= u_a
    assert controller["u_p"] <= u_p
    controller["depth_reference"] = 0.0  # and the demand leaves saturation with its cause
    controller.step(0.02)
    assert abs(controller["voltage[1]"]) < 12.0


def test_a_third_order_filter_is_frozen_by_its_own_rate_of_u_a() -> None:
    """Whether u_a rises is told by p_1 and p_2, not by the sign of its input."""
    p = parameters(filter_order=FilterOrder.THIRD, filter_bandwidth=1.0)
    matrices = siso_controller.calculate(p)
    for side in (1.0, -1.0):
        law = LawState(x_hat=SEEN.x, filter=FilterState(u_a=0.0, p_1=5.0 * side, p_2=5.0 * side))
        after = l1.law_step(1e-3, law, SEEN, -1.0, p, matrices)
        assert (after.filter.u_a == 0.0) == (side > 0.0)
        assert (after.filter.p_2 == 5.0) == (side > 0.0)


def test_a_measured_velocity_bypasses_the_observer(driver: Any) -> None:
    block = catalogue.load_block("L1DepthController")
    controller = driver(block, velocity_source=2, measured_depth_rate=0.1).begin()
    assert controller["estimated_depth_rate"] == 0.1
    assert driver(block, measured_depth_rate=0.1).begin()["estimated_depth_rate"] == 0.0


def test_a_tilted_vehicle_is_driven_by_less(driver: Any) -> None:
    """u = K^-1 T^+ J' (u_m + u_a + u_p)."""
    controller = driver(catalogue.load_block("L1DepthController"), measured_depth=1.0, roll=0.3, pitch=0.2)
    controller.begin()
    expected = math.cos(0.3) * math.cos(0.2) * controller["demanded_force"] / (2.0 * 0.25)
    assert controller["voltage[1]"] == pytest.approx(expected)


def test_an_unstable_design_is_refused(driver: Any) -> None:
    controller = driver(catalogue.load_block("L1Controller"))
    controller["state_matrix[2,2]"] = 1.4
    with pytest.raises(ValueError, match="expected a Hurwitz A_m"):
        controller.begin()
