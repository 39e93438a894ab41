"""The co-simulated vehicle against one continuous system integrated by SciPy.

Ideal sensor and measured velocity, so that the loop is continuous; thrusters with their lag, the
free surface left out because the vehicle starts under water.
"""

import math
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from controller_fmu.l1 import depth_controller
from controller_fmu.l1.matrices import LawMatrices
from controller_fmu.l1.parameters import Augmentation
from controller_fmu.l1.projection import project
from orchestration.results.recording import Recording
from orchestration.run import simulate
from orchestration.scenarios import scenario
from orchestration.system.experiment import Algorithm
from plant_fmu import depth_plant

DURATION = 30.0
DEPTH = 0.5


def reference(t: float) -> float:
    return DEPTH + 0.02 * t


@cache
def monolithic() -> np.ndarray:
    """True depth along a ramp to 1e-7 m, from the equations as the documents state them."""
    p = depth_controller.Parameters(augmentation=Augmentation.PI)
    matrices, plant = depth_controller.calculate(p), depth_plant.Parameters()
    a_m, b, pb = (
        np.array(m) for m in (matrices.predictor_matrix, matrices.predictor_input, matrices.adaptation_vector)
    )

    def derivative(t: float, state: np.ndarray) -> list[float]:
        z, w, force, x_1, x_2, theta, sigma, u_a, integral = state.tolist()
        e = z - reference(t)
        u_m = -p.depth_feedback_gain * z - p.rate_feedback_gain * w
        u_p = -p.proportional_gain * e - p.integral_gain * integral
        norm = max(abs(z), abs(w))
        s = float(np.array([x_1 - z, x_2 - w]) @ pb)
        known = theta * norm + sigma
        eps = p.projection_tolerance
        x_hat_rate = a_m @ [x_1, x_2] + b * (u_a + u_p + known)
        drag = plant.linear_damping * w + plant.quadratic_damping * abs(w) * w
        return [
            w,
            (force + plant.net_weight - drag) / plant.inertia,
            (u_m + u_a + u_p - force) / plant.thruster_lag[0],
            *x_hat_rate.tolist(),
            p.adaptation_gain * project(theta, -s * norm, p.theta_bound[0], eps),
            p.adaptation_gain * project(sigma, -s, p.sigma_bound, eps),
            -p.filter_bandwidth * (u_a + known - matrices.feedforward_gain * reference(t)),
            e,
        ]

    start = [DEPTH, 0.0, 0.0, DEPTH, 0.0, 0.0, 0.0, 0.0, 0.0]
    times = np.arange(31.0)
    return solve_ivp(derivative, (0.0, DURATION), start, t_eval=times, rtol=1e-7, atol=1e-9).y[0]


def co_simulated(h: float, algorithm: Algorithm) -> Recording:
    overrides = {
        "parameters": {
            "plant.initial_depth": DEPTH,
            "plant.free_surface": False,
            "plant.internal_step": h,
            "controller.internal_step": h,
        },
        "signals": {
            "controller.depth_reference": {
                "kind": "ramps",
                "points": [[0.0, DEPTH], [100.0, reference(100.0)]],
            }
        },
        "metrics": dict.fromkeys(("settling_time", "overshoot", "holding_thrust"), False),  # of the full run
        "experiment": {"stop_time": DURATION, "step_size": h, "algorithm": str(algorithm)},
    }
    chosen = scenario.load(scenario.find("nominal-extended-ideal"), overrides)
    return simulate(chosen.system, chosen.experiment)


@pytest.mark.parametrize("algorithm", list(Algorithm))
def test_the_closed_loop_converges_to_the_continuous_one_with_first_order(
    scenario_fmus: None, algorithm: Algorithm
) -> None:
    """Inputs are held over a communication step: first order, whatever the blocks' own order."""
    exact = monolithic()
    errors = []
    for h in (0.02, 0.01):
        run = co_simulated(h, algorithm)
        errors.append(np.abs(np.interp(np.arange(31.0), run.time, run["plant.depth"]) - exact).max())
    assert errors[1] < 2e-3  # m, the sensor's resolution
    # second-order terms are about h times the loop's 4 rad/s = 4 %
    assert math.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.1)


def test_the_assumed_matrices_are_those_of_the_paper() -> None:
    """A_m = A - B_m k_m with A of (13)."""
    p = depth_controller.Parameters()
    a = np.array([[0.0, 1.0], [0.0, -p.model_damping / p.model_inertia]])
    b = np.array([0.0, 1.0 / p.model_inertia])
    k_m = np.array([p.depth_feedback_gain, p.rate_feedback_gain])
    matrices = depth_controller.calculate(p)
    np.testing.assert_allclose(matrices.predictor_matrix, a - np.outer(b, k_m), rtol=1e-15)
    np.testing.assert_allclose(matrices.predictor_input, b)
    assert isinstance(matrices, LawMatrices)
