"""C functions of CasADi's functions: the same numbers in each dialect, and no work for what is not chosen."""

import ctypes
import math
import random
import re
from collections.abc import Iterable
from functools import cache
from importlib import resources
from pathlib import Path

import casadi
import numpy as np
import pytest

from fmus.errors import ExportError
from fmus.generate.c_code import ScalarC, VectorC, c_function, c_functions
from fmus.generate.operations import Branch, Operation, as_late_as_possible
from fmus.native import toolchain
from fmus.platforms import host_platform, library_name
from orchestration.many.lane_library import LANES, aligned

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
SCALAR_CALLS = f"""
enum {{ NUMBERS = {NUMBERS} }};
void called_f_constants(double h, double *k) {{ f_constants(h, k); }}
void called_f(double h, double *u, double *x, double *k, double *y) {{ f(h, u, x, k, y); }}
int numbers(void) {{ return NUMBERS; }}
"""
CLEAR = "__attribute__((constructor)) static void clear(void) { memset(memory, 0xff, sizeof memory); }"
VECTOR_CALLS = """
void called_f_constants(double h, Lanes *k) { f_constants(h, k, memory); }
void called_f(double h, Lanes *u, Lanes *x, Lanes *k, Lanes *y) { f(h, u, x, k, y, memory); }
"""


def random_expression(seed: int) -> casadi.SX:
    """Six numbers of thirty operations, a third of them choices, each of earlier numbers.

    None is copysign, which makes the sign of a NaN visible: that is left open.
    """
    rng, names = random.Random(seed), (UNARY, [name for name in BINARY if name != "copysign"])
    numbers = [A, B, casadi.SX(rng.choice((-0.0, 0.5, -3.0)))]
    conditions = [A < B]
    for _ in range(30):
        a, b, condition = rng.choice(numbers), rng.choice(numbers), rng.choice(conditions)
        unary, binary = (getattr(casadi, rng.choice(those)) for those in names)
        numbers.append(rng.choice((unary(a), binary(a, b), casadi.if_else(condition, a, b))))
        conditions.append(rng.choice((a < b, a == b, casadi.logic_not(condition), condition * a)))
    return casadi.vertcat(*numbers[-6:])


@cache
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
        **{f"random_{seed}": random_expression(seed) for seed in range(12)},
    }
    return {
        name: casadi.Function(name, [A, B], [casadi.cse(expression)], ["a", "b"], ["y"])
        for name, expression in expressions.items()
    }


def compiled(folder: Path, dialect: ScalarC, head: str, calls: str) -> ctypes.CDLL:
    """A library of the functions in a dialect; head: what comes before them; calls: more after them."""
    made = [c_function(function, f"{name}_") for name, function in functions().items()]
    codes = list(map(dialect.function, (*made, *REMEMBERING)))
    number, memory = "double", ""
    if isinstance(dialect, VectorC):
        number, memory = "Lanes", ", memory"
        codes.append(f"static Lanes memory[{dialect.memory}];\n{CLEAR}")
    calls += "".join(
        f"void called_{name}({number} *a, {number} *b, {number} *y) {{ {name}_(a, b, y{memory}); }}\n"
        for name in functions()
    )
    file = folder / library_name("functions", host_platform()).rpartition("/")[2]
    (folder / "functions.c").write_text("\n".join([head, *codes, calls]))
    flags = [flag for flag in toolchain.FLAGS if "visibility" not in flag]
    headers = [f"-I{resources.files('fmus.native') / name}" for name in (".", "vectors")]
    toolchain.zig(["cc", "-shared", *flags, *headers, "-o", str(file), "functions.c"], folder)
    return ctypes.CDLL(str(file))


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    folder = tmp_path_factory.mktemp("functions")
    return compiled(folder, ScalarC(), '#include "elementary.h"', SCALAR_CALLS)


@pytest.fixture(scope="module")
def vectors(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The same functions for groups of instances."""
    headers = "".join(f"#include <{name}.h>\n" for name in ("math", "stdint", "string"))
    head = f'{headers}#define LANES {LANES}\n#include "lane_functions.h"'
    return compiled(tmp_path_factory.mktemp("vectors"), VectorC(), head, VECTOR_CALLS)


def points() -> list[tuple[float, float]]:
    """208 of them, the same at each call."""
    rng = random.Random(1)
    special = [(0.0, 0.0), (-0.0, 1.0), (1.0, -0.0), (math.nan, 1.0), (1.0, math.nan), (math.inf, 1.0)]
    drawn = [(rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0)) for _ in range(202)]
    return [*drawn[:197], *special, *drawn[197:]]


@pytest.mark.parametrize("name", functions())
def test_a_compiled_function_gives_the_numbers_of_casadi_bit_for_bit(name: str, library: ctypes.CDLL) -> None:
    function, compiled = functions()[name], library[f"called_{name}"]
    for point in points():
        result = (ctypes.c_double * function.numel_out(0))()
        compiled(*((ctypes.c_double * 1)(x) for x in point), result)
        expected = [float(x) for x in function(*point).full().ravel()]
        assert list(map(repr, result)) == list(map(repr, expected))


def bits(numbers: Iterable[float]) -> bytes:
    """Those of numbers; NaN has one sign."""
    return np.array([math.nan if math.isnan(number) else number for number in numbers]).tobytes()


@pytest.mark.parametrize("name", functions())
def test_each_lane_of_a_vector_has_the_bits_of_a_number(
    name: str, library: ctypes.CDLL, vectors: ctypes.CDLL
) -> None:
    count = functions()[name].numel_out(0)
    one = ctypes.c_double * 1
    for group in np.array(points()).reshape(-1, LANES, 2):
        columns = a, b, results = aligned(1, LANES), aligned(1, LANES), aligned(count, LANES)
        a[:], b[:] = group.T
        vectors[f"called_{name}"](*(ctypes.c_void_p(column.ctypes.data) for column in columns))
        for lane, point in enumerate(group.tolist()):
            result = (ctypes.c_double * count)()
            library[f"called_{name}"](*map(one, point), result)
            assert bits(results[:, lane]) == bits(result)


@pytest.mark.parametrize("name", ["fmin", "fmax"])
@pytest.mark.parametrize("zeros", [(0.0, -0.0), (-0.0, 0.0)])
def test_of_two_zeros_the_first_is_taken(name: str, zeros: tuple[float, float], library: ctypes.CDLL) -> None:
    result = (ctypes.c_double * 1)()
    library[f"called_{name}"](*((ctypes.c_double * 1)(x) for x in zeros), result)
    assert repr(result[0]) == repr(zeros[0])


def test_calls_of_inputs_are_computed_where_inputs_change_with_the_same_numbers(library: ctypes.CDLL) -> None:
    """Also after an input that is -0, infinite or not a number, and in a branch that was not taken before."""
    code = ScalarC().function(REMEMBERING[1])
    assert re.findall(r"remembered\((\w+)", code) == ["cos", "sin", "exp", "tan"]
    function, numbers = remembering(), (ctypes.c_double * library.numbers())()
    one, times = ctypes.c_double * 1, ctypes.c_double(0.7)
    library.called_f_constants(times, numbers)
    inputs = [math.nan, 0.0, 0.0, -0.0, 1.5, 1.5, math.inf, math.nan, 1.5, 0.0]
    for u, x in [(u, x) for u in inputs for x in (2.0, 0.0)]:
        result = (ctypes.c_double * 4)()
        library.called_f(times, one(u), one(x), numbers, result)
        expected = [float(value) for value in function(0.7, u, x).full().ravel()]
        assert list(map(repr, result)) == list(map(repr, expected))


def test_a_vector_of_such_calls_has_the_numbers_too(vectors: ctypes.CDLL) -> None:
    """Where the inputs of some lanes change and those of others do not."""
    function, times = remembering(), ctypes.c_double(0.7)
    columns = [aligned(count, LANES) for count in (1, 1, NUMBERS, 4)]
    u, x, _, y = columns
    addresses = [ctypes.c_void_p(column.ctypes.data) for column in columns]
    vectors.called_f_constants(times, addresses[2])
    inputs = np.random.default_rng(1).choice([math.nan, 0.0, -0.0, 1.5, math.inf], (20, LANES))
    for u[:] in inputs:
        x[:] = np.where(np.arange(LANES) < 3, 2.0, 0.0)
        vectors.called_f(times, *addresses)
        for lane in range(LANES):
            expected = function(0.7, u[0, lane], x[0, lane]).full().ravel()
            assert bits(y[:, lane]) == bits(expected)


def test_an_operation_without_an_expression_is_refused() -> None:
    function = casadi.Function("f", [A], [casadi.erfinv(A)], ["a"], ["y"])
    with pytest.raises(ExportError, match="f: operation ERFINV of CasADi has no expression in C"):
        ScalarC().function(c_function(function, "f"))


def test_what_one_alternative_needs_is_computed_in_a_branch() -> None:
    """But what both need, or what costs less than a branch, before it."""
    both = casadi.exp(B)
    expression = casadi.if_else(A > 0.0, casadi.log(A) * both, casadi.sin(B) + both) + casadi.if_else(
        B > 0.0, A, B
    )
    code = ScalarC().function(c_function(casadi.Function("f", [A, B], [expression], ["a", "b"], ["y"]), "f"))
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
    both, count = c_functions(function, "f", held=("h", "p"), inputs="u")
    constants, rest = map(ScalarC().function, both)
    assert (count, constants.count("exp("), rest.count("exp("), rest.count("sin(")) == (1, 1, 0, 1)
    assert "f_constants(double h, const double *p, double *k)" in constants
    assert rest.startswith("static void f(double h, const double *x, const double *p, double *k, double *y)")


@pytest.mark.parametrize("is_first", [True, False])
def test_a_choice_of_which_one_alternative_varies_is_no_constant(is_first: bool) -> None:
    h, x, p = (casadi.SX.sym(name) for name in "hxp")
    varying, constant = casadi.sin(x), casadi.exp(-h / p)
    first, second = (varying, constant) if is_first else (constant, varying)
    choice = casadi.if_else(p > 1.0, first, second)
    both, _ = c_functions(
        casadi.Function("f", [h, x, p], [choice], ["h", "x", "p"], ["y"]), "f", ("h", "p"), "u"
    )
    constants, rest = map(ScalarC().function, both)
    assert ("exp(" in constants, "x[" in constants, "sin(x[0])" in rest) == (True, False, True)


def test_late_operations_stand_before_their_first_use_and_in_their_branch() -> None:
    """0, 1 and 2 are arguments of the function."""
    operations = [
        *(Operation("INPUT", text=f"x[{i}]") for i in range(3)),
        Operation("NEG", (0,)),
        Operation("NEG", (1,)),
        Operation("ADD", (3, 4)),
        Operation("NEG", (2,)),  # from here on where 4 holds
        Operation("SQ", (4,)),
        Operation("SQ", (7,)),  # and 7
        Operation("ADD", (6, 8)),
        Operation("NEG", (4,)),  # where 4 does not
        Operation("ADD", (9, 10)),
        Operation("RESULT", (11,)),
        Operation("RESULT", (5,)),
    ]
    inner = Branch(7, [8], [])
    late = as_late_as_possible([3, 4, 5, Branch(4, [6, 7, inner, 9], [10]), 11, 12, 13], operations)
    assert late == [4, Branch(4, [7, inner, 6, 9], [10]), 11, 12, 3, 5, 13]
