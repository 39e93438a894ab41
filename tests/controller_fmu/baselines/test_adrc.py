"""Active disturbance rejection: the observer's poles, its exact step, and what it does under saturation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from controller_fmu.baselines.adrc import BLOCK, Estimate, Parameters, control, observe
from tests.controller_fmu.assumed_vehicle import DAMPING, INERTIA, at, closed_loop

START = Parameters()


def observer_matrix(w: float, q: float = 1.0) -> np.ndarray:
    """Of the estimate, the measurement and the known acceleration: the equations of Gao (2003)."""
    a = np.zeros((5, 5))
    a[0, 1] = a[1, 2] = a[1, 4] = 1.0
    gains = np.poly([-w, -w, -q * w])[1:]
    a[:3, 0], a[:3, 3] = -gains, gains
    return a


# around the ratios beyond which the exponential is no longer summed, and far from 1
RATIOS = [1.0, 0.1, 1.0 - 1e-6, 1.0 + 1e-3, 5.0]


@pytest.mark.parametrize("q", RATIOS)
@pytest.mark.parametrize("w", [0.5, 4.0, 50.0])
def test_the_observer_has_two_poles_at_its_bandwidth_and_one_at_its_ratio(w: float, q: float) -> None:
    """From the step itself: its matrix has the eigenvalues e^(-w h), e^(-w h) and e^(-q w h)."""
    h = 0.02
    columns = [observe(h, Estimate(*unit), 0.0, 0.0, w, q) for unit in np.eye(3)]
    matrix = np.array([list(vars(column).values()) for column in columns]).T
    assert np.poly(matrix) == pytest.approx(np.poly(np.exp([-w * h, -w * h, -q * w * h])), rel=1e-9)
    assert np.poly(observer_matrix(w, q)[:3, :3]) == pytest.approx(np.poly([-w, -w, -q * w]), rel=1e-9)


@pytest.mark.parametrize("q", RATIOS)
@pytest.mark.parametrize("h", [1e-4, 0.02, 0.5, 10.0])
@pytest.mark.parametrize("w", [0.5, 4.0, 50.0])
def test_a_step_of_the_observer_is_exact_whatever_its_length(w: float, h: float, q: float) -> None:
    start = np.array([0.3, -0.2, 0.5, 0.8, -0.4])
    is_over = min(q, 1.0) * w * h >= 50.0  # e^-50 of the start is left, times powers of w
    expected = [0.8, 0.0, 0.4] if is_over else (expm(observer_matrix(w, q) * h) @ start)[:3]
    after = observe(h, Estimate(*start[:3]), start[3], start[4], w, q)
    assert list(vars(after).values()) == pytest.approx(list(expected), rel=1e-6, abs=1e-9)


def test_with_a_perfect_observer_both_poles_are_at_the_control_bandwidth() -> None:
    p = replace(START, control_bandwidth=1.3)
    of_depth, of_rate = (control(at(), Estimate(z, v), p) for z, v in ((1.0, 0.0), (0.0, 1.0)))
    assert [1.0, -of_rate / INERTIA, -of_depth / INERTIA] == pytest.approx(np.poly([-1.3, -1.3]))


def test_the_observer_does_not_learn_the_saturation() -> None:
    """Damping and a force of 0.5 N are all that it may see while the thrusters give 2 N of 16 N."""
    p, h = replace(START, voltage_limit=4.0, observer_bandwidth=10.0), 2e-3
    loop = closed_loop(
        BLOCK, p, h=h, stop_time=4.0, reference=lambda t: (3.0, 0.0, 0.0), disturbance=lambda t: 0.5
    )
    saturated = (loop.outputs["demanded_force"] > 2.0) & (loop.time > 1.0)  # e^-10 of the observer's start
    assert np.count_nonzero(saturated) > 300
    expected = 0.5 - DAMPING * loop.rate
    late = DAMPING * 0.4 * 3.0 / p.observer_bandwidth  # it follows the damping 3 / w_o s late, at 0.4 m/s2
    assert loop.outputs["estimated_disturbance"][saturated] == pytest.approx(expected[saturated], abs=late)
