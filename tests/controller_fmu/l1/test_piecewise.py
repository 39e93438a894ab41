"""The piecewise-constant law against the predictor that it samples, and against its own limit."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from controller_fmu.l1 import siso_controller
from controller_fmu.l1.adaptation import Estimates, Interval
from controller_fmu.l1.matrices import Matrix
from controller_fmu.l1.parameters import AdaptationLaw, Augmentation
from controller_fmu.l1.piecewise import Sample, adapt_at_samples
from fmus.generate import builder

A_M, B, B_U = np.array([[0.0, 1.0], [-1.0, -1.4]]), np.array([0.0, 1.0]), np.array([1.0, 0.0])
SLOW: Matrix = ((-1.0, 0.0), (0.0, -1.0))
KINDS: list[Matrix] = [
    SLOW,
    ((-1.0, 0.0), (0.0, -30.0)),
    ((0.0, 1.0), (-1.0, -1.4)),
    ((-2.0, 9.0), (-9.0, -2.0)),
]
PIECEWISE = AdaptationLaw.PIECEWISE_CONSTANT


def parameters(a_s: Matrix, period: float, **values: Any) -> siso_controller.Parameters:
    return replace(
        siso_controller.Parameters(), adaptation_law=PIECEWISE, prediction_error_matrix=a_s,
        adaptation_period=period, **values,
    )  # fmt: skip


def estimated(
    p: siso_controller.Parameters, lengths: list[float], matched: float, unmatched: float, b: np.ndarray = B
) -> list[Estimates]:
    """The estimates at every measurement of x' = A_m x + b (omega u + matched) + B_u unmatched, u = 0.8.

    x by the implicit midpoint rule: a straight line between two measurements, as the law takes it.
    """
    matrices = siso_controller.calculate(p)
    drive = b * (p.input_gain * 0.8 + matched) + B_U * unmatched
    x, sample, estimates, result = (0.3, -0.2), Sample((0.3, -0.2)), Estimates(), []
    for h in lengths:
        explicit = np.array(x) + h * (0.5 * A_M @ x + drive)
        x_1, x_2 = np.linalg.solve(np.eye(2) - 0.5 * h * A_M, explicit).tolist()
        over = Interval(h, x, (x_1, x_2), 0.8, 0.5)
        estimates, known, sample = adapt_at_samples(estimates, sample, over, p, matrices)
        assert known == estimates.sigma_hat
        result.append(estimates)
        x = x_1, x_2
    return result


@pytest.mark.parametrize("a_s", KINDS)
@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("length", [1.0, 2.5])
def test_the_estimate_of_a_constant_disturbance_is_its_exponential_share(
    a_s: Matrix, count: int, length: float
) -> None:
    """e^(A_s Ts) d from the first sample on, exactly, in however many steps a period is measured.

    length: of B_m, whose multiple the matched disturbance is; B_u has the length 1.
    """
    period, d = 0.02, np.array([-0.3, 1.7 * length])  # of x_1, unmatched, and of x_2, matched
    p = parameters(a_s, period, input_vector=(0.0, length))
    shares = expm(np.array(a_s) * period) @ d / (1.0, length)
    history = estimated(p, [period / count] * 5 * count, matched=1.7, unmatched=-0.3, b=length * B)
    for estimates in history[: count - 1]:
        assert estimates == Estimates()  # no sample yet
    for estimates in history[count - 1 :]:
        assert (estimates.sigma_u, estimates.sigma_hat) == pytest.approx(tuple(shares), rel=1e-10)
        assert estimates.theta_hat == (0.0, 0.0)
        # the error of the prediction at every sample: -Phi d
        phi = np.linalg.solve(np.array(a_s), (expm(np.array(a_s) * period) - np.eye(2)))
        assert estimates.x_tilde == pytest.approx(tuple(-phi @ d), rel=1e-10)


def test_a_period_that_communication_points_miss_is_sampled_at_the_next_one() -> None:
    """Steps of 15 ms, Ts = 20 ms: a sample every 30 ms, of the mean since the last."""
    history = estimated(parameters(SLOW, 0.02), [0.015] * 6, matched=1.7, unmatched=0.0)
    assert [estimates.sigma_hat != 0.0 for estimates in history] == [False, *[True] * 5]
    assert history[2] == history[1]
    assert history[5].sigma_hat == pytest.approx(1.7 * math.exp(-0.02), rel=1e-10)


def test_no_time_is_no_sample() -> None:
    p = parameters(SLOW, 0.02)
    over = Interval(0.0, (1.0, 2.0), (1.0, 2.0), 3.0, 4.0)
    start = Sample((1.0, 2.0))
    after = adapt_at_samples(Estimates(), start, over, p, siso_controller.calculate(p))
    assert after == (Estimates(), 0.0, start)


def test_a_known_input_gain_is_no_disturbance() -> None:
    p = parameters(SLOW, 0.02, input_gain=3.0)
    last = estimated(p, [0.02] * 3, matched=0.0, unmatched=0.0)[-1]
    assert (last.sigma_hat, last.sigma_u) == pytest.approx((0.0, 0.0), abs=1e-12)
    assert last.omega_hat == 3.0


@pytest.mark.parametrize("a_s", KINDS)
def test_it_is_the_sampled_predictor_of_its_source(a_s: Matrix) -> None:
    """x_hat' = A_m x + A_s x_tilde + B (u + sigma_hat) + B_u sigma_u, integrated by SciPy along a smooth x.

    With one step a period, the mean disturbance stands for one that moves: second order in Ts.
    """

    def x_of(t: float) -> np.ndarray:
        return np.array([2.0 + math.sin(3.0 * t), math.cos(2.0 * t)])

    def error(period: float) -> float:
        p = parameters(a_s, period)
        matrices, gain = siso_controller.calculate(p), np.linalg.inv(np.column_stack([B, B_U]))
        e_a = expm(np.array(a_s) * period)
        phi = np.linalg.solve(np.array(a_s), e_a - np.eye(2))
        x_hat, sigma, worst = x_of(0.0), np.zeros(2), 0.0
        x_1, x_2 = x_hat.tolist()
        estimates, sample = Estimates(), Sample((x_1, x_2))
        for k in range(round(0.5 / period)):
            t, driven = k * period, B * (0.7 + sigma[0]) + B_U * sigma[1]

            def rate(time: float, x_hat: np.ndarray, driven: np.ndarray = driven) -> np.ndarray:
                x = x_of(time)
                return A_M @ x + np.array(a_s) @ (x_hat - x) + driven

            x_hat = solve_ivp(rate, (t, t + period), x_hat, rtol=1e-11, atol=1e-13).y[:, -1]
            x_tilde = x_hat - x_of(t + period)
            sigma = -gain @ np.linalg.solve(phi, e_a @ x_tilde)
            (y_1, y_2), (z_1, z_2) = x_of(t).tolist(), x_of(t + period).tolist()
            over = Interval(period, (y_1, y_2), (z_1, z_2), 0.7, 0.7)
            estimates, _, sample = adapt_at_samples(estimates, sample, over, p, matrices)
            worst = max(worst, np.abs(sigma - [estimates.sigma_hat, estimates.sigma_u]).max())
        return worst

    coarse, fine = error(0.01), error(0.005)
    assert fine < 0.02  # of estimates up to 10
    assert math.log2(coarse / fine) > 1.7  # A_s Ts is up to 0.3, and higher terms smaller by that


@pytest.mark.parametrize("a", [1.0, 20.0])
def test_in_the_loop_a_constant_disturbance_leaves_what_the_offset_leaves(driver: Any, a: float) -> None:
    """e = H(0) (1 - e^(-a Ts)) d, with C(0) = 1: the filter passes the estimate, and H(0) = 1."""
    h = 0.02
    controller = driver(
        builder.load_block("L1Controller"), adaptation_law=PIECEWISE, adaptation_period=h,
        augmentation=Augmentation.NONE, filter_bandwidth=10.0, reference=0.5,
        **{"prediction_error_matrix[1,1]": -a, "prediction_error_matrix[2,2]": -a},
    ).begin()  # fmt: skip
    step, x = expm(np.block([[A_M, B.reshape(2, 1)], [np.zeros((1, 3))]]) * h), np.zeros(2)
    for _ in range(round(25.0 / h)):
        controller["measured_state[1]"], controller["measured_state[2]"] = x.tolist()
        controller.step(h)
        x = (step @ [*x, controller["control"] + 3.0])[:2]
    assert controller["tracking_error"] == pytest.approx(3.0 * (1.0 - math.exp(-a * h)), rel=1e-4)
    assert controller["sigma_hat"] == pytest.approx(3.0 * math.exp(-a * h), rel=1e-6)


@pytest.mark.parametrize("block", ["L1Controller", "L1DepthController"])
@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"[1,1]": 0.2}, r"a Hurwitz prediction_error_matrix A_s \(trace < 0 and determinant > 0\)"),
        ({"[1,2]": 2.0, "[2,1]": 2.0}, "a Hurwitz prediction_error_matrix"),  # a saddle
        ({"[1,1]": 0.0}, "a Hurwitz prediction_error_matrix"),
        ({"[1,1]": -1e5}, "a trace of prediction_error_matrix above -20 / adaptation_period"),
    ],
)
def test_an_error_matrix_of_which_nothing_could_be_sampled_is_refused(
    driver: Any, block: str, values: dict[str, float], expected: str
) -> None:
    entries = {f"prediction_error_matrix{index}": value for index, value in values.items()}
    with pytest.raises(ValueError, match=expected):
        driver(builder.load_block(block), **entries).begin()
