"""Offline design: SciPy's results, the block's closed forms, and the oracle of the example."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from controller_fmu import design
from controller_fmu.l1 import depth_controller, matrices
from controller_fmu.l1.parameters import FilterOrder, Regressor

A_M = np.array([[0.0, 1.0], [-1.0, -1.4]])
B = np.array([0.0, 1.0])
C = np.array([1.0, 0.0])
ENTRIES = st.floats(-3.0, 3.0)


@given(ENTRIES, ENTRIES, ENTRIES, st.floats(0.1, 10.0), st.floats(0.1, 10.0))
def test_the_blocks_lyapunov_solution_is_scipys(
    b: float, c: float, skew: float, q1: float, q2: float
) -> None:
    a_m = np.array([[-1.0 - abs(skew), b], [c, -0.5]])
    if np.linalg.eigvals(a_m).real.max() > -1e-2:  # nearly unstable: P grows without limit
        a_m -= 4.0 * np.eye(2)
    (a11, a12), (a21, a22) = a_m.tolist()
    p = matrices.lyapunov_solution(((a11, a12), (a21, a22)), (q1, q2))
    np.testing.assert_allclose(p, design.lyapunov_matrix(a_m, np.diag([q1, q2])), rtol=1e-9, atol=1e-12)


def test_p_and_k_g_of_the_example() -> None:
    calculated = matrices.law_matrices(((0.0, 1.0), (-1.0, -1.4)), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0))
    np.testing.assert_allclose(calculated.lyapunov_matrix, [[1.41429, 0.5], [0.5, 0.714286]], rtol=1e-5)
    assert calculated.feedforward_gain == pytest.approx(1.0)
    assert design.feedforward_gain(A_M, B, C) == pytest.approx(1.0)


def test_the_l1_condition_of_the_example_is_the_oracle() -> None:
    lipschitz = design.lipschitz_constant(Regressor.STATE, (10.0, 10.0))
    assert lipschitz == 20.0
    value = design.l1_condition(A_M, B, FilterOrder.FIRST, 160.0, lipschitz)
    assert value == pytest.approx(0.295, abs=5e-4)  # the oracle is given to three digits


def test_the_l1_norm_of_a_first_order_lag_and_of_a_resonance_are_analytic() -> None:
    lag = design.StateSpace(np.array([[-2.0]]), np.array([[1.0]]), np.array([[3.0]]))
    assert design.l1_norm(lag) == pytest.approx(1.5, rel=1e-4)
    # g = e^(-zt) sin(t): integral of |g| = coth(z pi / 2) / (1 + z^2)
    z = 0.2
    resonance = design.StateSpace(
        np.array([[0.0, 1.0], [-(1.0 + z * z), -2.0 * z]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
    )
    assert design.l1_norm(resonance) == pytest.approx(1.0 / np.tanh(z * np.pi / 2) / (1.0 + z * z), rel=1e-4)


@pytest.mark.parametrize("order", list(FilterOrder))
@pytest.mark.parametrize(("k_p", "k_i", "omega"), [(0.0, 0.0, 1.0), (3.0, 0.4, 0.7), (3.0, 0.4, 1.3)])
def test_g_is_the_transfer_function_it_says(order: FilterOrder, k_p: float, k_i: float, omega: float) -> None:
    s, w = 0.7j, 5.0
    extension = design.Extension((1.0, 0.0), k_p, k_i) if k_p else design.NO_EXTENSION
    system = design.uncompensated(A_M, B, order, w, extension, omega)
    g = system.c @ np.linalg.solve(s * np.eye(len(system.a)) - system.a, system.b)
    k_d = w / s if order == FilterOrder.FIRST else (3.0 * w**2 * s + w**3) / (s**2 * (s + 3.0 * w))
    c_omega = omega * k_d / (1.0 + omega * k_d)
    closed = s * np.eye(2) - A_M + omega * (k_p + k_i / s) * np.outer(B, C)
    np.testing.assert_allclose(g, np.linalg.solve(closed, B.reshape(-1, 1)) * (c_omega - 1.0), rtol=1e-12)


@pytest.mark.parametrize("order", list(FilterOrder))
@pytest.mark.parametrize("kind", list(Regressor))
def test_the_smallest_bandwidth_is_on_the_edge_of_the_condition(order: FilterOrder, kind: Regressor) -> None:
    lipschitz = design.lipschitz_constant(kind, (10.0, 10.0))
    w = design.smallest_bandwidth(A_M, B, order, lipschitz)
    assert design.l1_condition(A_M, B, order, 1.01 * w, lipschitz) < 1.0
    assert design.l1_condition(A_M, B, order, 0.99 * w, lipschitz) > 1.0


def test_the_lipschitz_constant_is_that_of_the_regressor() -> None:
    constants = {kind: design.lipschitz_constant(kind, (10.0, 3.0)) for kind in Regressor}
    assert constants == {Regressor.INFINITY_NORM: 10.0, Regressor.STATE: 13.0}


def test_bad_designs_are_refused() -> None:
    with pytest.raises(ValueError, match="must be Hurwitz"):
        design.lyapunov_matrix(-A_M, np.eye(2))
    with pytest.raises(ValueError, match="must be stable"):
        design.l1_norm(design.StateSpace(-A_M, B.reshape(-1, 1), np.eye(2)))
    with pytest.raises(ValueError, match="no bandwidth up to"):
        design.smallest_bandwidth(A_M, B, FilterOrder.FIRST, 20.0, largest=10.0)


def test_the_shipped_vehicle_design_satisfies_the_l1_norm_condition() -> None:
    p = depth_controller.Parameters()
    calculated = depth_controller.calculate(p)
    a_m, b = np.array(calculated.predictor_matrix), np.array(calculated.predictor_input)
    lipschitz = design.lipschitz_constant(p.regressor, p.theta_bound)
    assert design.l1_condition(a_m, b, p.filter_order, p.filter_bandwidth, lipschitz) < 1.0


# With the extension


EXTENDED = design.Extension((1.0, 0.0), 3.967, 0.00499)


@pytest.mark.parametrize(
    ("k_p", "k_i", "omega"), [(0.0, 0.0, 1.0), (3.0, 0.0, 1.0), (100.0, 0.0, 1.3), (3.0, 0.5, 0.7)]
)
def test_the_norm_with_the_extension_is_that_of_scipys_impulse_response(
    k_p: float, k_i: float, omega: float
) -> None:
    """G by hand as transfer functions, its impulse response by partial fractions, a quadrature of their sum.

    det(s I - A_x) = s^2 + 1.4 s + 1 + omega K_PI(s); C_omega - 1 = -s / (s + omega w).
    """
    w = 20.0
    norm = design.l1_norm(
        design.uncompensated(A_M, B, FilterOrder.FIRST, w, design.Extension((1.0, 0.0), k_p, k_i), omega)
    )
    integral = [1.0, 0.0] if k_i else [1.0]
    closed = np.polyadd(np.polymul([1.0, 1.4, 1.0 + omega * k_p], integral), [omega * k_i])
    denominator = np.polymul(closed, [1.0, omega * w])
    norms = []
    for row in ([1.0], [1.0, 0.0]):  # x_1, and x_2 = s x_1
        fractions: Any = signal.residue(np.polymul(np.polymul(row, integral), [-1.0, 0.0]), denominator)
        residues, poles, _ = fractions
        t = np.linspace(0.0, 40.0 / -poles.real.max(), 400_001)
        response = sum(
            (residue * np.exp(pole * t)).real for residue, pole in zip(residues, poles, strict=True)
        )
        norms.append(np.trapezoid(np.abs(response), t))
    assert norm == pytest.approx(max(norms), rel=2e-4)  # both rules are of second order


def test_the_condition_takes_the_worst_input_gain_of_the_box() -> None:
    values = [
        design.l1_condition(A_M, B, FilterOrder.FIRST, 60.0, 20.0, EXTENDED, [omega])
        for omega in (0.7, 1.0, 1.3)
    ]
    box = design.l1_condition(A_M, B, FilterOrder.FIRST, 60.0, 20.0, EXTENDED, [0.7, 1.0, 1.3])
    assert box == max(values) > min(values)


Common = tuple[np.ndarray, np.ndarray, FilterOrder, float, float]
P_ALONE = design.Extension((1.0, 0.0))
TUNED = design.Extension((1.0, 0.0), 3.709, 0.004373)


def of_vehicle(k_1: float, k_2: float, bandwidth: float) -> Common:
    a_m = np.array([[0.0, 1.0], [-k_1 / 5.5, -k_2 / 5.5]])
    return a_m, np.array([0.0, 1.0 / 5.5]), FilterOrder.FIRST, bandwidth, 5.0


SLOW = of_vehicle(1.895, 22.73, 0.3017)


@pytest.mark.parametrize(
    ("common", "extension", "omega", "end"),
    [
        ((A_M, B, FilterOrder.FIRST, 160.0, 20.0), P_ALONE, 1.0, "largest"),
        (SLOW, EXTENDED, 0.7, "least"),  # the condition is lost without the PI
        (of_vehicle(1.764, 20.97, 0.3073), TUNED, 1.0, "least"),  # and here by K_I alone
    ],
    ids=["example", "weak vehicle", "tuned PI"],
)
def test_the_range_of_the_proportional_gain_ends_on_the_edge_of_the_condition(
    common: Common, extension: design.Extension, omega: float, end: str
) -> None:
    """K_I remains where K_P is 0, which plain L1 need not bear."""
    least, largest = design.proportional_gain_range(*common, extension, (omega,))
    assert (least == 0.0, largest == np.inf) == (end == "largest", end == "least")
    edge = largest if end == "largest" else least
    within, beyond = (
        design.l1_condition(*common, replace(extension, proportional_gain=gain * edge), (omega,))
        for gain in ((0.99, 1.01) if end == "largest" else (1.01, 0.99))
    )
    assert within < 1.0 < beyond
    assert (design.l1_condition(*common, omegas=(omega,)) < 1.0) == (common is not SLOW)


def test_a_condition_that_holds_with_no_proportional_gain_has_no_range() -> None:
    assert np.isnan(design.proportional_gain_range(A_M, B, FilterOrder.FIRST, 10.0, 50.0, P_ALONE)).all()


def test_the_extension_of_the_vehicle_lets_a_smaller_bandwidth_do() -> None:
    a_m, b, order, _, lipschitz = SLOW
    without = design.smallest_bandwidth(a_m, b, order, lipschitz)
    extended = design.smallest_bandwidth(a_m, b, order, lipschitz, extension=EXTENDED)
    assert extended < without
    below, above = (
        design.l1_condition(a_m, b, order, part * extended, lipschitz, EXTENDED) for part in (0.99, 1.01)
    )
    assert above < 1.0 < below
