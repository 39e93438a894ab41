"""Every function means the same on floats and on symbols, and what its name means in `math` or NumPy."""

import math
import sys
from collections.abc import Callable
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus import numerics as n
from fmus.numerics.hints import COUNTERPARTS, INSTEAD, hint

FINITE = st.floats(-1e3, 1e3)
POSITIVE = st.floats(1e-3, 1e3)
UNIT = st.floats(-1.0, 1.0)
SMALL = st.floats(-20.0, 20.0)
SQUARE = ((4.0, 1.0, 0.5), (-1.0, 3.0, 2.0), (0.0, 1.0, 5.0))
XP, YP = (-2.0, 0.0, 0.5, 3.0), (-1.0, 1.0)
FP, SURFACE = (1.0, -1.0, 4.0, 4.5), ((1.0, 2.0), (0.0, -3.0), (5.0, 5.0), (2.0, 8.0))

ELEMENTARY: list[tuple[str, Any]] = [
    *((name, FINITE) for name in ("sin", "cos", "tan", "atan", "asinh", "tanh", "floor", "ceil")),
    *((name, FINITE) for name in ("trunc", "cbrt", "radians", "degrees", "erf")),
    *((name, SMALL) for name in ("exp", "expm1", "exp2", "sinh", "cosh")),
    *((name, POSITIVE) for name in ("sqrt", "log", "log2", "log10", "log1p")),
    *((name, UNIT) for name in ("asin", "acos")),
    ("atanh", st.floats(-0.99, 0.99)),
    ("acosh", st.floats(1.0, 1e3)),
]
OF_TWO: list[tuple[str, Any]] = [
    *((name, FINITE) for name in ("atan2", "copysign", "hypot")),
    *((name, POSITIVE) for name in ("fmod", "remainder")),
]

OTHERS: list[tuple[Callable[..., Any], tuple]] = [
    (lambda a, b: n.where(a < b, a, 2.0 * b), (FINITE, FINITE)),
    (lambda a, b: n.where(a < b, lambda: a, lambda: 2.0 * b), (FINITE, FINITE)),
    (lambda a, b: n.where(n.logical_and(a > 0.0, n.logical_not(b > 0.0)), 1.0, -1.0), (FINITE, FINITE)),
    (lambda a, b: n.where(n.logical_or(a > 0.0, b > 0.0), 1.0, -1.0), (FINITE, FINITE)),
    (lambda a, b: n.where(n.logical_xor(a > 0.0, b > 0.0), 1.0, -1.0), (FINITE, FINITE)),
    (lambda a, b: n.where(n.all([a > 0.0, b > 0.0, a > b]), 1.0, -1.0), (FINITE, FINITE)),
    (lambda a, b: n.where(n.any([a > 0.0, b > 0.0, a > b]), 1.0, -1.0), (FINITE, FINITE)),
    (lambda a, b: n.where(a > b, (a, (b, 1.0)), (b, (a, 2.0)))[1][0], (FINITE, FINITE)),
    (lambda a, b: n.select([a > b, a > 0.0], [a, lambda: 2.0 * a], b), (FINITE, FINITE)),
    (lambda a, b: n.choose(a, (1.0, b, 3.0)), (st.integers(-1, 4), FINITE)),
    (n.minimum, (FINITE, FINITE)),
    (n.maximum, (FINITE, FINITE)),
    (n.clip, (FINITE, st.just(-1.0), st.just(2.0))),
    (n.sign, (FINITE,)),
    (n.absolute, (FINITE,)),
    (n.round, (FINITE,)),
    (n.power, (POSITIVE, st.floats(0.1, 2.0))),
    (lambda a, b: n.dist((a, b), (b, 1.0)), (FINITE, FINITE)),
    (lambda x: n.interp(x, XP, FP), (st.floats(-4.0, 4.0),)),
    (lambda x, y: n.interp2d(x, y, XP, YP, SURFACE), (st.floats(-4.0, 4.0), st.floats(-4.0, 4.0))),
    (lambda a, b: n.solve(((a, 1.0), (2.0, 1.0)), (b, 1.0))[0], (st.floats(3.0, 9.0), FINITE)),
    (lambda a, b: n.matmul(n.transpose(((a, 1.0), (2.0, b))), (b, 1.0))[1], (FINITE, FINITE)),
]
FUNCTIONS = [
    *((getattr(n, name), (values,)) for name, values in ELEMENTARY),
    *((getattr(n, name), (FINITE, values)) for name, values in OF_TWO),
    *OTHERS,
]


@pytest.mark.parametrize(("function", "strategies"), FUNCTIONS)
def test_float_and_symbol_agree(function: Callable[..., Any], strategies: tuple) -> None:
    symbols = [casadi.SX.sym(f"x{i}") for i in range(len(strategies))]
    traced = casadi.Function("f", symbols, [function(*symbols)])

    @settings(max_examples=30)
    @given(st.tuples(*strategies))
    def agree(values: tuple) -> None:
        # a few roundings may differ: CasADi is compiled against another libm
        assert float(traced(*values)) == pytest.approx(function(*values), rel=4e-16, abs=1e-300)

    agree()


@pytest.mark.parametrize(
    ("name", "strategies"),
    [*((name, (values,)) for name, values in ELEMENTARY), *((name, (FINITE, v)) for name, v in OF_TWO)],
)
def test_a_function_of_math_gives_what_math_gives(name: str, strategies: tuple) -> None:
    # cbrt is new in Python 3.11, log2 and others are products of two rounded numbers
    @settings(max_examples=30)
    @given(st.tuples(*strategies))
    def agree(values: tuple) -> None:
        assert getattr(n, name)(*values) == pytest.approx(getattr(math, name)(*values), rel=1e-15, abs=1e-15)

    agree()


def test_every_function_of_math_is_offered_or_its_refusal_says_what_to_do() -> None:
    of_numbers = {"e", "pi", "tau", "inf", "nan", "prod"}  # constants; `prod` multiplies symbols too
    functions = {name for name in dir(math) if not name.startswith("_")} - of_numbers
    offered = {name for name in functions if COUNTERPARTS.get(name, name) in n.__all__}
    assert functions - offered == functions & INSTEAD.keys()
    assert not offered & INSTEAD.keys()


def test_the_norm_of_a_vector_is_answered_with_a_call_that_takes_its_coordinates() -> None:
    assert hint("norm(x)", "y = norm(x)", "") == "use fmus.numerics.hypot(*x)"


def test_counterparts_exist() -> None:
    assert set(COUNTERPARTS.values()) <= set(n.__all__)


@given(FINITE | st.sampled_from([0.5, 1.5, 2.5, -0.5, -1.5, 0.49999999999999994, 2.0**52 + 1.0]))
def test_round_is_pythons(value: float) -> None:
    assert n.round(value) == round(value)


@given(st.floats(-4.0, 4.0) | st.sampled_from(XP))
def test_interp_is_numpys(x: float) -> None:
    assert n.interp(x, XP, FP) == np.interp(x, XP, FP)


def test_interp_takes_the_later_value_at_a_jump() -> None:
    """The inverse of a table with a flat part, also of constants at a symbol."""
    xp, fp = (-1.0, 0.0, 0.0, 2.0), (-3.0, -1.0, 1.0, 5.0)
    values = [n.interp(x, xp, fp) for x in (-9.0, -0.5, -1e-300, -0.0, 0.0, 1.0, 9.0)]
    assert values == [-3.0, -2.0, -1.0, 1.0, 1.0, 3.0, 5.0]
    x: Any = casadi.SX.sym("x")
    traced = casadi.Function("f", [x], [n.interp(x, xp, fp)])
    assert [float(traced(x)) for x in (-0.5, 0.0, 1.0)] == [-2.0, 1.0, 3.0]


@given(st.floats(-10.0, 2010.0))
def test_interp_of_many_points_is_numpys_and_chooses_among_them_in_few_levels(x: float) -> None:
    xp = tuple(map(float, range(2000)))
    fp = tuple(math.sin(0.1 * p) for p in xp)
    levels = 0

    def traced(frame: Any, event: str, _: Any) -> None:
        nonlocal levels
        levels += event == "call" and frame.f_code is n.where.__code__

    profile = sys.getprofile()
    sys.setprofile(traced)
    try:
        value = n.interp(x, xp, fp)
    finally:
        sys.setprofile(profile)
    # NumPy computes the slopes of all pieces before, in the same order of operations
    assert value == np.interp(x, xp, fp)
    assert levels <= math.ceil(math.log2(len(xp) + 1))


@pytest.mark.parametrize("first", [False, True])
@pytest.mark.parametrize("second", [False, True])
def test_boolean_algebra_and_choices_are_numpys(first: bool, second: bool) -> None:
    for name in ("logical_and", "logical_or", "logical_xor"):
        assert getattr(n, name)(first, second) is bool(getattr(np, name)(first, second))
    conditions = [first, second]
    assert (n.all(conditions), n.any(conditions)) == (all(conditions), any(conditions))
    assert n.logical_not(first) is not first
    assert n.select(conditions, [1.0, 2.0], 3.0) == np.select(conditions, [1.0, 2.0], 3.0)


@pytest.mark.parametrize("index", [-1, 0, 1, 2, 3])
def test_choose_is_numpys_and_clips_its_index(index: int) -> None:
    assert n.choose(index, (5.0, 6.0, 7.0)) == np.choose(index, (5.0, 6.0, 7.0), mode="clip")


def test_a_table_in_two_dimensions_meets_its_points_and_is_linear_between_and_held_outside() -> None:
    for i, x in enumerate(XP):
        assert [n.interp2d(x, y, XP, YP, SURFACE) for y in YP] == list(SURFACE[i])
    assert n.interp2d(0.25, 0.0, XP, YP, SURFACE) == 0.25 * (0.0 - 3.0 + 5.0 + 5.0)
    assert n.interp2d(-9.0, 9.0, XP, YP, SURFACE) == SURFACE[0][1]
    assert n.interp2d(9.0, -9.0, XP, YP, SURFACE) == SURFACE[3][0]


def test_matrices_are_numpys() -> None:
    a, v = np.array(SQUARE), (1.0, -2.0, 0.5)
    assert n.matmul(SQUARE, SQUARE) == pytest.approx(a @ a)
    assert n.matmul(SQUARE, v) == pytest.approx(a @ v)
    assert n.matmul(v, SQUARE) == pytest.approx(v @ a)
    assert n.matmul(v, v) == 5.25
    assert np.array(n.transpose(SQUARE)).tolist() == a.T.tolist()


@given(st.integers(0, 2**32 - 1))
def test_solve_is_numpys_whatever_the_order_of_the_rows(seed: int) -> None:
    a = np.random.default_rng(seed).permutation(np.array(SQUARE) * [1.0, 1.0, 0.0] + np.eye(3))
    rows = tuple(tuple(row) for row in a.tolist())
    b = ((1.0, 2.0), (0.0, 1.0), (3.0, -4.0))
    assert np.array(n.solve(rows, b)) == pytest.approx(np.linalg.solve(a, b), rel=1e-12)
    assert n.solve(rows, (1.0, 0.0, 3.0)) == pytest.approx(np.linalg.solve(a, (1.0, 0.0, 3.0)), rel=1e-12)


@pytest.mark.parametrize("name", ["cbrt", "sqrt", "sin", "tan", "asin", "atan", "tanh", "erf"])
def test_minus_0_stays_minus_0_as_in_math(name: str) -> None:
    x = casadi.SX.sym("x")
    traced = casadi.Function("f", [x], [getattr(n, name)(x)])
    assert repr(getattr(n, name)(-0.0)) == repr(float(traced(-0.0))) == "-0.0"


def test_constants_are_joined_as_if_they_were_written_as_one() -> None:
    """The page on mathematics in a block says so, and that the last place may differ from Python's."""
    symbol = casadi.SX.sym("x")
    joined = casadi.Function("joined", [symbol], [symbol * 0.1 * 3.0])
    values = [0.7, -1.3, 1e-3, 123.4, -5e6]
    results = [float(joined(x)) for x in values]
    assert results == [x * (0.1 * 3.0) for x in values]
    plain = [x * 0.1 * 3.0 for x in values]
    assert results != plain
    assert results == pytest.approx(plain, rel=2.0 * sys.float_info.epsilon)


def test_solve_takes_a_pivot_from_any_row() -> None:
    assert n.solve(((0.0, 0.0, 2.0), (0.0, 3.0, 0.0), (4.0, 0.0, 0.0)), (6.0, 6.0, 4.0)) == (1.0, 2.0, 3.0)


@pytest.mark.parametrize(
    "alternative", [n.sqrt, lambda x: 1.0 / (x + 1.0), lambda x: n.log(x) * n.power(x, 0.3)]
)
def test_an_alternative_that_is_not_taken_spoils_neither_value_nor_derivative(
    alternative: Callable[[Any], Any],
) -> None:
    x: Any = casadi.SX.sym("x")
    is_taken: Any = casadi.SX.sym("c")
    value = n.where(is_taken, lambda: alternative(x), 3.0 * x)
    function = casadi.Function("f", [x, is_taken], [value, casadi.jtimes(value, x, 1.0)])
    assert [float(result) for result in function(-1.0, 0.0)] == [-3.0, 3.0]
    assert n.where(False, lambda: alternative(-1.0), -3.0) == -3.0


def test_runge_kutta_converges_with_fourth_order() -> None:
    def error(steps: int) -> float:
        x, h = (1.0, 0.0), 2.0 / steps
        for i in range(steps):
            x = n.rk4_step(lambda _, x: (x[1], -x[0]), i * h, x, h)
        return abs(x[0] - math.cos(2.0))

    order = math.log2(error(20) / error(40))
    assert order == pytest.approx(4.0, abs=0.1)  # the next term of the error is 1 / 20 smaller
