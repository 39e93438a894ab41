"""Every function means the same on floats and on symbols; the integrator has the order it states."""

import math
from collections.abc import Callable
from typing import Any

import casadi
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import numerics as n

FINITE = st.floats(-1e3, 1e3)
POSITIVE = st.floats(1e-3, 1e3)

FUNCTIONS: list[tuple[Callable[..., Any], tuple]] = [
    (lambda a, b: n.where(a < b, a, 2.0 * b), (FINITE, FINITE)),
    (lambda a, b: n.where(n.logical_and(a > 0.0, n.logical_not(b > 0.0)), 1.0, -1.0), (FINITE, FINITE)),
    (n.minimum, (FINITE, FINITE)),
    (n.maximum, (FINITE, FINITE)),
    (n.clip, (FINITE, st.just(-1.0), st.just(2.0))),
    (n.sign, (FINITE,)),
    (n.absolute, (FINITE,)),
    (n.power, (POSITIVE, st.floats(0.1, 2.0))),
    (n.fmod, (FINITE, POSITIVE)),
    (n.sqrt, (POSITIVE,)),
    (n.exp, (st.floats(-20.0, 20.0),)),
    (n.log, (POSITIVE,)),
    (n.sin, (FINITE,)),
    (n.cos, (FINITE,)),
    (n.tan, (FINITE,)),
    (n.asin, (st.floats(-1.0, 1.0),)),
    (n.acos, (st.floats(-1.0, 1.0),)),
    (n.atan, (FINITE,)),
    (n.sinh, (st.floats(-20.0, 20.0),)),
    (n.cosh, (st.floats(-20.0, 20.0),)),
    (n.tanh, (FINITE,)),
    (n.atan2, (FINITE, FINITE)),
    (n.floor, (FINITE,)),
    (n.ceil, (FINITE,)),
]


@pytest.mark.parametrize(("function", "strategies"), FUNCTIONS)
def test_float_and_symbol_agree(function: Callable[..., Any], strategies: tuple) -> None:
    @given(st.tuples(*strategies))
    def agree(values: tuple) -> None:
        symbols = [casadi.SX.sym(f"x{i}") for i in range(len(values))]
        traced = casadi.Function("f", symbols, [function(*symbols)])
        # one rounding may differ: CasADi is compiled against another libm
        assert float(traced(*values)) == pytest.approx(function(*values), rel=4e-16, abs=1e-300)

    agree()


def test_runge_kutta_converges_with_fourth_order() -> None:
    def error(steps: int) -> float:
        x, h = (1.0, 0.0), 2.0 / steps
        for i in range(steps):
            x = n.rk4_step(lambda _, x: (x[1], -x[0]), i * h, x, h)
        return abs(x[0] - math.cos(2.0))

    order = math.log2(error(20) / error(40))
    assert order == pytest.approx(4.0, abs=0.1)  # the next term of the error is 1 / 20 smaller
