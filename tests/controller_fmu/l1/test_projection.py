"""Proj keeps the set invariant, is the identity inside, and never hurts the Lyapunov argument."""

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from controller_fmu.l1.projection import boundary_function, keep_within, project, projection_factor

TOLERANCES = st.floats(0.01, 1.0)
BOUNDS = st.floats(0.1, 100.0)
RATES = st.floats(-1e4, 1e4)
SHARES = st.floats(-1.0, 1.0)


@given(BOUNDS, TOLERANCES, SHARES, RATES)
def test_identity_inside(bound: float, tolerance: float, share: float, rate: float) -> None:
    estimate = 0.999 * share * bound / (1.0 + tolerance) ** 0.5
    assert project(estimate, rate, bound, tolerance) == rate


@given(BOUNDS, TOLERANCES, SHARES, SHARES, RATES)
def test_lyapunov_inequality(
    bound: float, tolerance: float, share: float, true_share: float, rate: float
) -> None:
    """(th_hat - th) (Proj(th_hat, y) - y) <= 0 for every true th that the layer's beginning encloses."""
    estimate = share * bound
    rounding = 1e-12 * bound * abs(rate)  # where both stand at the beginning of the layer
    true = true_share * bound / (1.0 + tolerance) ** 0.5
    assert (estimate - true) * (project(estimate, rate, bound, tolerance) - rate) <= rounding


@given(BOUNDS, TOLERANCES, st.sampled_from([-1.0, 1.0]), RATES)
def test_no_flow_leaves_the_bound(bound: float, tolerance: float, side: float, rate: float) -> None:
    assert (
        side * project(side * bound, rate, bound, tolerance) <= 1e-12 * abs(rate) + 1e-300
    )  # f = 1 + rounding


@given(BOUNDS, TOLERANCES, st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=50))
def test_the_set_is_invariant(bound: float, tolerance: float, rates: list[float]) -> None:
    """Without any clipping: steps small enough to follow f across the layer never pass the bound."""
    h = 0.05 * bound * tolerance / (1.0 + tolerance)
    estimate = 0.99 * bound
    for rate in rates:
        for _ in range(10):
            estimate += h * project(estimate, rate, bound, tolerance)
        assert -bound <= estimate <= bound


def test_a_step_too_long_for_the_flow_ends_on_the_bound() -> None:
    assert keep_within(7.0, 5.0) == 5.0
    assert keep_within(-7.0, 5.0) == -5.0


@given(TOLERANCES)
def test_the_layer_begins_and_ends_where_it_should(tolerance: float) -> None:
    assert boundary_function(10.0, 10.0, tolerance) == pytest.approx(1.0)
    assert boundary_function(10.0 / (1.0 + tolerance) ** 0.5, 10.0, tolerance) == pytest.approx(
        0.0, abs=1e-12
    )


@given(st.floats(1e-9, 1e6), TOLERANCES, SHARES)
@example(1e-9, 0.1, 0.5)
def test_the_layer_scales_with_its_bound_however_small(bound: float, tolerance: float, share: float) -> None:
    same = boundary_function(share, 1.0, tolerance)
    assert boundary_function(share * bound, bound, tolerance) == pytest.approx(same, rel=1e-9, abs=1e-12)


def test_a_bound_of_zero_holds_the_parameter() -> None:
    assert projection_factor(0.0, 5.0, 0.0, 0.1) == 0.0
