"""The reference feedforward against the closed loops that it makes, in closed form."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy import signal
from scipy.linalg import expm

from controller_fmu.depth_interface import DepthInputs
from controller_fmu.l1 import depth_controller, siso_controller
from controller_fmu.l1 import law as l1
from controller_fmu.l1.feedforward import reference_feedforward
from controller_fmu.l1.law import Measurement
from controller_fmu.l1.matrices import law_matrices
from controller_fmu.l1.parameters import Augmentation, ReferenceFeedforward
from controller_fmu.observer import VelocitySource
from fmus.generate import builder
from orchestration.system.signal_derivatives import derivative
from orchestration.system.signals import Ramps, values_at

NONE, INSIDE, OUTSIDE = ReferenceFeedforward
ENTRIES = st.floats(-5.0, 5.0)


@given(st.tuples(ENTRIES, ENTRIES, ENTRIES, ENTRIES), st.floats(0.1, 6.0), st.floats(0.0, 6.3))
def test_the_reference_is_a_solution_of_the_desired_dynamics(
    entries: tuple[float, float, float, float], length: float, angle: float
) -> None:
    """The state at which y = r and y' = r' moves so that y' = r' and y'' = r''."""
    a_m = np.array(entries).reshape(2, 2) - 11.0 * np.eye(2)  # Hurwitz, by Gershgorin's circles
    b = length * np.array([math.cos(angle), math.sin(angle)])
    c = np.array([-math.sin(angle), math.cos(angle)])  # C B_m = 0
    assume(abs(c @ a_m @ b) > 0.01)
    (a_11, a_12), (a_21, a_22), (b_1, b_2), (c_1, c_2) = *a_m.tolist(), b.tolist(), c.tolist()
    matrices = law_matrices(((a_11, a_12), (a_21, a_22)), (b_1, b_2), (c_1, c_2), (1.0, 1.0))
    r, rate, acceleration = 0.7, -0.4, 1.3
    x, x_rate = np.linalg.solve(np.array([c, c @ a_m]), [[r, rate], [rate, acceleration]]).T
    f = reference_feedforward(r, rate, acceleration, matrices)
    np.testing.assert_allclose(a_m @ x + b * f, x_rate, rtol=1e-8, atol=1e-8 * (1.0 + abs(f)))


def test_the_vehicles_is_the_force_that_its_model_needs() -> None:
    """f = M r'' + (D + k_m2) r' + k_m1 r."""
    p = depth_controller.Parameters()
    f = reference_feedforward(0.5, 0.02, -0.003, depth_controller.calculate(p))
    damping = p.model_damping + p.rate_feedback_gain
    expected = -0.003 * p.model_inertia + 0.02 * damping + 0.5 * p.depth_feedback_gain
    assert f == pytest.approx(expected, rel=1e-14)


def test_an_output_that_the_control_moves_at_once_is_refused_with_a_feedforward(driver: Any) -> None:
    """f would depend on the past of r as well: it is the static inverse for C B_m = 0 alone."""
    block = builder.load_block("L1Controller")
    driver(block, **{"output_vector[2]": 0.1}).begin()
    for kind in (INSIDE, OUTSIDE):
        with pytest.raises(ValueError, match=r"C B_m = 0 .* with a reference_feedforward"):
            driver(block, reference_feedforward=kind, **{"output_vector[2]": 0.1}).begin()


# A smooth ramp on a vehicle that is the model, so that there is nothing to adapt to.
RAMP, H = Ramps([[0.0, 0.0], [20.0, 0.8]], smooth=True), 0.05
TIMES = np.arange(0.0, 25.0, H)


def depth_of_the_model(kind: ReferenceFeedforward, augmentation: Augmentation) -> np.ndarray:
    """Depth at TIMES, the block stepped directly as Jacobi would."""
    p = depth_controller.Parameters(
        reference_feedforward=kind, augmentation=augmentation, velocity_source=VelocitySource.MEASURED
    )
    matrices, m, d = depth_controller.calculate(p), p.model_inertia, p.model_damping
    step = expm(np.array([[0.0, 1.0, 0.0], [0.0, -d / m, 1.0 / m], [0.0, 0.0, 0.0]]) * H)
    references = [RAMP.at(TIMES), *(values_at(derivative(RAMP, order), TIMES) for order in (1, 2))]
    x, depths, state = np.zeros(2), [], None
    for t, reference in zip(TIMES.tolist(), np.array(references).T.tolist(), strict=True):
        inputs = DepthInputs(*reference, *x.tolist())
        state = state or depth_controller.initial_state(t, inputs, p, matrices)
        depths.append(x[0])
        given = depth_controller.output(t, state, p, matrices)
        assert given.demanded_force == given.u_m + given.u_a + given.u_p + given.u_f
        assert (given.u_f != 0.0) == (kind == OUTSIDE and t > H)
        state = depth_controller.step(t, H, state, inputs, p, matrices)
        x = (step @ [*x, given.demanded_force])[:2]
    return np.array(depths)


@pytest.mark.parametrize("augmentation", [Augmentation.NONE, Augmentation.PI])
def test_outside_the_filter_the_depth_is_the_reference(augmentation: Augmentation) -> None:
    """But for the held control, 1.5 H late, which leaves the force 1.5 H (M r^(3) + D r'') at most 0.02 N."""
    error = depth_of_the_model(OUTSIDE, augmentation) - RAMP.at(TIMES)
    assert np.abs(error).max() < 1e-3  # m, of 0.8 m; at 1.9 N/m that force would displace it by 1 cm


def test_inside_the_filter_the_depth_is_the_filtered_reference() -> None:
    """y = C(s) r: a lag of 3.3 s with w = 0.3 rad/s."""
    depth, w = depth_of_the_model(INSIDE, Augmentation.NONE), depth_controller.Parameters().filter_bandwidth
    filtered = signal.lsim(([w], [1.0, w]), RAMP.at(TIMES), TIMES)[1]
    assert np.abs(depth - filtered).max() < 2e-3
    assert np.abs(filtered - RAMP.at(TIMES)).max() > 0.1


# The design of the example, a reference and a matched disturbance of two frequencies, fast adaptation.
W, K_P, OF_REFERENCE, OF_DISTURBANCE = 3.0, 5.0, 1.0, 2.0  # rad/s, 1, rad/s, rad/s
STEP, SETTLED = 0.01, 12.0  # s


def tracking_error(kind: ReferenceFeedforward, augmentation: Augmentation) -> tuple[complex, complex]:
    """Phasors of e at both frequencies, for r = cos(OF_REFERENCE t), d = 5 cos(OF_DISTURBANCE t)."""
    p = replace(
        siso_controller.Parameters(), reference_feedforward=kind, augmentation=augmentation,
        filter_bandwidth=W, proportional_gain=K_P, adaptation_gain=1e5, theta_bound=(0.0, 0.0),
        sigma_bound=1e3,
    )  # fmt: skip
    matrices, (a_m, b) = siso_controller.calculate(p), (p.state_matrix, p.input_vector)
    step = expm(np.block([[np.array(a_m), np.array([b]).T], [np.zeros((1, 3))]]) * STEP)
    x, rows, law = np.zeros(2), [], None
    for i in range(round((SETTLED + 2.0 * math.pi) / STEP)):
        t, omega = i * STEP, OF_REFERENCE
        r, rate = math.cos(omega * t), -omega * math.sin(omega * t)
        f = reference_feedforward(r, rate, -(omega**2) * r, matrices)
        z, v = x.tolist()
        now = Measurement((z, v), z, r, f)
        law = law or l1.initial_law(now, p)
        u = l1.control(law, p.feedback_gain, p)
        rows.append((t, z - r))
        law = l1.law_step(STEP, law, now, u, u.total, 0.0, p.feedback_gain, p, matrices)
        x = (step @ [*x, u.total + 5.0 * math.cos(OF_DISTURBANCE * (t + 0.5 * STEP))])[:2]
    time, error = np.array(rows)[round(SETTLED / STEP) :].T
    columns = [g(omega * time) for omega in (OF_REFERENCE, OF_DISTURBANCE) for g in (np.cos, np.sin)]
    a = np.linalg.lstsq(np.array(columns).T, error, rcond=None)[0]
    return complex(a[0], -a[1]), complex(a[2], -a[3])


def closed_form(kind: ReferenceFeedforward, k_p: float, omega: float) -> tuple[complex, complex]:
    """e / r and e / d of y = H (v + (1 - C) d + u_p), v = C f inside, f outside, C k_g r without; H f = r."""
    s = 1j * omega
    h, c = 1.0 / (s * s + 1.4 * s + 1.0), W / (s + W)
    of_reference = {NONE: h * c, INSIDE: c, OUTSIDE: 1.0}[kind]
    return (of_reference - 1.0) / (1.0 + h * k_p), h * (1.0 - c) / (1.0 + h * k_p)


def expected_error(kind: ReferenceFeedforward, k_p: float) -> tuple[complex, complex]:
    return closed_form(kind, k_p, OF_REFERENCE)[0], 5.0 * closed_form(kind, k_p, OF_DISTURBANCE)[1]


TOLERANCE = 0.08  # of errors up to 1.4: control and estimate are 2.5 STEP late, 0.05 rad at 2 rad/s


@pytest.mark.parametrize("augmentation", [Augmentation.NONE, Augmentation.PI])
@pytest.mark.parametrize("kind", list(ReferenceFeedforward))
def test_it_acts_on_the_reference_and_the_extension_on_the_error(
    kind: ReferenceFeedforward, augmentation: Augmentation
) -> None:
    """Each as if the other were not there: inside, the PI sees what the filter leaves."""
    k_p = K_P if augmentation == Augmentation.PI else 0.0
    assert tracking_error(kind, augmentation) == pytest.approx(expected_error(kind, k_p), abs=TOLERANCE)


@pytest.mark.parametrize("kind", list(ReferenceFeedforward))
def test_a_known_input_gain_does_not_change_where_the_output_ends(kind: ReferenceFeedforward) -> None:
    """omega = 2: outside, the filter takes back what omega makes too much of f."""
    p = replace(
        siso_controller.Parameters(), reference_feedforward=kind, filter_bandwidth=W,
        adaptation_gain=0.0, input_gain=2.0, augmentation=Augmentation.NONE,
    )  # fmt: skip
    matrices, k_m = siso_controller.calculate(p), p.feedback_gain
    step = expm(np.array([[0.0, 1.0, 0.0], [-1.0, -1.4, 2.0], [0.0, 0.0, 0.0]]) * 0.02)
    x, law = np.zeros(2), l1.initial_law(Measurement(), p)
    for _ in range(1500):
        z, v = x.tolist()
        now = Measurement((z, v), z, 0.7, reference_feedforward(0.7, 0.0, 0.0, matrices))
        u = l1.control(law, k_m, p)
        law = l1.law_step(0.02, law, now, u, u.total, 0.0, k_m, p, matrices)
        x = (step @ [*x, u.total])[:2]
    assert x[0] == pytest.approx(0.7, rel=1e-6)  # 30 s, time constants of 1.4 s
