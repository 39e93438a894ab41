"""C functions of CasADi's functions: the same numbers, and no work for what is not chosen."""

import ctypes
import math
import random
import re
from importlib import resources

import casadi
import pytest

from fmus.build.c_functions import c_function, c_functions
from fmus.native import toolchain
from fmus.platforms import host_platform, library_name

A, B = casadi.SX.sym("a"), casadi.SX.sym("b")
UNARY = (
    "exp", "log", "sqrt", "sin", "cos", "tan", "asin", "acos", "atan", "floor", "ceil", "fabs", "erf", "sinh",
    "cosh", "tanh", "asinh", "acosh", "atanh", "log1p", "expm1", "sign", "logic_not",
)  # fmt: skip
BINARY = (
    "plus", "minus", "times", "rdivide", "power", "fmod", "remainder", "copysign", "fmin", "fmax", "atan2",
    "hypot", "lt", "le", "eq", "ne", "logic_and", "logic_or",
)  # fmt: skip


def choices() -> casadi.SX:
    """Alternatives inside of alternatives, and conditions that follow from alternatives."""
    dear = casadi.if_else(A > 0.0, casadi.log(A), casadi.sin(B) * casadi.exp(-A))
    inner = casadi.if_else(dear > B, casadi.if_else(A > 0.5, casadi.sqrt(A) + dear, casadi.tan(A)), -dear)
    other = casadi.if_else(casadi.logic_not(A > 0.0), casadi.exp(inner) / 3.0, casadi.cos(inner) * B)
    nothing_or = casadi.if_else(B > 0.5, 0.0, casadi.sin(A) * casadi.exp(B))
    both = casadi.if_else(A > 1.0, casadi.exp(A), 0.0) + casadi.if_else(B > 1.0, 0.0, casadi.exp(B))
    return casadi.vertcat(
        dear, inner, other, casadi.if_else(B > 0.0, -0.0 * A, other), -0.0 * B, nothing_or, both
    )


def remembering() -> casadi.Function:
    """A function of held h, inputs u and a state x, with dear calls of each, one of them in a branch."""
    h, u, x = (casadi.SX.sym(name) for name in "hux")
    angle = h * u
    chosen = casadi.if_else(x > 0.0, casadi.exp(angle) * casadi.tan(u), -1.0)
    results = casadi.vertcat(casadi.cos(angle) * x, casadi.sin(angle), casadi.log(x), chosen)
    return casadi.Function("f", [h, u, x], [results], ["h", "u", "x"], ["y"])


REMEMBERING, NUMBERS = c_functions(remembering(), "f", held=("h",), inputs="u")
CALL_REMEMBERING = """
void called_f_constants(double h, double *k) { f_constants(h, k); }
void called_f(double h, double *u, double *x, double *k, double *y) { f(h, u, x, k, y); }
int numbers(void) { return NUMBERS; }
"""


def functions() -> dict[str, casadi.Function]:
    expressions = {name: getattr(casadi, name)(A) for name in UNARY}
    expressions |= {name: getattr(casadi, name)(A, B) for name in BINARY}
    expressions |= {
        "constants": casadi.vertcat(
            A - 0.1, A * -3e-7, A + casadi.inf, A - casadi.inf, 2.0 * A, 1.0 / A, A * A
        ),
        "constant_power": A**2.5,
        "remainders": casadi.vertcat(
            *(
                casadi.fmod(A * scale, divisor)
                for scale in (1.0, 4e9, 1e16)
                for divisor in (2.0, 1e9, 2.5, -3.0)
            ),
            casadi.fmod(casadi.floor(A * 4e9), 2147483563.0),
            casadi.fmod(3.0, A),
            casadi.fmod(A, casadi.inf),
        ),
        "choices": choices(),
    }
    return {
        name: casadi.Function(name, [A, B], [casadi.cse(expression)], ["a", "b"], ["y"])
        for name, expression in expressions.items()
    }


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    codes = [c_function(f, name + "_") for name, f in functions().items()]
    calls = [
        f"void called_{name}(double *a, double *b, double *y) {{ {name}_(a, b, y); }}" for name in functions()
    ]
    folder = tmp_path_factory.mktemp("functions")
    file = folder / library_name("functions", host_platform()).rpartition("/")[2]
    codes.append(f"enum {{ NUMBERS = {NUMBERS} }};\n{REMEMBERING}\n{CALL_REMEMBERING}")
    (folder / "functions.c").write_text("\n".join(['#include "elementary.h"', *codes, *calls]))
    flags = [flag for flag in toolchain.FLAGS if "visibility" not in flag]
    headers = f"-I{resources.files('fmus') / 'native'}"
    toolchain.zig(["cc", "-shared", *flags, headers, "-o", str(file), "functions.c"], folder)
    return ctypes.CDLL(str(file))


@pytest.mark.parametrize("name", functions())
def test_a_compiled_function_gives_the_numbers_of_casadi_bit_for_bit(name: str, library: ctypes.CDLL) -> None:
    function, compiled = functions()[name], library[f"called_{name}"]
    random.seed(1)
    points = [(random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0)) for _ in range(200)]
    for point in [
        *points,
        (0.0, 0.0),
        (-0.0, 1.0),
        (1.0, -0.0),
        (math.nan, 1.0),
        (1.0, math.nan),
        (math.inf, 1.0),
    ]:
        result = (ctypes.c_double * function.numel_out(0))()
        compiled(*((ctypes.c_double * 1)(x) for x in point), result)
        expected = [float(x) for x in function(*point).full().ravel()]
        assert list(map(repr, result)) == list(map(repr, expected))


@pytest.mark.parametrize("name", ["fmin", "fmax"])
@pytest.mark.parametrize("zeros", [(0.0, -0.0), (-0.0, 0.0)])
def test_of_two_zeros_the_first_is_taken(name: str, zeros: tuple[float, float], library: ctypes.CDLL) -> None:
    result = (ctypes.c_double * 1)()
    library[f"called_{name}"](*((ctypes.c_double * 1)(x) for x in zeros), result)
    assert repr(result[0]) == repr(zeros[0])


def test_calls_of_inputs_are_computed_where_inputs_change_with_the_same_numbers(library: ctypes.CDLL) -> None:
    """Also after an input that is -0, infinite or not a number, and in a branch that was not taken before."""
    assert re.findall(r"remembered\((\w+)", REMEMBERING) == ["cos", "sin", "exp", "tan"]
    function, numbers = remembering(), (ctypes.c_double * library.numbers())()
    one, times = ctypes.c_double * 1, ctypes.c_double(0.7)
    library.called_f_constants(times, numbers)
    inputs = [math.nan, 0.0, 0.0, -0.0, 1.5, 1.5, math.inf, math.nan, 1.5, 0.0]
    for u, x in [(u, x) for u in inputs for x in (2.0, 0.0)]:
        result = (ctypes.c_double * 4)()
        library.called_f(times, one(u), one(x), numbers, result)
        expected = [float(value) for value in function(0.7, u, x).full().ravel()]
        assert list(map(repr, result)) == list(map(repr, expected))


def test_what_one_alternative_needs_is_computed_in_a_branch() -> None:
    """But what both need, or what costs less than a branch, before it."""
    both = casadi.exp(B)
    expression = casadi.if_else(A > 0.0, casadi.log(A) * both, casadi.sin(B) + both) + casadi.if_else(
        B > 0.0, A, B
    )
    code = c_function(casadi.Function("f", [A, B], [expression], ["a", "b"], ["y"]), "f")
    before, holds, fails = re.fullmatch(
        r"(.*)if \(v\d+\) \{(.*)\} else \{(.*?)\}.*", code, re.DOTALL
    ).groups()  # pyright: ignore[reportOptionalMemberAccess]
    assert ["exp(" in before, "log(" in holds, "sin(" in fails] == [True] * 3
    assert [len(re.findall(rf"\b{call}\(", code)) for call in ("exp", "log", "sin")] == [1] * 3
    assert code.count("if (") == 1


def test_what_follows_from_held_arguments_alone_is_computed_by_a_function_of_its_own() -> None:
    h, x, p = (casadi.SX.sym(name) for name in "hxp")
    decay, unused = casadi.exp(-h / p), casadi.sin(x)
    function = casadi.Function(
        "f", [h, x, p], [casadi.vertcat(decay * x, decay, unused)], ["h", "x", "p"], ["y"]
    )
    code, count = c_functions(function, "f", held=("h", "p"), inputs="u")
    constants, rest = code.split("static void f(")
    assert (count, constants.count("exp("), rest.count("exp("), rest.count("sin(")) == (1, 1, 0, 1)
    assert "f_constants(double h, const double *p, double *k)" in constants
    assert rest.startswith("double h, const double *x, const double *p, double *k, double *y)")


@pytest.mark.parametrize("is_first", [True, False])
def test_a_choice_of_which_one_alternative_varies_is_no_constant(is_first: bool) -> None:
    h, x, p = (casadi.SX.sym(name) for name in "hxp")
    varying, constant = casadi.sin(x), casadi.exp(-h / p)
    first, second = (varying, constant) if is_first else (constant, varying)
    choice = casadi.if_else(p > 1.0, first, second)
    code, _ = c_functions(
        casadi.Function("f", [h, x, p], [choice], ["h", "x", "p"], ["y"]), "f", ("h", "p"), "u"
    )
    constants, rest = code.split("static void f(")
    assert ("exp(" in constants, "x[" in constants, "sin(x[0])" in rest) == (True, False, True)
