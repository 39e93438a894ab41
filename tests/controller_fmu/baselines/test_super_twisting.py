"""Super-twisting: finite time without smoothing, a neighbourhood with it, and a step that does not switch."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import solve_continuous_lyapunov

from controller_fmu.baselines.super_twisting import Parameters, control, direction, sliding_variable
from tests.controller_fmu.assumed_vehicle import INERTIA, at, moved

SHARP = Parameters(smoothing=1e-9, root_gain=3.5, twisting_gain=1.1)


def course(
    p: Parameters, h: float, stop_time: float, disturbance: Callable[[float], float], rate: float = 0.0
) -> np.ndarray:
    """Rows of t, s, nu and u: the law, measuring and acting at one time, on the vehicle that it assumes."""
    z, v, nu, rows = 0.0, rate, 0.0, []
    for k in range(round(stop_time / h)):
        now = at(z, v)
        s = sliding_variable(now, p)
        g = direction(h, s, p)
        nu -= h * p.twisting_gain * g
        u = control(now, g, nu, p)
        rows.append((k * h, s, nu, u))
        z, v = moved(h, z, v, u + disturbance(k * h))
    return np.array(rows)


def longest_time(p: Parameters, s: float, disturbance: float) -> float:
    """Until s = s' = 0, for a constant d: V = zeta' P zeta falls, zeta = (sqrt(|s|) sgn s, s').

    V' <= -c sqrt(V) with c = sqrt(min P) min Q / max P and A' P + P A = -Q (Moreno and Osorio 2012), for the
    Q = I and the smallest of some scalings of the second state.
    """
    k_1, k_2 = p.root_gain / INERTIA, p.twisting_gain / INERTIA
    a = np.array([[-0.5 * k_1, 0.5], [-k_2, 0.0]])
    zeta = np.array([np.sqrt(abs(s)) * np.sign(s), disturbance / INERTIA])
    times = []
    for weight in np.geomspace(0.1, 10.0, 21):
        q = np.diag([1.0, weight])
        lyapunov = solve_continuous_lyapunov(a.T, -q)
        least, largest = np.linalg.eigvalsh(lyapunov)
        c = np.sqrt(least) * min(1.0, weight) / largest
        times.append(2.0 * np.sqrt(zeta @ lyapunov @ zeta) / c)
    return min(times)


@pytest.mark.parametrize("force", [1.2, -1.2])
def test_without_smoothing_s_vanishes_within_the_time_of_theory(force: float) -> None:
    rows = course(SHARP, 1e-3, 20.0, lambda t: force, rate=0.3)
    time, s, nu = rows[:, 0], abs(rows[:, 1]), rows[:, 2]
    away = time[(s > 1e-7) | (abs(nu + force) > 1e-3)]
    assert 0.5 < away[-1] < longest_time(SHARP, 0.3, force) < 20.0
    assert max(s[-1000:]) < 1e-12


@pytest.mark.parametrize("smoothing", [1e-9, 0.01, 0.05])
def test_a_changing_disturbance_leaves_a_neighbourhood_as_wide_as_the_smoothing(smoothing: float) -> None:
    """Where d grows by L N/s, g is L / k_2, so s settles at eps L / (k_2 - L): at 0 without smoothing."""
    p, growth = replace(SHARP, smoothing=smoothing), 0.4
    rows = course(p, 2e-3, 60.0, lambda t: growth * t)
    expected = smoothing * growth / (p.twisting_gain - growth)
    assert rows[-100:, 1] == pytest.approx(expected, rel=0.01, abs=2e-6)  # h^2 k_2 / M and more of the step


@pytest.mark.parametrize("h", [1e-3, 0.02, 0.2])
def test_the_step_does_not_switch_for_ever(h: float) -> None:
    """With the explicit step u jumps by 2 h k_2 and more in every step."""
    u = course(SHARP, h, 40.0, lambda t: 1.2, rate=0.3)[:, 3]
    last = u[len(u) // 2 :]
    jump = 2.0 * h * SHARP.twisting_gain
    assert max(abs(np.diff(last))) < 1e-3 * jump
    assert last[-1] == pytest.approx(-1.2, abs=1e-3 * jump)


@given(
    st.floats(1e-6, 10.0), st.floats(-5.0, 5.0), st.floats(0.0, 100.0), st.floats(0.0, 100.0),
    st.floats(1e-9, 1.0),
)  # fmt: skip
def test_a_step_is_the_law_unless_that_leads_beyond_s_of_zero(
    h: float, s: float, k_1: float, k_2: float, eps: float
) -> None:
    p = Parameters(root_gain=k_1, twisting_gain=k_2, smoothing=eps)
    pull = h / INERTIA * (k_1 * np.sqrt(max(abs(s), 1e-3 * eps)) + h * k_2)  # change of s for g = 1
    law = s / (abs(s) + eps)
    is_beyond = pull * abs(law) > abs(s)
    after = s - pull * direction(h, s, p)
    assert after == pytest.approx(0.0 if is_beyond else s - pull * law, abs=1e-12)
