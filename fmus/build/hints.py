"""Hints: the code to write in a block in place of an expression that has no meaning on a symbol."""

import ast
import re

from fmus import numerics

# a function of Python or NumPy -> the function of fmus.numerics with another name
COUNTERPARTS = {
    "abs": "absolute", "amax": "maximum", "amin": "minimum", "arccos": "acos", "arccosh": "acosh",
    "arcsin": "asin", "arcsinh": "asinh", "arctan": "atan", "arctan2": "atan2", "arctanh": "atanh",
    "around": "round", "deg2rad": "radians", "dot": "matmul", "fabs": "absolute", "fix": "trunc",
    "float_power": "power", "fmax": "maximum", "fmin": "minimum", "inner": "matmul", "int": "trunc",
    "max": "maximum", "min": "minimum", "piecewise": "select", "pow": "power",
    "rad2deg": "degrees", "rint": "round", "sorted": "minimum", "sumprod": "matmul", "vdot": "matmul",
}  # fmt: skip

_CONSTANTS = "compute it from constants alone"
_FINITE = "leave it out: a step whose results are not finite is refused"

_TUPLES = "use tuples, their comprehensions, and Python's sum"
_DEBUG = "leave it out, or call the function in a test"

# a function of Python, its `math` or NumPy that has no counterpart -> what to do
INSTEAD = {
    "add": "use x + y",
    "array": "use tuples",
    "asarray": "use tuples",
    "bool": "leave it out",
    "comb": _CONSTANTS,
    "complex": "use two numbers",
    "concatenate": "use (*x, *y)",
    "cross": _TUPLES,
    "diag": _TUPLES,
    "diff": _TUPLES,
    "divide": "use x / y",
    "erfc": "use 1.0 - fmus.numerics.erf(x)",
    "factorial": _CONSTANTS,
    "float": "leave it out",
    "float64": "leave it out",
    "fma": "use x * y + z",
    "frexp": _CONSTANTS,
    "fsum": "use sum",
    "gamma": _CONSTANTS,
    "gcd": _CONSTANTS,
    "heaviside": "use fmus.numerics.where",
    "inv": "use fmus.numerics.solve",
    "isclose": "use fmus.numerics.absolute(x - y) <= tolerance",
    "isfinite": _FINITE,
    "isinf": _FINITE,
    "isnan": _FINITE,
    "isqrt": "use fmus.numerics.floor(fmus.numerics.sqrt(x))",
    "lcm": _CONSTANTS,
    "ldexp": "use x * fmus.numerics.exp2(i)",
    "lgamma": _CONSTANTS,
    "mean": "use sum(x) / len(x)",
    "mod": "use x - y * fmus.numerics.floor(x / y)",
    "modf": "use fmus.numerics.fmod(x, 1.0) and fmus.numerics.trunc(x)",
    "multiply": "use x * y",
    "negative": "use -x",
    "nextafter": _CONSTANTS,
    "norm": "use fmus.numerics.hypot(*x)",
    "perm": _CONSTANTS,
    "print": _DEBUG,
    "prod": "use math.prod",
    "range": "use a constant number of turns",
    "square": "use x * x",
    "str": _DEBUG,
    "subtract": "use x - y",
    "sum": "use Python's sum",
    "ulp": _CONSTANTS,
}


_OPERATORS = {
    ast.And: "logical_and", ast.BitAnd: "logical_and", ast.Or: "logical_or", ast.BitOr: "logical_or",
    ast.BitXor: "logical_xor", ast.Not: "logical_not", ast.Invert: "logical_not", ast.MatMult: "matmul",
}  # fmt: skip


# the beginning of what asks for a whole number, up to the expression inside it -> what to do
_INDICES = {r"\brange\([^()]*": INSTEAD["range"], r"[\w)\]]\[[^\[\]]*": "use fmus.numerics.choose"}


def hint(expression: str, statement: str, default: str) -> str:
    """Returns the hint for an expression in a line of code; "" if none is known.

    default: the function of fmus.numerics if the expression does not show it
    """
    if statement.startswith("while "):
        return "use for with a constant number of turns, and fmus.numerics.where in it"
    if statement.startswith("assert "):
        return "use the requirements of the block"
    for before, use in _INDICES.items():
        if expression and re.search(before + re.escape(expression), statement):
            return use
    try:
        name = _name(ast.parse(expression, mode="eval").body)
    except SyntaxError:
        name = ""
    if name in INSTEAD:
        return INSTEAD[name]
    name = COUNTERPARTS.get(name, name)
    function = name if name in numerics.__all__ else default
    return f"use fmus.numerics.{function}" if function else ""


def _name(expression: ast.expr) -> str:
    """Returns the function that an expression calls, or the one that stands for an operator."""
    match expression:
        case ast.JoinedStr():
            return "str"
        case ast.Call(func=ast.Attribute(attr=name) | ast.Name(id=name)):
            return name
        case ast.Compare(ops=[ast.In() | ast.NotIn()]):
            return "any"
        case ast.Compare(ops=[_, _, *_]):
            return "logical_and"
        case ast.BoolOp(op=operator) | ast.BinOp(op=operator) | ast.UnaryOp(op=operator):
            return _OPERATORS.get(type(operator), "")
    return ""
