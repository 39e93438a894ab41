"""Zeros and ties: the table of the documentation holds in Python and in compiled code."""

import ctypes
import math
import re
from collections.abc import Iterator
from functools import cache
from importlib import resources
from itertools import product
from pathlib import Path
from typing import Any

import casadi
import pytest

from fmus import numerics
from fmus.generate.c_code import ScalarC, c_function
from fmus.native import toolchain
from fmus.numerics.symbols import unsimplified
from fmus.platforms import host_platform, library_name

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "mathematics-in-a-block.md"
ZEROS = (0.0, -0.0)
NAMES = {name: getattr(numerics, name) for name in numerics.__all__}
# no numbers, or functions of other functions; and those without a value at 0
NOT_IN_THE_TABLE = {
    "Clock", "all", "any", "logical_and", "logical_not", "logical_or", "logical_xor", "ramp_rates",
    "at_events", "rk4_step", "sampled", "solve", "transpose", "acosh", "log", "log2", "log10",
}  # fmt: skip
# what blocks compose of them
OTHERS = (
    "where(x < 1.0, x, 0.0)",
    "where(x > 1.0, 0.0, x)",
    "where(x == y, (x, 1.0), (2.0, y))[0]",
    "where(x == y, lambda: x, lambda: y)",
    "where(x == y, x, x)",
    "where(True, x, y)",
    "where(False, 1.0, (x, y)[0])",
    "where(True, (x, 1.0), (y, 2.0))[0]",
    "atan2(where(x < 1.0, x, 0.0), y - 1.0)",
    "copysign(1.0, ceil(x - 0.5))",
    "maximum(x, 0.0)",
    "minimum(0.0, x)",
)


def cells() -> Iterator[tuple[str, tuple[float, ...], str]]:
    """Expression, its arguments and the cell, for every expression and cell of the table."""
    section = PAGE.read_text(encoding="utf-8").partition("## Zeros and ties\n")[2].partition("\n## ")[0]
    for line in section.splitlines():
        if row := re.fullmatch(r"\| (`.+`) \| (.+) \|", line):
            values = row[2].split(" | ")
            points = list(product(ZEROS, repeat=1 if len(values) == 2 else 2))
            for expression in re.findall("`([^`]+)`", row[1]):
                yield from ((expression, point, value) for point, value in zip(points, values, strict=True))


CELLS = list(cells())
EXPRESSIONS = [*dict.fromkeys(expression for expression, _, _ in CELLS), *OTHERS]


def value(expression: str, x: Any, y: Any) -> Any:
    return eval(expression, {**NAMES, "x": x, "y": y})


@cache
def functions() -> dict[str, casadi.Function]:
    """The expressions as they are traced."""
    x, y = casadi.SX.sym("x"), casadi.SX.sym("y")
    results = [casadi.SX(value(expression, x, y)) for expression in EXPRESSIONS]
    traced = [unsimplified(casadi.cse, result) for result in results]
    made = [casadi.Function("f", [x, y], [result], ["x", "y"], ["r"]) for result in traced]
    return dict(zip(EXPRESSIONS, made, strict=True))


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """Function i computes expression i."""
    made = [c_function(function, f"f{i}_") for i, function in enumerate(functions().values())]
    codes = map(ScalarC().function, made)
    calls = [
        f"double f{i}(double x, double y) {{ double r; f{i}_(&x, &y, &r); return r; }}"
        for i in range(len(made))
    ]
    folder = tmp_path_factory.mktemp("zeros")
    file = folder / library_name("zeros", host_platform()).rpartition("/")[2]
    (folder / "zeros.c").write_text("\n".join(['#include "elementary.h"', *codes, *calls]))
    flags = [flag for flag in toolchain.FLAGS if "visibility" not in flag]
    headers = f"-I{resources.files('fmus') / 'native'}"
    toolchain.zig(["cc", "-shared", *flags, headers, "-o", str(file), "zeros.c"], folder)
    return ctypes.CDLL(str(file))


def compiled(library: ctypes.CDLL, expression: str, x: float, y: float) -> float:
    function = library[f"f{EXPRESSIONS.index(expression)}"]
    function.argtypes, function.restype = [ctypes.c_double, ctypes.c_double], ctypes.c_double
    return function(x, y)


@pytest.mark.parametrize(("expression", "point", "cell"), CELLS)
def test_each_cell_of_the_table_is_what_python_and_compiled_code_give(
    library: ctypes.CDLL, expression: str, point: tuple[float, ...], cell: str
) -> None:
    x, y = (*point, math.nan)[:2]
    assert repr(float(value(expression, x, y))) == cell
    assert repr(compiled(library, expression, x, y)) == cell


@pytest.mark.parametrize("expression", EXPRESSIONS)
def test_signs_of_zeros_and_ties_are_the_same_in_python_compiled_code_and_what_is_traced(
    library: ctypes.CDLL, expression: str
) -> None:
    for x, y in product((*ZEROS, 0.5, -0.5, 1.0, -1.0), repeat=2):
        try:
            expected = float(value(expression, x, y))
        except ValueError:  # outside the domain
            continue
        # one rounding: the C library of Python need not be that of the compiled code
        for result in (compiled(library, expression, x, y), float(functions()[expression](x, y))):
            assert result == pytest.approx(expected, rel=2.3e-16, abs=0.0)
            assert math.copysign(1.0, result) == math.copysign(1.0, expected)


@pytest.mark.parametrize("expression", ["minimum(x, y)", "maximum(x, y)", "sign(x)"])
@pytest.mark.parametrize("point", [(math.nan, 1.0), (1.0, math.nan), (math.nan, math.nan)])
def test_a_nan_has_the_same_result_in_python_and_compiled_code(
    library: ctypes.CDLL, expression: str, point: tuple[float, float]
) -> None:
    assert repr(compiled(library, expression, *point)) == repr(value(expression, *point))


def test_the_table_has_every_function_of_numbers() -> None:
    listed = {expression.partition("(")[0] for expression, _, _ in CELLS}
    assert not listed & NOT_IN_THE_TABLE
    assert listed | NOT_IN_THE_TABLE == set(numerics.__all__)


def test_a_choice_of_dataclasses_without_minus_zeros_is_the_alternative_itself() -> None:
    clock = numerics.Clock(1.0, 0)
    assert numerics.where(True, clock, numerics.Clock()) is clock
    assert repr(numerics.where(True, numerics.Clock(-0.0, 2), clock)) == repr(numerics.Clock(0.0, 2))
