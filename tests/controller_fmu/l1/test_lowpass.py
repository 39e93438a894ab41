"""The filter closed around eta_hat = u_a + disturbance is C(s), at both orders."""

import math

import numpy as np
import pytest
from scipy import signal

from controller_fmu.l1.lowpass import FilterState, advance, midpoint_response
from controller_fmu.l1.parameters import FilterOrder

W = 3.0


def closed_step_response(order: FilterOrder, h: float, duration: float) -> tuple[np.ndarray, np.ndarray]:
    """u_a for v = u_a - 1: the response of C(s) to a unit step."""
    state, half = FilterState(), 0.5 * h
    values = [0.0]
    for _ in range(round(duration / h)):
        free, gain = midpoint_response(order, W, state, half)
        u_midway = (free + gain) / (1.0 + gain)
        state = advance(order, W, state, half, u_midway - 1.0)
        values.append(state.u_a)
    return np.arange(len(values)) * h, np.array(values)


@pytest.mark.parametrize(
    ("order", "numerator", "denominator"),
    [
        (FilterOrder.FIRST, [W], [1.0, W]),
        (FilterOrder.THIRD, [3.0 * W**2, W**3], [1.0, 3.0 * W, 3.0 * W**2, W**3]),
    ],
)
def test_step_response_is_that_of_c_with_second_order_accuracy(
    order: FilterOrder, numerator: list[float], denominator: list[float]
) -> None:
    def error(h: float) -> float:
        time, values = closed_step_response(order, h, 3.0)
        _, exact = signal.step((numerator, denominator), T=time)
        return float(np.abs(values - exact).max())

    assert error(0.01) < 1e-3
    assert math.log2(error(0.01) / error(0.005)) == pytest.approx(2.0, abs=0.1)  # next term is h / 10


def test_tuning_the_bandwidth_does_not_make_u_a_jump() -> None:
    state = FilterState(u_a=2.0, p_1=0.3, p_2=0.1)
    for order in FilterOrder:
        slow = advance(order, 1.0, state, 1e-9, 0.0)
        fast = advance(order, 10.0, state, 1e-9, 0.0)
        assert slow.u_a == pytest.approx(fast.u_a, abs=1e-6)  # what flows in 2 ns


def test_the_first_order_leaves_nothing_in_the_states_that_the_third_alone_has() -> None:
    """A filter that goes over to the third order begins there without a past."""
    state = FilterState(u_a=2.0, p_1=0.3, p_2=0.1)
    after = advance(FilterOrder.FIRST, W, state, 0.01, 1.0)
    assert (after.p_1, after.p_2) == (0.0, 0.0)
    assert after.u_a < state.u_a
