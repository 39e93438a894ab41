"""The extensions (7) and (8) of the paper."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from controller_fmu.l1.augmentation import nonlinear_proportional, proportional_integral, threshold
from controller_fmu.l1.parameters import Threshold


def test_pi_is_equation_7() -> None:
    assert proportional_integral(2.0, 3.0, 5.0) == -5.0 * 2.0 - 3.0


def test_nonlinear_p_is_equation_9_on_both_sides_of_the_threshold() -> None:
    delta = threshold(Threshold.PROPORTIONAL_TO_REFERENCE, 0.1, 1e-3, -50.0)
    assert delta == pytest.approx(5.0)
    assert nonlinear_proportional(6.0, delta, 0.1, 25.0, 100.0) == pytest.approx(-25.0 * 6.0**0.1)
    assert nonlinear_proportional(4.0, delta, 0.1, 25.0, 100.0) == pytest.approx(-100.0 * 4.0 / 5.0**0.9)


@given(st.floats(-100.0, 100.0), st.floats(1e-3, 10.0), st.floats(0.01, 1.0))
def test_it_opposes_the_error_and_is_odd(e: float, delta: float, alpha: float) -> None:
    u_p = nonlinear_proportional(e, delta, alpha, 25.0, 100.0)
    assert u_p * e <= 0.0
    assert nonlinear_proportional(-e, delta, alpha, 25.0, 100.0) == -u_p


def test_the_floor_holds_where_the_reference_crosses_zero() -> None:
    assert threshold(Threshold.PROPORTIONAL_TO_REFERENCE, 0.1, 0.01, 0.0) == 0.01
    assert threshold(Threshold.FIXED, 0.5, 0.01, 0.0) == 0.5
