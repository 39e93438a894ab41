"""The closed forms of second order against SciPy's matrix functions."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.linalg import expm

from controller_fmu.l1.matrices import is_hurwitz, sampled_system

ENTRIES = st.floats(-10.0, 10.0).filter(lambda x: x == 0.0 or abs(x) > 1e-3)


@given(st.tuples(ENTRIES, ENTRIES, ENTRIES, ENTRIES), st.floats(-4.0, 0.0))
def test_a_matrix_is_hurwitz_if_both_its_eigenvalues_are_on_the_left(
    entries: tuple[float, float, float, float], shift: float
) -> None:
    a, b, c, d = entries
    matrix = ((a + shift, b), (c, d + shift))
    largest = np.linalg.eigvals(np.array(matrix)).real.max()
    assume(abs(largest) > 1e-6)
    assert is_hurwitz(matrix) == (largest < 0.0)


@pytest.mark.parametrize("period", [1e-5, 1e-3, 0.04, 0.8])
@pytest.mark.parametrize(
    "matrix",
    [
        ((-0.1, 0.0), (0.0, -0.1)),  # a multiple of I
        ((-1.0, 0.0), (0.0, -20.0)),  # real eigenvalues
        ((0.0, 1.0), (-1.0, -1.4)),  # complex ones
        ((0.0, 1.0), (-900.0, -3.0)),
        ((0.0, 1.0), (-1.0, -2.0)),  # equal ones, one eigenvector
        ((-2.0, 5.0), (0.0, -2.0)),
        ((-3.0, 2.0), (1.0, -1.0001)),
    ],
)
def test_a_sampled_system_is_that_of_the_matrix_exponential(
    matrix: tuple[tuple[float, float], tuple[float, float]], period: float
) -> None:
    """Phi from the exponential of [[A, I], [0, 0]], which inverts nothing."""
    block = np.block([[np.array(matrix), np.eye(2)], [np.zeros((2, 4))]])
    exact = expm(block * period)[:2]
    transition, error_input, inverse = map(np.array, sampled_system(matrix, period))
    phi, rounding = exact[:, 2:], 1e-12  # a step of -20 / trace, the longest permitted, costs 4 digits
    np.testing.assert_allclose(transition, exact[:, :2], atol=rounding)
    np.testing.assert_allclose(error_input, phi, atol=rounding * np.abs(phi).max())
    np.testing.assert_allclose(phi @ inverse, exact[:, :2], atol=rounding)
