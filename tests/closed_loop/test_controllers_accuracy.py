"""The loop of each depth controller tends to one continuous system, written from the law's equations.

Ideal sensor and measured velocity, thrusters with their lag, the vehicle under water with its buoyancy.
"""

import math
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_lyapunov

from controller_fmu import adrc, mrac, pid, sliding_mode, super_twisting
from orchestration import simulate
from orchestration.scenarios import scenario
from plant_fmu import depth_plant

DURATION, DEPTH, SPEED = 20.0, 0.5, 0.02  # s, m, m/s of the ramp
M, D = 5.5, 2.5  # kg, N.s/m, as the controllers assume and as they are but for the quadratic damping
Law = Callable[[float, float, float, list[float]], tuple[float, list[float]]]
"""t, z, v, states of the law -> u and the rates of these states."""


def pid_law(t: float, z: float, v: float, law: list[float]) -> tuple[float, list[float]]:
    p, e = pid.Parameters(), z - (DEPTH + SPEED * t)
    u = -p.kp * e - p.ki * law[0] - p.kd * (v - SPEED) + D * SPEED
    return u, [e]


def sliding_mode_law(t: float, z: float, v: float, law: list[float]) -> tuple[float, list[float]]:
    p, e, de = sliding_mode.Parameters(), z - (DEPTH + SPEED * t), v - SPEED
    w = p.error_bandwidth
    s = de + 2.0 * w * e + w * w * law[0]
    saturation = max(-1.0, min(1.0, s / p.boundary_layer))
    return M * (-2.0 * w * de - w * w * e) + D * v - p.switching_gain * saturation, [e]


def super_twisting_law(t: float, z: float, v: float, law: list[float]) -> tuple[float, list[float]]:
    p, e, de = super_twisting.Parameters(), z - (DEPTH + SPEED * t), v - SPEED
    s = de + p.error_bandwidth * e
    g = s / (abs(s) + p.smoothing)
    u = M * -p.error_bandwidth * de + D * v - p.root_gain * math.sqrt(abs(s)) * g + law[0]
    return u, [-p.twisting_gain * g]


def adrc_law(t: float, z: float, v: float, law: list[float]) -> tuple[float, list[float]]:
    p, (z1, z2, z3) = adrc.Parameters(), law
    wc, wo = p.control_bandwidth, p.observer_bandwidth
    u = M * (wc**2 * (DEPTH + SPEED * t - z1) + 2.0 * wc * (SPEED - z2) - z3)
    y = z - z1
    return u, [z2 + 3.0 * wo * y, z3 + u / M + 3.0 * wo**2 * y, wo**3 * y]


@cache
def adaptation_vector(p: mrac.Parameters) -> tuple[float, float]:
    """P B_m."""
    a_m = np.array([[0.0, 1.0], [-p.depth_gain / M, -(D + p.rate_gain) / M]])
    pb = solve_continuous_lyapunov(a_m.T, -np.diag(p.lyapunov_weight)) @ [0.0, 1.0 / M]
    return float(pb[0]), float(pb[1])


def mrac_law(t: float, z: float, v: float, law: list[float]) -> tuple[float, list[float]]:
    """Far from the bounds of the estimates, where the projection changes nothing."""
    p, (z_m, v_m, theta, sigma) = mrac.Parameters(), law
    pb = adaptation_vector(p)
    f = (D + p.rate_gain) * SPEED + p.depth_gain * (DEPTH + SPEED * t)
    norm = max(abs(z), abs(v))
    u = -p.depth_gain * z - p.rate_gain * v + f - theta * norm - sigma
    slope = p.estimate_gain * ((z - z_m) * pb[0] + (v - v_m) * pb[1])
    model_rate = (f - p.depth_gain * z_m - (D + p.rate_gain) * v_m) / M
    return u, [v_m, model_rate, slope * norm, slope]


LAWS: dict[str, tuple[Law, list[float]]] = {
    "PidDepthController": (pid_law, [0.0]),
    "MracDepthController": (mrac_law, [DEPTH, 0.0, 0.0, 0.0]),
    "SlidingModeDepthController": (sliding_mode_law, [0.0]),
    "SuperTwistingDepthController": (super_twisting_law, [0.0]),
    "AdrcDepthController": (adrc_law, [DEPTH, 0.0, 0.0]),
}


def continuous(name: str, times: np.ndarray) -> np.ndarray:
    """True depth at these times."""
    law, start = LAWS[name]
    plant = depth_plant.Parameters()

    def rates(t: float, state: np.ndarray) -> list[float]:
        z, v, force, *states = state.tolist()
        u, law_rates = law(t, z, v, states)
        drag = plant.linear_damping * v + plant.quadratic_damping * abs(v) * v
        acceleration = (force + plant.net_weight - drag) / plant.inertia
        return [v, acceleration, (u - force) / plant.thruster_lag[0], *law_rates]

    start = [DEPTH, 0.0, 0.0, *start]
    return solve_ivp(rates, (0.0, DURATION), start, t_eval=times, rtol=1e-8, atol=1e-11).y[0]


def co_simulated(controller: Path, h: float, times: np.ndarray) -> np.ndarray:
    points = [[0.0, DEPTH], [100.0, DEPTH + 100.0 * SPEED]]
    overrides = {
        "components": {"controller": str(controller)},
        "parameters": {
            "plant.initial_depth": DEPTH, "plant.free_surface": False,
            "plant.internal_step": h, "controller.internal_step": h,
        },
        "signals": {"controller.depth_reference": {"kind": "ramps", "points": points}},
        "metrics": {"holding_thrust": False},
        "experiment": {"stop_time": DURATION, "step_size": h},
    }  # fmt: skip
    chosen = scenario.load(scenario.find("nominal-extended-ideal"), overrides)
    run = simulate(chosen.system, chosen.experiment)
    return np.interp(times, run.time, run["plant.depth"])


@pytest.mark.parametrize("name", LAWS)
def test_the_loop_tends_to_the_continuous_one_with_first_order(built: Mapping[str, Path], name: str) -> None:
    """Inputs are held over a communication step: first order, whatever the law's own step."""
    assert built["RovDepthPlant"].is_file()
    times = np.arange(0.0, DURATION, 0.5)
    exact = continuous(name, times)
    errors = [np.abs(co_simulated(built[name], h, times) - exact).max() for h in (0.02, 0.01)]
    assert errors[1] < 2e-3  # m, the sensor's resolution
    # second-order terms are about h times the loop's 4 rad/s = 4 %
    assert math.log2(errors[0] / errors[1]) == pytest.approx(1.0, abs=0.15)
